"""Where the posts of an image stand, from their feet on the ground and from their widths, together (errata 6).

A camera of known height and tilt sees a post's foot under the horizon, and how far under says how far away; a camera of
known focal length sees a post of known diameter so and so wide. Both are linear in the inverse of the distance, so that
is what is estimated: per post (bearing, 1 / distance) of its axis from the point on the ground below the camera,
bearings from the robot's forward axis. Height, pan, tilt and roll move everything in one image together, so all posts
share one covariance.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fieldloc.camera import Camera
from fieldloc.covariance import check_covariance, propagate
from fieldloc.fixes.cylinder import axis_from_edges
from fieldloc.fixes.inputs import exactly, semidefinite
from fieldloc.fixes.post_fix import PostFix, fix_of_robot
from fieldloc.fixes.ranged_posts import fix_ranged_posts
from fieldloc.fixes.sizes import InverseRanges
from fieldloc.ground import attitude_axes, cross, ground_jacobians, robot_from_camera, robot_ground_points
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.pose import FloatArray, wrap

_BY_BEARING_AND_SIZE = [0, 2, 1, 3]  # (b1, i1, b2, i2) in the order of the two-post solvers


@dataclass(frozen=True, slots=True)
class PostSights:
    """Posts as seen from the point on the ground below the camera.

    seen: which of the image's posts, in their order.
    bearing_inverse_range: (n, 2) radians from the robot's forward axis, 1 / m.
    covariance: (2n, 2n) of b1, i1, b2, i2, ...; noise of the pixels and of the mount.
    chi2: of feet against widths, chi-square of `redundancy` degrees: whether height, tilt and diameter agree.
    """

    seen: tuple[int, ...]
    bearing_inverse_range: FloatArray
    covariance: FloatArray
    chi2: float = 0.0
    redundancy: int = 0

    @property
    def range_bearing(self) -> FloatArray:
        """(n, 2) metres, radians."""
        bearing, inverse = np.moveaxis(self.bearing_inverse_range, -1, 0)
        return np.stack([1 / inverse, bearing], axis=-1)

    @property
    def range_bearing_covariance(self) -> FloatArray:
        """(2n, 2n) of r1, b1, r2, b2, ..., first-order."""
        jacobian = np.zeros((2 * len(self.seen), 2 * len(self.seen)))
        for i, inverse in enumerate(self.bearing_inverse_range[:, 1]):
            jacobian[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, -1 / inverse**2], [1.0, 0.0]]
        return propagate(jacobian, self.covariance)


class _Sight(NamedTuple):
    """One (bearing, inverse range) (2,), its covariance (2, 2) by the pixels and its change (2, 4) with the mount."""

    post: int
    value: FloatArray
    noise: FloatArray
    by_mount: FloatArray


def sight_posts(
    camera: Camera, mount: CameraMount, posts: tuple[PostObservation, ...], radius_m: float | None = None
) -> PostSights:
    """Bearing and distance of all posts that show their foot, or their width where the posts' radius is given.

    foot_px is taken as the middle of the visible contact with the ground, a radius in front of the axis. Posts that
    show nothing of use (a foot on or above the horizon, edges in the wrong order, NaN) are left out. ValueError for a
    foot without a covariance, covariances that are none, and pixels so exact that nothing could be weighed.
    """
    if radius_m is not None and not radius_m > 0:
        raise ValueError(f"radius_m is {radius_m}, must be positive or None")
    mount_noise = exactly(semidefinite(mount.covariance, 4, "mount.covariance"), (4, 4), "mount.covariance")
    sights = []
    for index, post in enumerate(posts):
        if radius_m is not None:
            sights += _width(camera, mount, index, post, radius_m)
        sights += _foot(camera, mount, index, post, 0.0 if radius_m is None else radius_m)
    seen = tuple(sorted({sight.post for sight in sights}))
    if not seen:
        return PostSights((), np.zeros((0, 2)), np.zeros((0, 0)))
    return _fused(seen, sights, mount_noise)


def fix_two_posts_of_image(
    camera: Camera,
    mount: CameraMount,
    posts: tuple[PostObservation, PostObservation],
    positions: FloatArray,
    radius_m: float | None = None,
    positions_covariance: FloatArray | None = None,
) -> tuple[PostFix, ...]:
    """The robot's poses, most likely first, from two identified posts at positions (2, 2), as `fix_ranged_posts`.

    Empty where not both posts show their distance.
    """
    if len(posts) != 2:
        raise ValueError(f"{len(posts)} posts, needs 2")
    sights = sight_posts(camera, mount, posts, radius_m)
    if len(sights.seen) < 2:
        return ()
    bearings, inverse_ranges = np.moveaxis(sights.bearing_inverse_range, -1, 0)
    covariance = sights.covariance[np.ix_(_BY_BEARING_AND_SIZE, _BY_BEARING_AND_SIZE)]
    fixes = fix_ranged_posts(bearings, inverse_ranges, covariance, positions, InverseRanges(), positions_covariance)
    below_camera = np.array([mount.x_m, mount.y_m, 0.0])
    return tuple(fix_of_robot(fix, below_camera) for fix in fixes)


def _foot(camera: Camera, mount: CameraMount, index: int, post: PostObservation, radius_m: float) -> list[_Sight]:
    if post.foot_px is None:
        return []
    if post.foot_covariance_px2 is None:
        raise ValueError(f"post {index} has a foot_px without a foot_covariance_px2")
    pixel_noise = exactly(semidefinite(post.foot_covariance_px2, 2), (2, 2), "foot_covariance_px2")
    pixel = exactly(post.foot_px, (2,), "foot_px")
    point, mask = robot_ground_points(camera, mount, pixel)
    x, y = point - np.array([mount.x_m, mount.y_m])
    reach = np.hypot(x, y)
    if not mask or reach == 0:
        return []
    by_pixel, by_mount = ground_jacobians(camera, mount, pixel)
    distance = reach + radius_m
    by_point = np.array([[-y / reach**2, x / reach**2], np.array([-x, -y]) / (reach * distance**2)])
    value = np.array([np.arctan2(y, x), 1 / distance])
    return [_Sight(index, value, propagate(by_point @ by_pixel, pixel_noise), by_point @ by_mount)]


def _width(camera: Camera, mount: CameraMount, index: int, post: PostObservation, radius_m: float) -> list[_Sight]:
    """A vertical edge has one bearing at any height: sin(half-width) / radius is the inverse distance, exactly."""
    pixel_noise = exactly(semidefinite(post.covariance_px2, 4), (4, 4), "covariance_px2")
    pixels = exactly(post.edges_px, (2, 2), "edges_px")
    rays, rays_by_pixels, mask = camera.ray_and_jacobian(pixels)
    if not np.all(mask):
        return []
    rotation = robot_from_camera(mount)
    directions = rays @ rotation.T
    level = np.hypot(directions[:, 0], directions[:, 1])
    if np.any(level == 0):
        return []
    edges = np.arctan2(directions[:, 1], directions[:, 0])
    axis, is_post = axis_from_edges(edges)
    if not is_post:
        return []
    by_direction = np.zeros((2, 1, 3))
    by_direction[:, 0, :2] = np.stack([-directions[:, 1], directions[:, 0]], axis=-1) / level[:, None] ** 2
    by_ray_pixels = by_direction @ rotation @ rays_by_pixels
    by_turns = by_direction @ np.swapaxes(cross(attitude_axes(mount), directions[:, None, :]), -1, -2)
    by_edges = np.array([[0.5, 0.5], [0.5, -0.5]]) * np.array([[1.0], [np.cos(axis[1]) / radius_m]])
    edges_by_pixels = np.zeros((2, 4))
    edges_by_pixels[0, :2], edges_by_pixels[1, 2:] = by_ray_pixels[0, 0], by_ray_pixels[1, 0]
    by_mount = np.concatenate([np.zeros((2, 1)), by_edges @ by_turns[:, 0]], axis=1)
    value = np.array([axis[0], np.sin(axis[1]) / radius_m])
    return [_Sight(index, value, propagate(by_edges @ edges_by_pixels, pixel_noise), by_mount)]


def _fused(seen: tuple[int, ...], sights: list[_Sight], mount_noise: FloatArray) -> PostSights:
    """Weighted least squares of (bearing, inverse range) per post, all sights and their shared noise at once."""
    count = 2 * len(sights)
    shared = np.concatenate([sight.by_mount for sight in sights])
    noise = propagate(shared, mount_noise)
    design = np.zeros((count, 2 * len(seen)))
    first = {sight.post: sight.value for sight in reversed(sights)}
    offset = np.empty(count)
    for k, sight in enumerate(sights):
        rows, column = slice(2 * k, 2 * k + 2), 2 * seen.index(sight.post)
        noise[rows, rows] += sight.noise
        design[rows, column : column + 2] = np.eye(2)
        difference = sight.value - first[sight.post]
        offset[rows] = [float(wrap(difference[0])), difference[1]]
    weight = np.linalg.inv(check_covariance(noise, count, "the noise of the posts' pixels"))
    covariance = np.asarray(np.linalg.inv(design.T @ weight @ design))
    correction = covariance @ design.T @ weight @ offset
    residual = offset - design @ correction
    estimate = np.array([first[post] for post in seen]) + correction.reshape(-1, 2)
    estimate[:, 0] = wrap(estimate[:, 0])
    # at the horizon two sights can agree on a post beyond infinity
    near = estimate[:, 1] > 0
    kept = np.repeat(near, 2)
    return PostSights(
        seen=tuple(post for post, is_near in zip(seen, near, strict=True) if is_near),
        bearing_inverse_range=estimate[near],
        covariance=0.5 * (covariance + covariance.T)[np.ix_(kept, kept)],
        chi2=float(residual @ weight @ residual),
        redundancy=count - 2 * len(seen),
    )
