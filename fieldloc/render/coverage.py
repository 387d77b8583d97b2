"""How much of a pixel's square a shape covers: exact for straight edges, at any angle and sub-pixel place."""

import numpy as np

from fieldloc.pose import FloatArray

_TINY = 1e-30


def half_plane(value: FloatArray, slope: FloatArray) -> FloatArray:
    """Share (m,) of the unit square where a function is positive that is `value` (m,) in its middle and changes by
    slope (m, 2) per pixel.

    Across its edge the share is the integral of two boxes laid over one another, as wide as the edge's normal's parts.
    """
    length = np.maximum(np.hypot(slope[..., 0], slope[..., 1]), _TINY)
    across, down = np.abs(slope[..., 0]) / length, np.abs(slope[..., 1]) / length
    wide, narrow = np.maximum(np.maximum(across, down), 0.5), np.minimum(across, down)
    distance = value / length
    away = np.abs(distance)
    outer, inner = 0.5 * (wide + narrow), 0.5 * (wide - narrow)
    curved = 0.5 - np.square(outer - away) / np.maximum(2.0 * wide * narrow, _TINY)
    more = np.where(away <= inner, away / wide, np.where(away < outer, curved, 0.5))
    return np.asarray(0.5 + np.sign(distance) * more)


def between(one: FloatArray, other: FloatArray) -> FloatArray:
    """The share on the right side of two edges that do not cross within the pixel, from the share of each."""
    return np.maximum(one + other - 1.0, 0.0)
