"""Four numbers for every post of an image, with their changes with the pixels and with the camera's mount.

The bearing and the inverse distance of the post's axis from the point below the camera: by its foot on the ground, and
by its two edges (see `fieldloc.fixes.post_feet`, which has them one by one and fused).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.pose import FloatArray, wrap

NUMBERS = 4  # foot's bearing and inverse distance, edges' bearing and inverse distance
_LEAST_PX2 = 1e-4  # no pixel is exacter
_NO_FOOT = np.full(2, np.nan)
_LEFT, _RIGHT, _FOOT = 0, 1, 2


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
    rotation = robot_from_camera(mount)
    directions = rays @ rotation.T
    # change of the three directions (p, 3, 3) with their own (u, v) and with (pan, tilt, roll)
    by_all = np.empty((len(posts), 3, 3, 5))
    by_all[..., :2] = rotation @ to_pixels
    by_all[..., 2:] = np.swapaxes(cross(attitude_axes(mount), directions[..., None, :]), -1, -2)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    level2 = np.maximum(x * x + y * y, 1e-12)
    bearing = np.arctan2(y, x)
    to_bearing = np.zeros((len(posts), 3, 1, 3))
    to_bearing[:, :, 0, 0], to_bearing[:, :, 0, 1] = -y / level2, x / level2
    turned = (to_bearing @ by_all)[:, :, 0]

    values, jacobian = np.empty((len(posts), NUMBERS)), np.zeros((len(posts), NUMBERS, 6))
    by_mount, seen = np.zeros((len(posts), NUMBERS, 4)), np.empty((len(posts), NUMBERS), dtype=np.bool_)
    # the foot
    x, y, down, level2 = x[:, _FOOT], y[:, _FOOT], -z[:, _FOOT], level2[:, _FOOT]
    below = down > 1e-9
    reach = mount.height_m * np.sqrt(level2) / np.where(below, down, 1.0)
    values[:, 0], values[:, 1] = bearing[:, _FOOT], 1.0 / (reach + radius_m)
    slope = -reach * values[:, 1] ** 2  # by the reach's relative change
    to_foot = np.stack([x / level2, y / level2, 1.0 / np.where(below, down, 1.0)], axis=-1)[:, None]
    lengthened = slope[:, None] * (to_foot @ by_all[:, _FOOT])[:, 0]
    jacobian[:, 0, 4:], by_mount[:, 0, 1:] = turned[:, _FOOT, :2], turned[:, _FOOT, 2:]
    jacobian[:, 1, 4:], by_mount[:, 1, 1:] = lengthened[:, :2], lengthened[:, 2:]
    by_mount[:, 1, 0] = slope / mount.height_m
    seen[:, :2] = (below & exists[:, _FOOT])[:, None]
    # the edges: the axis is in their middle, and the sine of half their angle is the radius over the distance
    left, right = turned[:, _LEFT], turned[:, _RIGHT]
    half = 0.5 * wrap(bearing[:, _LEFT] - bearing[:, _RIGHT])
    scale = 1.0 / radius_m if radius_m > 0.0 else 0.0
    values[:, 2], values[:, 3] = bearing[:, _RIGHT] + half, scale * np.sin(half)
    gain = (0.5 * scale * np.cos(half))[:, None]
    jacobian[:, 2, :2], jacobian[:, 2, 2:4], by_mount[:, 2, 1:] = (
        0.5 * left[:, :2],
        0.5 * right[:, :2],
        0.5 * (left + right)[:, 2:],
    )
    jacobian[:, 3, :2], jacobian[:, 3, 2:4], by_mount[:, 3, 1:] = (
        gain * left[:, :2],
        -gain * right[:, :2],
        gain * (left - right)[:, 2:],
    )
    wide = (half > 0.0) & (half < 0.5 * np.pi) & (radius_m > 0.0)
    seen[:, 2:] = (wide & exists[:, _LEFT] & exists[:, _RIGHT])[:, None]
    if not seen.all():
        values[~seen] = 0.0
        jacobian[~seen] = 0.0
        by_mount[~seen] = 0.0
    return PostNumbers(values, by_mount, jacobian @ noise @ np.swapaxes(jacobian, -1, -2), seen)


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
    noise[:, range(6), range(6)] += _LEAST_PX2
    return pixels, noise
