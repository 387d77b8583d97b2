"""How much of a pixel a shape covers: exact for straight edges, at any angle, sub-pixel place and blur.

A lens blurs the light before the pixels sum it up. Blurring the finished picture instead would leave each edge where
its pixel's middle is: so the blur is part of the coverage.
"""

import math

import numpy as np
from scipy.special import ndtr

from fieldloc.pose import FloatArray

_TINY = 1e-30
REACH = 4.0
"""How far a blur reaches, in its standard deviations."""


def half_plane(value: FloatArray, slope: FloatArray, blur_px: float) -> FloatArray:
    """Share (m,) of the light in a pixel that comes from where a function is positive, which is `value` (m,) in the
    pixel's middle and changes by slope (m, 2) per pixel. blur_px: standard deviation of a Gaussian.

    Across the edge a pixel is two boxes laid over one another, as wide as the parts of the edge's unit normal.
    """
    length = np.maximum(np.hypot(slope[..., 0], slope[..., 1]), _TINY)
    across, down = np.abs(slope[..., 0]) / length, np.abs(slope[..., 1]) / length
    wide, narrow = np.maximum(np.maximum(across, down), 0.5), np.minimum(across, down)
    distance = value / length
    return _sharp(distance, wide, narrow) if blur_px <= 0.0 else _blurred(distance, wide, narrow, blur_px)


def between(one: FloatArray, other: FloatArray) -> FloatArray:
    """The share on the right side of two edges that do not cross within the pixel, from the share of each."""
    return np.maximum(one + other - 1.0, 0.0)


def _sharp(distance: FloatArray, wide: FloatArray, narrow: FloatArray) -> FloatArray:
    away = np.abs(distance)
    outer, inner = 0.5 * (wide + narrow), 0.5 * (wide - narrow)
    curved = 0.5 - np.square(outer - away) / np.maximum(2.0 * wide * narrow, _TINY)
    more = np.where(away <= inner, away / wide, np.where(away < outer, curved, 0.5))
    return np.asarray(0.5 + np.sign(distance) * more)


def _blurred(distance: FloatArray, wide: FloatArray, narrow: FloatArray, blur_px: float) -> FloatArray:
    """The narrow box is taken as a part of the Gaussian."""
    out = np.where(distance > 0.0, 1.0, 0.0)
    near = np.abs(distance) < 0.75 + REACH * blur_px
    distance, wide = distance[near], wide[near]
    sigma = np.sqrt(blur_px**2 + narrow[near] ** 2 / 12.0)
    above, below = _integral((distance + 0.5 * wide) / sigma), _integral((distance - 0.5 * wide) / sigma)
    out[near] = np.clip((above - below) * sigma / wide, 0.0, 1.0)
    return out


def _integral(x: FloatArray) -> FloatArray:
    """Of the normal distribution function."""
    return np.asarray(x * ndtr(x) + np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))
