"""The lines of one image as the robot's relative bearing and its signed distances to them, with one joint covariance.

The paper's sec. 2.2 (vanishing points for the bearing, eqs. 14-15 for the distances) as one weighted estimate:
all lines of both families vote for the one bearing, each end with its own pixel noise, while the mount's height, pan,
tilt and roll may move within their covariance, for all lines together. So parallel lines that look skewed correct the
tilt.

A line n . p = d on the ground and the camera at (c, h) span a plane with the normal v = (h n, d - n . c): an end seen
along the ray r (robot frame) is on the line when v . r = 0. That stays linear in r up to the horizon, unlike the ground
point itself.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.fixes.line_segments import LineSegments, agreeing, usable_segments
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray

_ITERATIONS = 20
_CONVERGED = 1e-8  # squared length of the last step, in sigmas; what is left after it is a hundredth of that
_MISFIT_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class GroundLines:
    """Lines around the robot, in its axes turned by `bearing_rad`: family 0 are lines y = d, family 1 lines x = d.

    bearing_rad: of family 0 in the robot frame, about [-pi/4, pi/4). On a field whose lines run along its axes the
    robot's heading is some multiple of a quarter turn minus this.
    families: (n,) of 0 or 1. distances_m: (n,) signed, the d above.
    extents_m: (n, 2) lower and upper end of what was seen, along the line (x for family 0, y for family 1), with
    their standard deviations extents_sigma_m (n, 2).
    covariance: (1 + n, 1 + n) of (bearing_rad, distances_m).
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


def lines_on_the_ground(
    camera: Camera, mount: CameraMount, observations: tuple[LineObservation, ...]
) -> GroundLines | None:
    """The joint estimate of all lines that fit the two families; None where no line can be used."""
    usable = usable_segments(camera, mount, observations)
    if usable is None:
        return None
    agree, bearing = agreeing(usable)
    segments = usable.only(agree)
    while True:
        # an odd number of quarter turns away from the bearing is family 1
        families = np.rint((segments.bearing_rad - bearing) / (np.pi / 2)).astype(np.intp) % 2
        fit = _fit(mount, segments, families, bearing)
        if fit is None:
            return None
        if len(families) < 3 or fit.misfit.max() < _MISFIT_SIGMAS**2:
            break
        segments = segments.only(np.arange(len(families)) != fit.misfit.argmax())
    extents, sigmas = _extents(mount, segments, families, fit.bearing_rad)
    return GroundLines(
        fit.bearing_rad, families, fit.distances_m, extents, sigmas, fit.covariance, segments.observed, fit.chi_square
    )


@dataclass(frozen=True, slots=True)
class _Fit:
    bearing_rad: float
    distances_m: FloatArray
    covariance: FloatArray
    misfit: FloatArray  # (n,) squared, in sigmas, of each line's two ends
    chi_square: float


def _fit(mount: CameraMount, segments: LineSegments, families: NDArray[np.intp], bearing: float) -> _Fit | None:
    """Gauss-Newton over (bearing, n distances, 4 whitened errors of the mount); None if it does not settle."""
    count = len(families)
    index = np.arange(count)
    root = _square_root(mount.covariance)
    own = segments.covariance_px2.reshape(count, 2, 2, 2, 2)
    x = np.zeros(1 + count + 4)
    x[0], x[1 : 1 + count] = bearing, _first_distances(mount, segments, families, bearing)
    for _ in range(_ITERATIONS):
        moved = _moved(mount, root @ x[1 + count :])
        rotation = robot_from_camera(moved)
        rays = segments.rays @ rotation.T
        normal, normal_slope = _normals(families, x[0])
        centre = np.array([mount.x_m, mount.y_m])
        plane = np.column_stack([moved.height_m * normal, x[1 : 1 + count] - normal @ centre])
        residual = np.einsum("nk,nek->ne", plane, rays)

        jacobian = np.zeros((count, 2, 1 + count + 4))
        slope = np.column_stack([moved.height_m * normal_slope, -normal_slope @ centre])
        jacobian[..., 0] = np.einsum("nk,nek->ne", slope, rays)
        jacobian[index, :, 1 + index] = rays[..., 2]
        to_height = np.einsum("nk,nek->ne", normal, rays[..., :2])
        to_attitude = cross(rays, plane[:, None]) @ attitude_axes(moved).T
        jacobian[..., 1 + count :] = np.concatenate([to_height[..., None], to_attitude], axis=-1) @ root

        to_pixel = np.einsum("nk,nekp->nep", plane @ rotation, segments.ray_to_pixel)
        weight = np.linalg.inv(np.einsum("nep,nepfq,nfq->nef", to_pixel, own, to_pixel))
        information = np.einsum("nea,nef,nfb->ab", jacobian, weight, jacobian)
        information[1 + count :, 1 + count :] += np.eye(4)
        gradient = np.einsum("nea,nef,nf->a", jacobian, weight, residual)
        gradient[1 + count :] += x[1 + count :]
        step = np.linalg.solve(information, gradient)
        x = x - step
        if gradient @ step < _CONVERGED:
            covariance = np.linalg.inv(information)[: 1 + count, : 1 + count]
            misfit = np.einsum("ne,nef,nf->n", residual, weight, residual)
            shared = x[1 + count :]
            return _Fit(float(x[0]), x[1 : 1 + count], covariance, misfit, float(misfit.sum() + shared @ shared))
    return None


def _first_distances(
    mount: CameraMount, segments: LineSegments, families: NDArray[np.intp], bearing: float
) -> FloatArray:
    """(n,) of the middle between each segment's ground points."""
    rays = segments.rays @ robot_from_camera(mount).T
    points = np.array([mount.x_m, mount.y_m]) + mount.height_m * rays[..., :2] / -rays[..., 2:]
    return np.asarray(np.sum(points.mean(axis=1) * _normals(families, bearing)[0], axis=-1))


def _extents(
    mount: CameraMount, segments: LineSegments, families: NDArray[np.intp], bearing: float
) -> tuple[FloatArray, FloatArray]:
    """Where the ends are along their lines, lower first, and the standard deviations (n, 2) each."""
    rotation = robot_from_camera(mount)
    rays = segments.rays @ rotation.T
    along = _normals(1 - families, bearing)[0]  # family 0 runs along family 1's normal, and the other way round
    ahead = np.einsum("nk,nek->ne", along, rays[..., :2]) / -rays[..., 2]  # in heights
    to_ray = np.empty_like(rays)
    to_ray[..., :2] = along[:, None]
    to_ray[..., 2] = ahead
    to_ray *= (mount.height_m / -rays[..., 2])[..., None]
    to_pixel = np.einsum("nek,nekp->nep", to_ray @ rotation, segments.ray_to_pixel)
    own = np.stack([segments.covariance_px2[:, :2, :2], segments.covariance_px2[:, 2:, 2:]], axis=1)
    to_mount = np.concatenate([ahead[..., None], cross(rays, to_ray) @ attitude_axes(mount).T], axis=-1)
    variance = np.einsum("nep,nepq,neq->ne", to_pixel, own, to_pixel)
    variance += np.einsum("nea,ab,neb->ne", to_mount, mount.covariance, to_mount)
    ends = mount.height_m * ahead + (along @ np.array([mount.x_m, mount.y_m]))[:, None]
    order = np.argsort(ends, axis=1)
    return np.take_along_axis(ends, order, axis=1), np.sqrt(np.take_along_axis(variance, order, axis=1))


def _normals(families: NDArray[np.intp], bearing: float) -> tuple[FloatArray, FloatArray]:
    """Normals (n, 2) of the families, n . p = d, and their change with the bearing."""
    c, s = np.cos(bearing), np.sin(bearing)
    across, along = np.array([-s, c]), np.array([c, s])
    first = (families == 0)[:, None]
    return np.where(first, across, along), np.where(first, -along, across)


def _moved(mount: CameraMount, change: FloatArray) -> CameraMount:
    """The mount with (height, pan, tilt, roll) changed by (4,)."""
    height, pan, tilt, roll = (float(value) for value in change)
    return dataclasses.replace(
        mount,
        height_m=mount.height_m + height,
        pan_rad=mount.pan_rad + pan,
        tilt_rad=mount.tilt_rad + tilt,
        roll_rad=mount.roll_rad + roll,
    )


def _square_root(covariance: FloatArray) -> FloatArray:
    """L with L L^T = covariance; zeros in it (what is taken as exact) are welcome."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
