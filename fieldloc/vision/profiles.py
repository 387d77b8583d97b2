"""Both edges of a white line, to a fraction of a pixel, in profiles of brightness across it.

An edge is where a profile comes halfway from the white to the turf on its side: blur and thin lines move both edges
alike, so that their middle stays where it is.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.turf import Mask

Single = NDArray[np.float32]

_SAMPLES = 33  # of a profile
_MIDDLE = _SAMPLES // 2
_STEPS = np.linspace(-1.0, 1.0, _SAMPLES, dtype=np.float32)[:, None]
_WHITE = np.float32(255.0)
_LEAST_CORE_PX, _BEYOND_PX = np.float32(0.75), np.float32(1.0)  # what is white for sure, and what is so no longer
_CORE = slice(_MIDDLE - 6, _MIDDLE + 7)  # samples that may be in the core: 0.25 w of 0.7 w, or 0.75 px of 3
_FIRST_BEYOND = _MIDDLE // 3  # sample outwards that may be beyond: 0.5 w + 1 px of 0.7 w + 3 px is at least a third
_MARGIN_PX = np.float32(3.0)  # of turf on either side, beside a share of the width
_SEEN_PX = np.float32(3.5)  # of the turf beyond an edge, in the picture
_BRIGHTER = np.float32(0.3)  # of the way from the turf to the white
_SMOOTHED = 3  # neighbouring profiles are averaged, as grass is rougher than the pixels


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """k profiles. middle_px, width_px: (k,) of the white, the first from where the profile was centred. step: (k,) of
    brightness, from the turf to the white. good: (k,) where both edges were found.
    """

    middle_px: FloatArray
    width_px: FloatArray
    step: FloatArray
    good: Mask


def measure(grey: UInt8Array, centres: FloatArray, normals: FloatArray, width_px: FloatArray) -> Profiles:
    """Profiles through centres (k, 2) along unit normals (k, 2), for lines about width_px (k,) wide.

    Neighbours in the list are taken to be neighbours on the line.
    """
    # Samples go down the rows, profiles across: what goes from sample to sample is done for all profiles at once.
    at, along, wide = (part.astype(np.float32) for part in (centres.T, normals.T, width_px))
    x = _STEPS * (np.float32(0.7) * wide + _MARGIN_PX)
    u, v = at[0] + x * along[0], at[1] + x * along[1]
    sampled = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(cv2.boxFilter(sampled, cv2.CV_32F, (_SMOOTHED, 1)), dtype=np.float32)
    core = (np.abs(x[_CORE]) <= np.maximum(np.float32(0.25) * wide, _LEAST_CORE_PX)).astype(np.float32)
    white = (values[_CORE] * core).sum(axis=0) / core.sum(axis=0)
    # Both sides outwards, beside each other: (samples, sides, profiles).
    outward = np.stack([values[_MIDDLE::-1], values[_MIDDLE:]], axis=1)
    beyond = (x[_MIDDLE + _FIRST_BEYOND :] > np.float32(0.5) * wide + _BEYOND_PX)[:, None]
    # The turf's level is the lowest until it gets brighter again: another line may be near.
    lowest = np.where(beyond, outward[_FIRST_BEYOND:], _WHITE)
    for before, here in pairwise(lowest):
        np.minimum(before, here, out=here)
    brighter = beyond & (outward[_FIRST_BEYOND:] > lowest + _BRIGHTER * (white - lowest))
    brighter[-1] = True
    level = _taken(lowest, brighter.argmax(axis=0))
    bar = np.float32(0.5) * (white + level)
    below = outward < bar
    first = np.maximum(below.argmax(axis=0), 1)
    inner, outer = _taken(outward, first - 1), _taken(outward, first)
    share = (inner - bar) / np.maximum(inner - outer, np.float32(1e-3))
    found = below.any(axis=0) & ~below[0]
    away = np.where(found, first - 1 + share, np.nan) * (x[-1] / _MIDDLE)
    width = away[0] + away[1]
    step = white - np.maximum(level[0], level[1])
    # The picture may end beside a line, but not before its turf has been seen.
    reach = np.array([-away[0] - _SEEN_PX, away[1] + _SEEN_PX])
    outer_u, outer_v = at[0] + reach * along[0], at[1] + reach * along[1]
    inside = ((outer_u >= 0) & (outer_u <= grey.shape[1] - 1) & (outer_v >= 0) & (outer_v <= grey.shape[0] - 1)).all(0)
    good = inside & found.all(axis=0) & (step > 0) & (width > 0.4 * wide) & (width < 2.0 * wide + 1.0)
    good &= np.abs(level[0] - level[1]) < step
    return Profiles(0.5 * (away[1] - away[0]), width, step, good)


def _taken(values: Single, rows: NDArray[np.intp]) -> Single:
    """(sides, profiles): of values (samples, sides, profiles) those in the rows."""
    return np.asarray(values.ravel()[rows * rows.size + np.arange(rows.size).reshape(rows.shape)], dtype=np.float32)
