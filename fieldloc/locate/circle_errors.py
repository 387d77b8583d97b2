"""Circles on the ground: how far the points seen of one are off it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.cameras import COLUMNS, ERROR, FAR_PX, FOCAL, TINY, Cameras, clipped
from fieldloc.locate.states import cross
from fieldloc.pose import FloatArray

_BLUR_PX = 2.35  # the width that a lens with a sigma of a pixel gives to a thread
_MOST_ASKEW2 = 10.0  # beyond, a ring as wide as usual is no thin one any more


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Of points, on the ground: distances to the circle's middle (k, c), directions from it (k, c, 2), how far out they
    go for each height of the camera (k, c); the distance's change with the ray (k, c, 3) and the pixel (k, c, 2), and
    the length of that (k, c), metres; errors (k, c) px."""

    rays: FloatArray
    below: NDArray[np.bool_]
    radial: FloatArray
    outward: FloatArray
    by_ray: FloatArray
    slope: FloatArray
    scale: FloatArray
    error: FloatArray

    @staticmethod
    def of(cameras: Cameras, circle: FloatArray) -> "_Seen":
        sight = cameras.sight
        rays = cameras.turned(sight.circle_rays)
        below = rays[..., 2] < -1e-3
        down = np.where(below, -rays[..., 2], 1.0)
        height = cameras.centre[:, 2:]
        level = rays[..., :2] / down[..., None]
        away = (cameras.centre[:, :2] - circle[:2])[:, None] + height[..., None] * level
        far = np.sqrt(np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2, 1e-12))
        radial = away / far[..., None]
        outward = radial[..., 0] * level[..., 0] + radial[..., 1] * level[..., 1]
        by_ray = np.empty_like(rays)
        by_ray[..., :2], by_ray[..., 2] = radial, outward
        by_ray *= (height / down)[..., None]
        in_camera = by_ray @ cameras.rotation
        slope = (in_camera[..., None, :] @ sight.circle_by_pixel)[..., 0, :]
        scale = np.maximum(np.sqrt(slope[..., 0] ** 2 + slope[..., 1] ** 2), TINY)
        inward = _inward(cameras, radial, level, height / down, slope, scale, circle[2])
        error = np.where(below, clipped((far - circle[2] + inward) / scale), FAR_PX)
        return _Seen(rays, below, radial, outward, by_ray, slope, scale, error)


def _inward(
    cameras: Cameras,
    radial: FloatArray,
    level: FloatArray,
    reach: FloatArray,
    slope: FloatArray,
    scale: FloatArray,
    radius_m: float,
) -> FloatArray:
    """(k, c) metres: the middle between the edges of a bent stripe, where it is cut askew, is so much nearer to the
    circle's middle than that of the stripe.

    Cut at an angle to the radius, a ring from R - w/2 to R + w/2 is w^2 tan^2(angle) / 8 R off; what is cut across in
    the picture is askew on the ground by how much a pixel across moves along the circle beside how much outwards.
    """
    # what is thinner than a lens blurs has its middle where it is
    width2 = np.maximum(cameras.shape.line_width_m**2 - (_BLUR_PX * scale) ** 2, 0.0)
    aside = np.empty((*radial.shape[:2], 3))
    aside[..., 0], aside[..., 1] = -radial[..., 1], radial[..., 0]
    aside[..., 2] = radial[..., 0] * level[..., 1] - radial[..., 1] * level[..., 0]
    aside *= reach[..., None]
    along = ((aside @ cameras.rotation)[..., None, :] @ cameras.sight.circle_by_pixel)[..., 0, :]
    askew = (along * slope).sum(axis=-1) / (scale * scale)
    return np.asarray(width2 * np.minimum(askew * askew, _MOST_ASKEW2) / (8.0 * radius_m))


def circle_errors(cameras: Cameras, circle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of the circle's points to a circle (3,) of the map: errors (k, c), pixels per metre (k, c); what is above the
    horizon is off by far."""
    seen = _Seen.of(cameras, circle)
    return seen.error, 1.0 / seen.scale


def circle_rows(cameras: Cameras, circle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows (k, c, 8) and pixels per metre of the same; what is above the horizon changes with nothing. How far inward a
    stripe's middle is is taken as it is: it changes little."""
    seen = _Seen.of(cameras, circle)
    inverse = np.where(seen.below, 1.0 / seen.scale, 0.0)
    by_centre = np.empty_like(seen.rays)
    by_centre[..., :2], by_centre[..., 2] = seen.radial, seen.outward
    out = np.empty((*seen.error.shape, COLUMNS))
    cameras.put(out, by_centre * inverse[..., None], cross(seen.rays, seen.by_ray) * inverse[..., None])
    out[..., FOCAL] = -np.sum(seen.slope * cameras.sight.circle_out, axis=-1) * inverse
    out[..., ERROR] = seen.error
    return out, 1.0 / seen.scale
