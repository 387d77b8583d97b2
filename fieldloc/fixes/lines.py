"""The lines of one image as the robot's relative bearing and its signed distances to them, with one joint covariance.

The paper's sec. 2.2 (vanishing points for the bearing, eqs. 14-15 for the distances) as one weighted estimate:
all lines of both families vote for the one bearing, each end with its own pixel noise, while the mount's height, pan,
tilt and roll may move within their covariance, for all lines together. So parallel lines that look skewed correct the
tilt.

A line n . p = d on the ground and the camera at (c, h) span a plane with the normal v = (n, (d - n . c) / h): an end
seen along the ray r (robot frame) is on the line when v . r = 0. That stays linear in r up to the horizon, unlike the
ground point itself. Its first part has unit length, so that no error can be made small by shrinking the world.
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
_LONGEST_STEP_SIGMAS = 2.0  # of the mount, so that a false line cannot throw the camera away
_MISFIT_SIGMAS = 3.5


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
    while len(segments.observed):
        # an odd number of quarter turns away from the bearing is family 1
        families = np.rint((segments.bearing_rad - bearing) / (np.pi / 2)).astype(np.intp) % 2
        fit = _fit(mount, segments, families, bearing)
        if fit.settled and fit.against.max() < _MISFIT_SIGMAS**2:
            extents, sigmas = _extents(segments, families, fit)
            return GroundLines(
                bearing_rad=fit.bearing_rad,
                families=families,
                distances_m=fit.distances_m,
                extents_m=extents,
                extents_sigma_m=sigmas,
                covariance=fit.covariance,
                observed=segments.observed,
                chi_square=fit.chi_square,
                pixel_covariance=fit.pixel_covariance,
                by_mount=fit.by_mount,
            )
        segments = segments.only(np.arange(len(families)) != fit.against.argmax())
    return None


@dataclass(frozen=True, slots=True)
class _Fit:
    bearing_rad: float
    distances_m: FloatArray
    covariance: FloatArray
    pixel_covariance: FloatArray
    by_mount: FloatArray
    chi_square: float
    against: FloatArray  # (n,) how much chi_square would fall without each line, to first order
    settled: bool
    mount: CameraMount  # as the lines correct it
    shared_covariance: FloatArray  # (5, 5) of (bearing, height, pan, tilt, roll) after that


def _fit(mount: CameraMount, segments: LineSegments, families: NDArray[np.intp], bearing: float) -> _Fit:
    """Gauss-Newton over (bearing, n distances, 4 whitened errors of the mount)."""
    lines = slice(1, 1 + len(families))
    shared = slice(1 + len(families), None)
    root = _square_root(mount.covariance)
    first = _first_distances(mount, segments, families, bearing)
    x = np.concatenate([[bearing], first, np.zeros(4)])
    for _ in range(_ITERATIONS):
        moved = _moved(mount, root @ x[shared])
        if moved.height_m <= 0:
            break
        residual, jacobian, weight = linearised(moved, root, segments, families, float(x[0]), x[lines])
        information = np.einsum("nea,nef,nfb->ab", jacobian, weight, jacobian)
        information[shared, shared] += np.eye(4)
        gradient = np.einsum("nea,nef,nf->a", jacobian, weight, residual)
        gradient[shared] += x[shared]
        covariance = np.linalg.inv(information)
        step = covariance @ gradient
        settled = bool(gradient @ step < _CONVERGED)
        if settled:
            break
        x = x - step * min(1.0, _LONGEST_STEP_SIGMAS / max(float(np.abs(step[shared]).max()), 1e-9))
    misfit = np.einsum("ne,nef,nf->n", residual, weight, residual)
    # each line has two residuals; its redundancy is what its own distance and its say in the rest leave over of them
    redundancy = 2.0 - np.einsum("nea,nef,nfb,ab->n", jacobian, weight, jacobian, covariance)
    # another mount moves the residuals, and the estimate follows
    to_mount = linearised(moved, np.eye(4), segments, families, float(x[0]), x[lines])[1][..., shared]
    by_mount = -covariance @ np.einsum("nea,nef,nfb->ab", jacobian, weight, to_mount)
    from_mount = covariance[: lines.stop, shared]
    to_shared = np.zeros((5, len(x)))
    to_shared[0, 0] = 1.0
    to_shared[1:, shared] = root
    return _Fit(
        bearing_rad=float(x[0]),
        distances_m=x[lines],
        covariance=covariance[: lines.stop, : lines.stop],
        pixel_covariance=covariance[: lines.stop, : lines.stop] - from_mount @ from_mount.T,
        by_mount=by_mount[: lines.stop],
        chi_square=float(misfit.sum() + x[shared] @ x[shared]),
        against=np.where(redundancy > 1e-6, misfit / np.maximum(redundancy, 1e-6), 0.0),
        settled=settled,
        mount=moved,
        shared_covariance=to_shared @ covariance @ to_shared.T,
    )


def linearised(
    mount: CameraMount,
    root: FloatArray,
    segments: LineSegments,
    families: NDArray[np.intp],
    bearing: float,
    distances_m: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """v . r of both ends (n, 2), its Jacobian (n, 2, 1 + n + 4) and the inverse of its pixel covariance (n, 2, 2).

    The Jacobian is to the bearing, the distances and the mount's whitened error e: (height, pan, tilt, roll) + root e.
    """
    count = len(families)
    index = np.arange(count)
    height, centre = mount.height_m, np.array([mount.x_m, mount.y_m])
    rotation = robot_from_camera(mount)
    rays = segments.rays @ rotation.T
    normal, normal_slope = _normals(families, bearing)
    plane = np.column_stack([normal, (distances_m - normal @ centre) / height])
    plane_slope = np.column_stack([normal_slope, -normal_slope @ centre / height])
    to_height = -plane[:, 2:] * rays[..., 2] / height
    to_attitude = cross(rays, plane[:, None]) @ attitude_axes(mount).T
    jacobian = np.zeros((count, 2, 1 + count + 4))
    jacobian[..., 0] = np.einsum("nk,nek->ne", plane_slope, rays)
    jacobian[index, :, 1 + index] = rays[..., 2] / height
    jacobian[..., 1 + count :] = np.concatenate([to_height[..., None], to_attitude], axis=-1) @ root
    to_pixel = np.einsum("nk,nekp->nep", plane @ rotation, segments.ray_to_pixel)
    own = segments.covariance_px2.reshape(count, 2, 2, 2, 2)
    weight = np.linalg.inv(np.einsum("nep,nepfq,nfq->nef", to_pixel, own, to_pixel))
    return np.einsum("nk,nek->ne", plane, rays), jacobian, weight


def _first_distances(
    mount: CameraMount, segments: LineSegments, families: NDArray[np.intp], bearing: float
) -> FloatArray:
    """(n,) of the middle between each segment's ground points."""
    rays = segments.rays @ robot_from_camera(mount).T
    points = np.array([mount.x_m, mount.y_m]) + mount.height_m * rays[..., :2] / -rays[..., 2:]
    return np.asarray(np.sum(points.mean(axis=1) * _normals(families, bearing)[0], axis=-1))


def _extents(segments: LineSegments, families: NDArray[np.intp], fit: _Fit) -> tuple[FloatArray, FloatArray]:
    """Where the ends are along their lines, lower first, and the standard deviations (n, 2) each."""
    rotation = robot_from_camera(fit.mount)
    rays = segments.rays @ rotation.T
    down = np.maximum(-rays[..., 2], 1e-9)  # the fit may have lifted a far end to the horizon
    along, along_slope = _normals(1 - families, fit.bearing_rad)  # each family runs along the other's normal
    ahead = np.einsum("nk,nek->ne", along, rays[..., :2]) / down  # in heights
    to_ray = np.empty_like(rays)
    to_ray[..., :2] = along[:, None]
    to_ray[..., 2] = ahead
    to_ray *= (fit.mount.height_m / down)[..., None]
    centre = np.array([fit.mount.x_m, fit.mount.y_m])
    points = centre + fit.mount.height_m * rays[..., :2] / down[..., None]
    to_bearing = np.einsum("nk,nek->ne", along_slope, points)
    to_attitude = cross(rays, to_ray) @ attitude_axes(fit.mount).T
    to_shared = np.concatenate([to_bearing[..., None], ahead[..., None], to_attitude], axis=-1)
    to_pixel = np.einsum("nek,nekp->nep", to_ray @ rotation, segments.ray_to_pixel)
    own = np.stack([segments.covariance_px2[:, :2, :2], segments.covariance_px2[:, 2:, 2:]], axis=1)
    variance = np.einsum("nep,nepq,neq->ne", to_pixel, own, to_pixel)
    variance += np.einsum("nea,ab,neb->ne", to_shared, fit.shared_covariance, to_shared)
    ends = np.einsum("nk,nek->ne", along, points)
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
