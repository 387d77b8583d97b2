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
    count = len(posts)
    pixels, noise = _pixels(posts)
    rays, to_pixels, exists = camera.ray_and_jacobian(pixels)
    if not exists.all():
        rays, to_pixels = np.where(exists[..., None], rays, 0.0), np.where(exists[..., None, None], to_pixels, 0.0)
    rotation = robot_from_camera(mount)
    directions = rays @ rotation.T
    # change of the directions to left edge, right edge and foot with their own (u, v) and with (pan, tilt, roll)
    by_all = np.empty((count, 3, 3, 5))
    by_all[..., :2] = rotation @ to_pixels
    by_all[..., 2:] = cross(attitude_axes(mount), directions[..., None, :]).swapaxes(2, 3)
    x, y, down = directions[..., 0], directions[..., 1], -directions[..., 2]
    level2 = np.maximum(x * x + y * y, 1e-12)
    below = down > 1e-9
    down = np.where(below, down, 1.0)
    # of the directions' bearings, and of the logarithm of how far they reach on the ground
    to_polar = np.zeros((count, 3, 2, 3))
    to_polar[:, :, 1, 0], to_polar[:, :, 1, 1] = x / level2, y / level2
    to_polar[:, :, 0, 0], to_polar[:, :, 0, 1] = -to_polar[:, :, 1, 1], to_polar[:, :, 1, 0]
    to_polar[:, :, 1, 2] = 1.0 / down
    polar = (to_polar @ by_all).reshape(count, 6, 5)[:, [0, 2, 4, 5]]  # three bearings, and the foot's reach
    bearing = np.arctan2(y, x)
    half = 0.5 * wrap(bearing[:, _LEFT] - bearing[:, _RIGHT])
    # the axis is in the edges' middle, and the sine of half their angle is the radius over the distance
    scale = 1.0 / radius_m if radius_m > 0.0 else 0.0
    inverse = 1.0 / (mount.height_m * np.sqrt(level2[:, _FOOT]) / down[:, _FOOT] + radius_m)
    values = np.empty((count, NUMBERS))
    values[:, 0], values[:, 1] = bearing[:, _FOOT], inverse
    values[:, 2], values[:, 3] = bearing[:, _RIGHT] + half, scale * np.sin(half)
    slope = inverse * (radius_m * inverse - 1.0)
    mixed = np.zeros((count, NUMBERS, 4))
    mixed[:, 0, 2], mixed[:, 1, 3], mixed[:, 2, :2] = 1.0, slope, 0.5
    mixed[:, 3, 0] = 0.5 * scale * np.cos(half)
    mixed[:, 3, 1] = -mixed[:, 3, 0]
    seen = np.empty((count, NUMBERS), dtype=np.bool_)
    seen[:, :2] = (below & exists)[:, _FOOT, None]
    seen[:, 2:] = ((half > 0.0) & (half < 0.5 * np.pi) & (radius_m > 0.0) & exists[:, _LEFT] & exists[:, _RIGHT])[
        :, None
    ]
    by_mount = np.zeros((count, NUMBERS, 4))
    by_mount[:, 1, 0] = slope / mount.height_m
    by_mount[:, :, 1:] = mixed @ polar[:, :, 2:]
    by_pixels = mixed[..., None] * polar[:, None, :, :2]
    by_pixels[:, :, _FOOT] += by_pixels[:, :, 3]
    jacobian = by_pixels[:, :, :3].reshape(count, NUMBERS, 6)
    if not seen.all():
        values[~seen], jacobian[~seen], by_mount[~seen] = 0.0, 0.0, 0.0
    return PostNumbers(values, by_mount, jacobian @ noise @ jacobian.swapaxes(1, 2), seen)


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
