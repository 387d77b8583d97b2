"""Line observations of one image as rays to their ends, and which of them agree on the field's two directions."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray

_HORIZON_SIGMAS = 4.0  # closer to the horizon a distance h / tan(angle) is no longer linear in the angle's error
_MAX_BEARING_SIGMA_RAD = np.pi / 12  # three sigmas fill the quarter turn: such a segment says nothing about the bearing
_GATE_SIGMAS = 3.0  # of the difference between the bearings of two segments


@dataclass(frozen=True, slots=True)
class LineSegments:
    """The usable ones of an image's line observations.

    observed: (n,) their indices among the observations. rays: (n, 2, 3) unit rays to both ends, camera frame;
    ray_to_pixel (n, 2, 3, 2) their Jacobians. covariance_px2: (n, 4, 4) as observed.
    normals: (n, 3) of the planes through the camera and both ends, camera frame, not of unit length.
    bearing_rad: (n,) of each segment in the robot frame, modulo pi; bearing_covariance (n, n) with the mount's noise,
    bearing_variance (n,) without; bearing_by_attitude (n, 3) change with pan, tilt and roll.
    """

    observed: NDArray[np.intp]
    rays: FloatArray
    ray_to_pixel: FloatArray
    covariance_px2: FloatArray
    normals: FloatArray
    bearing_rad: FloatArray
    bearing_covariance: FloatArray
    bearing_variance: FloatArray
    bearing_by_attitude: FloatArray

    def only(self, chosen: NDArray[np.bool_]) -> "LineSegments":
        """Those where the mask (n,) is True."""
        if chosen.all():
            return self
        return LineSegments(
            self.observed[chosen],
            self.rays[chosen],
            self.ray_to_pixel[chosen],
            self.covariance_px2[chosen],
            self.normals[chosen],
            self.bearing_rad[chosen],
            self.bearing_covariance[np.ix_(chosen, chosen)],
            self.bearing_variance[chosen],
            self.bearing_by_attitude[chosen],
        )


def usable_segments(
    camera: Camera, mount: CameraMount, observations: tuple[LineObservation, ...]
) -> LineSegments | None:
    """Those with finite distinct ends clearly below the horizon, a proper covariance and a bearing worth the name.

    None where there is none, or where the camera is not above the ground.
    """
    parameters = (mount.height_m, mount.pan_rad, mount.tilt_rad, mount.roll_rad, mount.x_m, mount.y_m)
    if not observations or mount.height_m <= 0 or not all(map(math.isfinite, parameters)):
        return None
    if not np.isfinite(mount.covariance).all():
        return None
    ends = np.array([line.ends_px for line in observations], dtype=np.float64)
    noise = np.array([line.covariance_px2 for line in observations], dtype=np.float64)
    good = np.asarray(np.isfinite(ends).all(axis=(1, 2)) & np.isfinite(noise).all(axis=(1, 2)))
    rays, ray_to_pixel, exist = camera.ray_and_jacobian(ends)
    good &= exist.all(axis=1)
    good[good] = _positive_definite(noise[good])
    index = np.flatnonzero(good)
    if not len(index):
        return None
    if len(index) < len(good):
        rays, ray_to_pixel, noise = rays[index], ray_to_pixel[index], noise[index]
    rotation, axes, attitude = robot_from_camera(mount), attitude_axes(mount), mount.covariance[1:, 1:]
    directions, to_pixel = rays @ rotation.T, rotation @ ray_to_pixel
    normals = cross(rays[:, 0], rays[:, 1])
    upright = normals @ rotation.T
    level2 = upright[:, 0] ** 2 + upright[:, 1] ** 2
    good = _below_horizon(directions, to_pixel, noise, axes, attitude) & (level2 > 1e-24)  # or else the ends coincide
    if not good.all():
        directions, to_pixel, noise, normals = directions[good], to_pixel[good], noise[good], normals[good]
        upright, level2, rays, ray_to_pixel, index = (
            upright[good],
            level2[good],
            rays[good],
            ray_to_pixel[good],
            index[good],
        )
    # the line runs where the plane through the camera and the segment cuts the horizontal: normal x up
    turned = np.zeros((len(index), 1, 3))
    turned[:, 0, 0], turned[:, 0, 1] = upright[:, 1] / level2, -upright[:, 0] / level2
    to_ends = cross(turned, directions[:, ::-1])
    to_ends[:, 1] *= -1.0
    by_pixel = (to_ends[:, :, None] @ to_pixel).reshape(-1, 1, 4)
    own = (by_pixel @ noise @ by_pixel.swapaxes(1, 2))[:, 0, 0]
    by_attitude = bearing_by_attitude(upright, level2, axes)
    covariance = by_attitude @ attitude @ by_attitude.T
    covariance.flat[:: len(own) + 1] += own
    bearing = np.arctan2(-upright[:, 0], upright[:, 1])
    segments = LineSegments(index, rays, ray_to_pixel, noise, normals, bearing, covariance, own, by_attitude)
    sharp = covariance.diagonal() - mount.covariance[1, 1] < _MAX_BEARING_SIGMA_RAD**2
    return segments.only(sharp) if sharp.any() else None


def bearing_by_attitude(upright: FloatArray, level2: FloatArray, axes: FloatArray) -> FloatArray:
    """(n, 3): change of bearings with (pan, tilt, roll), of planes with normals (n, 3) in the robot frame.

    level2: (n,) squared length of the normals' level part.
    """
    slant = -upright[:, 2] / level2
    return np.asarray((slant[:, None] * upright[:, :2]) @ axes[:, :2].T + axes[:, 2])


def agreeing(segments: LineSegments) -> tuple[NDArray[np.bool_], float]:
    """Which segments run along or across one common bearing, and that bearing in [-pi/4, pi/4).

    The bearing with the smallest truncated sum of squares wins, each segment's own being tried: circular statistics
    modulo 90 degrees, in which a few lines that belong to neither family have no say.
    """
    bearing, covariance = segments.bearing_rad, segments.bearing_covariance
    variance = covariance.diagonal()
    difference = modulo_quarter(bearing[:, None] - bearing[None, :])
    # the pan, and most of the tilt between neighbours, cancels in a difference
    spread = variance[:, None] + variance[None, :] - 2 * covariance
    spread = np.maximum(spread, 1e-12 * variance[:, None])
    squared = np.minimum(difference * difference / spread, _GATE_SIGMAS**2)
    total = squared.sum(axis=1).round(9).tolist()
    best = min(range(len(total)), key=lambda row: (total[row], variance[row]))
    agree = squared[best] < _GATE_SIGMAS**2
    fourfold, weight = 4.0 * bearing, agree / variance
    angle = 0.25 * math.atan2(np.sin(fourfold) @ weight, np.cos(fourfold) @ weight)
    return agree, _modulo_quarter(angle)


def modulo_quarter(angle_rad: FloatArray | float) -> FloatArray:
    """Angle modulo 90 degrees in [-pi/4, pi/4), any shape."""
    return np.asarray((np.asarray(angle_rad) + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _modulo_quarter(angle_rad: float) -> float:
    return (angle_rad + math.pi / 4) % (math.pi / 2) - math.pi / 4


def _positive_definite(matrices: FloatArray) -> NDArray[np.bool_] | bool:
    """(n,) of symmetric (n, m, m)."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(matrices)[:, 0] > 0)
    return True


def _below_horizon(
    directions: FloatArray, to_pixel: FloatArray, covariance_px2: FloatArray, axes: FloatArray, attitude: FloatArray
) -> NDArray[np.bool_]:
    """(n,) of directions (n, 2, 3) in the robot frame: by more than noise of the pixels and the attitude can make."""
    by_pixel = to_pixel[:, :, 2, :]
    blocks = covariance_px2.reshape(-1, 2, 2, 2, 2)
    variance = np.einsum("nep,nepeq,neq->ne", by_pixel, blocks, by_pixel)
    # how an end rises as the camera turns about an axis: axis x direction, of which the upward part
    rise = directions[..., :2] @ np.stack([-axes[:, 1], axes[:, 0]])
    variance += ((rise @ attitude) * rise).sum(axis=-1)
    return np.asarray((-directions[..., 2] > _HORIZON_SIGMAS * np.sqrt(variance)).all(axis=1))
