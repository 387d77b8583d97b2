"""Line observations of one image as rays to their ends, and which of them agree on the field's two directions."""

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
    bearing_rad: (n,) of each segment in the robot frame, modulo pi; bearing_covariance (n, n) with the mount's noise.
    """

    observed: NDArray[np.intp]
    rays: FloatArray
    ray_to_pixel: FloatArray
    covariance_px2: FloatArray
    bearing_rad: FloatArray
    bearing_covariance: FloatArray

    def only(self, chosen: NDArray[np.bool_]) -> "LineSegments":
        """Those where the mask (n,) is True."""
        return LineSegments(
            self.observed[chosen],
            self.rays[chosen],
            self.ray_to_pixel[chosen],
            self.covariance_px2[chosen],
            self.bearing_rad[chosen],
            self.bearing_covariance[np.ix_(chosen, chosen)],
        )


def usable_segments(
    camera: Camera, mount: CameraMount, observations: tuple[LineObservation, ...]
) -> LineSegments | None:
    """Those with finite distinct ends clearly below the horizon, a proper covariance and a bearing worth the name.

    None where there is none, or where the camera is not above the ground.
    """
    parameters = [mount.height_m, mount.pan_rad, mount.tilt_rad, mount.roll_rad, mount.x_m, mount.y_m]
    if not observations or mount.height_m <= 0 or not np.isfinite([*parameters, *mount.covariance.ravel()]).all():
        return None
    ends = np.array([line.ends_px for line in observations], dtype=np.float64)
    noise = np.array([line.covariance_px2 for line in observations], dtype=np.float64)
    index = np.flatnonzero(np.isfinite(ends).all(axis=(1, 2)) & np.isfinite(noise).all(axis=(1, 2)))
    index = index[np.linalg.eigvalsh(noise[index])[:, 0] > 0]
    rays, ray_to_pixel, exist = camera.ray_and_jacobian(ends[index])
    good = np.asarray(exist.all(axis=1))
    good[good] = _below_horizon(mount, rays[good], ray_to_pixel[good], noise[index[good]])
    level = cross(rays[:, 0], rays[:, 1]) @ robot_from_camera(mount)[:2].T
    good &= np.hypot(level[:, 0], level[:, 1]) > 1e-12  # otherwise the ends coincide
    index, rays, ray_to_pixel = index[good], rays[good], ray_to_pixel[good]
    bearing, covariance = _bearings(mount, rays, ray_to_pixel, noise[index])
    segments = LineSegments(index, rays, ray_to_pixel, noise[index], bearing, covariance)
    sharp = np.diagonal(covariance) - mount.covariance[1, 1] < _MAX_BEARING_SIGMA_RAD**2
    return segments.only(sharp) if sharp.any() else None


def agreeing(segments: LineSegments) -> tuple[NDArray[np.bool_], float]:
    """Which segments run along or across one common bearing, and that bearing in [-pi/4, pi/4).

    The bearing with the smallest truncated sum of squares wins, each segment's own being tried: circular statistics
    modulo 90 degrees, in which a few lines that belong to neither family have no say.
    """
    bearing, covariance = segments.bearing_rad, segments.bearing_covariance
    variance = np.diagonal(covariance)
    difference = modulo_quarter(bearing[:, None] - bearing[None, :])
    # the pan, and most of the tilt between neighbours, cancels in a difference
    spread = variance[:, None] + variance[None, :] - 2 * covariance
    spread = np.maximum(spread, 1e-12 * variance[:, None])
    squared = np.minimum(difference**2 / spread, _GATE_SIGMAS**2)
    np.fill_diagonal(squared, 0.0)
    best = int(np.lexsort((variance, squared.sum(axis=1).round(9)))[0])
    agree = squared[best] < _GATE_SIGMAS**2
    weighted = np.sum(np.exp(4j * bearing[agree]) / variance[agree])
    return agree, float(modulo_quarter(np.angle(weighted) / 4))


def modulo_quarter(angle_rad: FloatArray | float) -> FloatArray:
    """Angle modulo 90 degrees in [-pi/4, pi/4), any shape."""
    return np.asarray((np.asarray(angle_rad) + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _below_horizon(
    mount: CameraMount, rays: FloatArray, ray_to_pixel: FloatArray, covariance_px2: FloatArray
) -> NDArray[np.bool_]:
    rotation = robot_from_camera(mount)
    directions = rays @ rotation.T
    to_pixel = np.einsum("k,nekp->nep", rotation[2], ray_to_pixel)
    own = np.stack([covariance_px2[:, :2, :2], covariance_px2[:, 2:, 2:]], axis=1)
    variance = np.einsum("nep,nepq,neq->ne", to_pixel, own, to_pixel)
    to_attitude = cross(attitude_axes(mount), directions[..., None, :])[..., 2]
    variance += np.einsum("nea,ab,neb->ne", to_attitude, mount.covariance[1:, 1:], to_attitude)
    return np.asarray((-directions[..., 2] > _HORIZON_SIGMAS * np.sqrt(variance)).all(axis=1))


def _bearings(
    mount: CameraMount, rays: FloatArray, ray_to_pixel: FloatArray, covariance_px2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bearings (n,) of the ground lines in the robot frame, modulo pi, and their joint covariance (n, n).

    The line runs where the plane through the camera and the segment cuts the horizontal: normal x up.
    """
    rotation = robot_from_camera(mount)
    first, second = rays[:, 0] @ rotation.T, rays[:, 1] @ rotation.T
    normal = cross(first, second)
    turned = np.stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))], axis=-1)
    to_normal = turned / np.sum(turned**2, axis=-1, keepdims=True)
    to_directions = np.stack([cross(second, to_normal), cross(to_normal, first)], axis=1)
    to_pixel = np.einsum("nek,nekp->nep", to_directions @ rotation, ray_to_pixel).reshape(-1, 4)
    to_attitude = cross(normal, to_normal) @ attitude_axes(mount).T
    covariance = to_attitude @ mount.covariance[1:, 1:] @ to_attitude.T
    covariance += np.diag(np.einsum("np,npq,nq->n", to_pixel, covariance_px2, to_pixel))
    return np.arctan2(-normal[:, 0], normal[:, 1]), covariance
