"""The lines of one image as the robot's relative bearing and its signed distances to them, with one joint covariance.

The paper's sec. 2.2 (vanishing points for the bearing, eqs. 14-15 for the distances) as one weighted estimate:
all lines of both families vote for the one bearing, each end with its own pixel noise, while the mount's height, pan,
tilt and roll may move within their covariance, for all lines together. So parallel lines that look skewed correct the
tilt.

A line n . p = d on the ground and the camera at (c, h) span a plane with the normal v = (n, (d - n . c) / h): an end
seen along the ray r (robot frame) is on the line when v . r = 0. That stays linear in r up to the horizon, unlike the
ground point itself. Its first part has unit length, so that no error can be made small by shrinking the world.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.fixes.line_segments import LineSegments, agreeing, bearing_by_attitude, modulo_quarter, usable_segments
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray

_ITERATIONS = 20
_CONVERGED = 1e-4  # squared length of the last step, in sigmas; what is left after it is a thousandth of a sigma
_LONGEST_STEP_SIGMAS = 2.0  # of the mount, so that a false line cannot throw the camera away
_MISFIT_SIGMAS = 3.5
_OF_MOUNT = np.diag([0.0, 1.0, 1.0, 1.0, 1.0])  # information on (bearing, whitened errors of the mount) beforehand


@dataclass(frozen=True, slots=True)
class GroundLines:
    """Lines around the robot, in its axes turned by `bearing_rad`: family 0 are lines y = d, family 1 lines x = d.

    bearing_rad: of family 0 in the robot frame, about [-pi/4, pi/4). On a field whose lines run along its axes the
    robot's heading is some multiple of a quarter turn minus this.
    families: (n,) of 0 or 1. distances_m: (n,) signed, the d above.
    extents_m: (n, 2) lower and upper end of what was seen, along the line (x for family 0, y for family 1), with
    their standard deviations extents_sigma_m (n, 2).
    covariance: (1 + n, 1 + n) of (bearing_rad, distances_m), which is pixel_covariance, from the pixels' noise alone,
    + by_mount C by_mount' with the C of the mount. by_mount: (1 + n, 4) what another mount (height, pan, tilt, roll)
    would change in the estimate.
    observed: (n,) index of each among the observations; those missing were unusable or fit neither family.
    chi_square: misfit of the n straight lines, of n - 1 degrees of freedom.
    """

    bearing_rad: float
    families: NDArray[np.intp]
    distances_m: FloatArray
    extents_m: FloatArray
    extents_sigma_m: FloatArray
    covariance: FloatArray
    observed: NDArray[np.intp]
    chi_square: float
    pixel_covariance: FloatArray
    by_mount: FloatArray


def lines_on_the_ground(
    camera: Camera, mount: CameraMount, observations: tuple[LineObservation, ...]
) -> GroundLines | None:
    """The joint estimate of all lines that fit the two families; None where no line can be used."""
    usable = usable_segments(camera, mount, observations)
    if usable is None:
        return None
    agree, bearing = agreeing(usable)
    segments = usable.only(agree)
    root = square_root(np.asarray(mount.covariance, dtype=np.float64).tobytes())
    while len(segments.observed):
        fit = _fit(mount, root, segments, bearing)
        if fit.settled and fit.against.max() < _MISFIT_SIGMAS**2:
            # an odd number of quarter turns away from the bearing is family 1
            families = np.rint((segments.bearing_rad - bearing) / (np.pi / 2)).astype(np.intp) % 2
            return _on_the_ground(root, segments, families, fit)
        segments = segments.only(np.arange(len(segments.observed)) != fit.against.argmax())
    return None


@dataclass(frozen=True, slots=True)
class _Fit:
    bearing_rad: float
    mount: CameraMount  # as the lines correct it
    covariance: FloatArray  # (5, 5) of the bearing and the mount's whitened errors
    by_attitude: FloatArray  # (5, 3) what another pan, tilt and roll of the mount would change in those
    chi_square: float
    against: FloatArray  # (n,) how much chi_square would fall without each line, to first order
    settled: bool


def _fit(mount: CameraMount, root: FloatArray, segments: LineSegments, bearing: float) -> _Fit:
    """Gauss-Newton over (bearing, 4 whitened errors of the mount): height, pan, tilt, roll + root e.

    A line's own distance follows its two ends whatever they say, so only its bearing speaks of what all lines share.
    """
    weight = 1.0 / segments.bearing_variance
    x = np.array([bearing, 0.0, 0.0, 0.0, 0.0])
    jacobian = np.empty((len(weight), 5))
    jacobian[:, 0] = -1.0
    moved = mount
    residual, by_attitude = modulo_quarter(segments.bearing_rad - bearing), segments.bearing_by_attitude
    for again in range(_ITERATIONS):
        if again:
            residual, by_attitude = bearing_misfit(moved, segments, float(x[0]))
        jacobian[:, 1:] = by_attitude @ root[1:]
        weighted = jacobian.T * weight
        gradient = weighted @ residual
        gradient[1:] += x[1:]
        information = weighted @ jacobian + _OF_MOUNT
        step = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        settled = bool(gradient @ step < _CONVERGED)
        x -= step * min(1.0, _LONGEST_STEP_SIGMAS / max(1e-9, *map(abs, step[1:].tolist())))
        moved = _moved(mount, root @ x[1:])
        if settled:
            break
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    misfit = weight * residual * residual
    # what is left of a line's one residual after its own say in the estimate
    redundancy = 1.0 - weight * ((jacobian @ covariance) * jacobian).sum(axis=1)
    return _Fit(
        bearing_rad=float(x[0]),
        mount=moved,
        covariance=covariance,
        by_attitude=-(covariance @ weighted) @ by_attitude,
        chi_square=float(misfit.sum() + x[1:] @ x[1:]),
        against=np.where(redundancy > 1e-6, misfit / np.maximum(redundancy, 1e-6), 0.0),
        settled=settled and moved.height_m > 0.0,
    )


def bearing_misfit(mount: CameraMount, segments: LineSegments, bearing_rad: float) -> tuple[FloatArray, FloatArray]:
    """(n,) how far segments are turned from the bearing, modulo quarter turns; change with pan, tilt, roll (n, 3)."""
    upright = segments.normals @ robot_from_camera(mount).T
    x, y = upright[:, 0], upright[:, 1]
    by_attitude = bearing_by_attitude(upright, x * x + y * y, attitude_axes(mount))
    return modulo_quarter(np.arctan2(-x, y) - bearing_rad), by_attitude


def _on_the_ground(root: FloatArray, segments: LineSegments, families: NDArray[np.intp], fit: _Fit) -> GroundLines:
    """The distances and extents that go with the bearing and the mount, and how errors of those go on into them."""
    count, mount, height = len(families), fit.mount, fit.mount.height_m
    rotation, axes = robot_from_camera(mount), attitude_axes(mount)
    rays, to_pixel = segments.rays @ rotation.T, rotation @ segments.ray_to_pixel
    # the normals of both families, and their change with the bearing; a family runs along the other's normal
    c, s = math.cos(fit.bearing_rad), math.sin(fit.bearing_rad)
    normals, slopes = np.array([[-s, c], [c, s]]), np.array([[-c, -s], [-s, c]])
    normal, slope = normals[families], slopes[families]
    foot = np.array([mount.x_m, mount.y_m])
    level, rise = rays[..., :2], rays[..., 2]

    # q = (d - n . c) / h of the two ends' v . r = n . r + q r_z = 0: first both alike, then by their own noise
    ahead = (level @ normal[:, :, None])[..., 0]
    plane = np.empty((count, 3))
    plane[:, :2] = normal
    plane[:, 2] = -_dot(ahead, rise) / _dot(rise, rise)
    by_pixel = (plane[:, None, None, :] @ to_pixel)[:, :, 0]
    by_ends = np.zeros((count, 2, 4))
    by_ends[:, 0, :2], by_ends[:, 1, 2:] = by_pixel[:, 0], by_pixel[:, 1]
    own = by_ends @ segments.covariance_px2 @ by_ends.swapaxes(1, 2)
    share: FloatArray = np.asarray(np.linalg.solve(own, rise[:, :, None])[..., 0], dtype=np.float64)
    information = _dot(rise, share)
    share /= information[:, None]
    plane[:, 2] = -_dot(ahead, share)
    # change of (bearing, distances) with (bearing, height, pan, tilt, roll)
    by_shared = np.zeros((1 + count, 5))
    by_shared[0, 0] = 1.0
    mean_ray = (share[:, None] @ rays)[:, 0]
    by_shared[1:, 0] = slope @ foot - height * _dot(mean_ray[:, :2], slope)
    by_shared[1:, 1] = plane[:, 2]
    by_shared[1:, 2:] = -height * (cross(mean_ray, plane) @ axes.T)
    whitened = by_shared.copy()
    whitened[:, 1:] = by_shared[:, 1:] @ root
    to_fit = whitened @ fit.covariance
    covariance = to_fit @ whitened.T
    covariance.flat[count + 2 :: count + 2] += height * height / information
    by_mount = by_shared[:, 1:].copy()
    by_mount[:, 1:] += whitened @ fit.by_attitude

    # the ends along their lines
    down = np.maximum(-rise, 1e-9)  # the fit may have lifted a far end to the horizon
    along, along_slope = normals[1 - families], slopes[1 - families]
    to_ray = np.empty_like(rays)
    to_ray[..., :2] = along[:, None]
    to_ray[..., 2] = (level @ along[:, :, None])[..., 0] / down
    points = foot + level * (height / down)[..., None]
    by_shared = np.empty((count, 2, 5))
    by_shared[..., 0] = (points @ along_slope[:, :, None])[..., 0]
    by_shared[..., 1] = to_ray[..., 2]
    to_ray *= (height / down)[..., None]
    by_shared[..., 2:] = cross(rays, to_ray) @ axes.T
    by_shared[..., 1:] = by_shared[..., 1:] @ root
    by_pixel = (to_ray[:, :, None] @ to_pixel)[:, :, 0]
    by_ends[:, 0, :2], by_ends[:, 1, 2:] = by_pixel[:, 0], by_pixel[:, 1]
    variance = _dot(by_ends @ segments.covariance_px2, by_ends) + _dot(by_shared @ fit.covariance, by_shared)
    ends, sigmas = (points @ along[:, :, None])[..., 0], np.sqrt(variance)
    turned = (ends[:, 0] > ends[:, 1])[:, None]
    ends, sigmas = np.where(turned, ends[:, ::-1], ends), np.where(turned, sigmas[:, ::-1], sigmas)
    return GroundLines(
        bearing_rad=fit.bearing_rad,
        families=families,
        distances_m=normal @ foot + height * plane[:, 2],
        extents_m=ends,
        extents_sigma_m=sigmas,
        covariance=covariance,
        observed=segments.observed,
        chi_square=fit.chi_square,
        pixel_covariance=covariance - to_fit[:, 1:] @ to_fit[:, 1:].T,
        by_mount=by_mount,
    )


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    """Scalar products of vectors (..., m): of few numbers faster than a sum of products."""
    return np.asarray((one[..., None, :] @ other[..., None])[..., 0, 0])


def _moved(mount: CameraMount, change: FloatArray) -> CameraMount:
    """The mount with (height, pan, tilt, roll) changed by (4,)."""
    height, pan, tilt, roll = change.tolist()
    return CameraMount(
        mount.height_m + height,
        mount.pan_rad + pan,
        mount.tilt_rad + tilt,
        mount.roll_rad + roll,
        mount.covariance,
        mount.x_m,
        mount.y_m,
    )


@lru_cache(maxsize=64)
def square_root(covariance: bytes) -> FloatArray:
    """L with L L^T = covariance (4, 4); zeros in it (what is taken as exact) are welcome."""
    values, vectors = np.linalg.eigh(np.frombuffer(covariance, dtype=np.float64).reshape(4, 4))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
