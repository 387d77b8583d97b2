"""Four numbers for every post of an image, with their changes with the pixels and with the camera's mount.

The bearing and the inverse distance of the post's axis from the point below the camera: by its foot on the ground, and
by its two edges (see `fieldloc.fixes.post_feet`, which has them one by one and fused).

A post by itself is worked out in plain numbers: an image has so few that arrays cost several times as much.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import attitude_axes, robot_from_camera
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.pose import FloatArray

NUMBERS = 4  # foot's bearing and inverse distance, edges' bearing and inverse distance
_LEAST_PX2 = 1e-4  # no pixel is exacter
_NO_FOOT = np.full(2, np.nan)
_LEAST_NOISE = _LEAST_PX2 * np.eye(6)
_NOTHING = [0.0] * 6


@dataclass(frozen=True, slots=True, eq=False)
class PostNumbers:
    """values: (p, 4). by_mount: (p, 4, 4) change with (height, pan, tilt, roll). covariance: (p, 4, 4) of the pixels'
    noise. seen: (p, 4). All zero where not seen."""

    values: FloatArray
    by_mount: FloatArray
    covariance: FloatArray
    seen: NDArray[np.bool_]


def post_numbers(posts: list[PostObservation], camera: Camera, mount: CameraMount, radius_m: float) -> PostNumbers:
    """radius_m 0 where the posts' is not known: then edges say nothing. ValueError for a foot without a covariance."""
    pixels, noise = _pixels(posts)
    rays, to_pixels, exists = camera.ray_and_jacobian(pixels)
    rotation, axes = robot_from_camera(mount), attitude_axes(mount).tolist()
    values, by_pixels, by_mount, seen = [], [], [], []
    for ends, by_own, (has_left, has_right, has_foot) in zip(
        (rays @ rotation.T).tolist(), (rotation @ to_pixels).tolist(), exists.tolist(), strict=True
    ):
        left, right, foot = (_direction(end, change, axes) for end, change in zip(ends, by_own, strict=True))
        by_foot = _of_foot(foot, mount.height_m, radius_m) if has_foot else None
        by_edges = _of_edges(left, right, radius_m) if has_left and has_right else None
        for two in (by_foot, by_edges):
            values += [two.bearing, two.inverse] if two else _NOTHING[:2]
            by_pixels += [two.bearing_by_pixels, two.inverse_by_pixels] if two else [_NOTHING, _NOTHING]
            by_mount += [two.bearing_by_mount, two.inverse_by_mount] if two else [_NOTHING[:4], _NOTHING[:4]]
            seen += [two is not None] * 2
    count = len(posts)
    jacobian = np.array(by_pixels).reshape(count, NUMBERS, 6)
    return PostNumbers(
        np.array(values).reshape(count, NUMBERS),
        np.array(by_mount).reshape(count, NUMBERS, 4),
        jacobian @ noise @ jacobian.swapaxes(1, 2),
        np.array(seen).reshape(count, NUMBERS),
    )


class _Direction(NamedTuple):
    """To an end of a post, in the robot's axes: its bearing, and how much farther it reaches on the ground than the
    camera is high, 0 where it does not. Changes with (u, v, pan, tilt, roll) of the bearing and of the log of reach."""

    bearing: float
    reach: float
    bearing_by: list[float]
    reach_by: list[float]


def _direction(ray: list[float], by_pixel: list[list[float]], axes: list[list[float]]) -> _Direction:
    """Of a ray (3,), its change with the pixel (3, 2), and the axes of pan, tilt and roll (3, 3)."""
    x, y, z = ray
    (xu, xv), (yu, yv), (zu, zv) = by_pixel
    level2 = max(x * x + y * y, 1e-12)
    # a turn about the axis a moves the ray by a x ray
    bearing_by = [(x * yu - y * xu) / level2, (x * yv - y * xv) / level2]
    bearing_by += [c - (a * x + b * y) * z / level2 for a, b, c in axes]
    if not z < -1e-9:
        return _Direction(math.atan2(y, x), 0.0, bearing_by, [])
    rise = z / level2 + 1.0 / z
    reach_by = [(x * xu + y * yu) / level2 - zu / z, (x * xv + y * yv) / level2 - zv / z]
    reach_by += [(b * x - a * y) * rise for a, b, _ in axes]
    return _Direction(math.atan2(y, x), math.sqrt(level2) / -z, bearing_by, reach_by)


class _Two(NamedTuple):
    """Bearing and inverse distance, and their changes with the pixels of left edge, right edge and foot (6,) and with
    the mount (4,)."""

    bearing: float
    inverse: float
    bearing_by_pixels: list[float]
    inverse_by_pixels: list[float]
    bearing_by_mount: list[float]
    inverse_by_mount: list[float]


def _of_foot(foot: _Direction, height_m: float, radius_m: float) -> _Two | None:
    """None where the foot is not below the horizon."""
    if not foot.reach:
        return None
    inverse = 1.0 / (height_m * foot.reach + radius_m)
    slope = inverse * (radius_m * inverse - 1.0)  # with the log of reach
    by = [slope * change for change in foot.reach_by]
    return _Two(
        foot.bearing, inverse, [0.0] * 4 + foot.bearing_by[:2], [0.0] * 4 + by[:2],
        [0.0, *foot.bearing_by[2:]], [slope / height_m, *by[2:]],
    )  # fmt: skip


def _of_edges(left: _Direction, right: _Direction, radius_m: float) -> _Two | None:
    """The axis is in the edges' middle, and the sine of half their angle is the radius over the distance.

    None where the edges are not in their order, or the radius is not known.
    """
    half = 0.5 * math.remainder(left.bearing - right.bearing, math.tau)
    if not (0.0 < half < 0.5 * math.pi and radius_m > 0.0):
        return None
    middle = [0.5 * change for change in left.bearing_by], [0.5 * change for change in right.bearing_by]
    scale = math.cos(half) / radius_m
    width = [scale * change for change in middle[0]], [-scale * change for change in middle[1]]
    return _Two(
        right.bearing + half, math.sin(half) / radius_m,
        [*middle[0][:2], *middle[1][:2], 0.0, 0.0], [*width[0][:2], *width[1][:2], 0.0, 0.0],
        [0.0, *map(sum, zip(middle[0][2:], middle[1][2:], strict=True))],
        [0.0, *map(sum, zip(width[0][2:], width[1][2:], strict=True))],
    )  # fmt: skip


def _pixels(posts: list[PostObservation]) -> tuple[FloatArray, FloatArray]:
    """Left edge, right edge, foot (p, 3, 2), NaN for a foot that is not seen; covariance (p, 6, 6)."""
    pixels, noise = np.empty((len(posts), 3, 2)), np.zeros((len(posts), 6, 6))
    for row, post in enumerate(posts):
        pixels[row, :2] = post.edges_px
        pixels[row, 2] = _NO_FOOT if post.foot_px is None else post.foot_px
        noise[row, :4, :4] = post.covariance_px2
        if post.foot_px is not None:
            if post.foot_covariance_px2 is None:
                raise ValueError("a post has a foot_px without a foot_covariance_px2")
            noise[row, 4:, 4:] = post.foot_covariance_px2
    noise += _LEAST_NOISE
    return pixels, noise
