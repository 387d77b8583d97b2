"""Both edges of a white line, to a fraction of a pixel, in profiles of brightness across it.

An edge is where a profile comes halfway from the white to the turf on its side: blur and thin lines move both edges
alike, so that their middle stays where it is.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.turf import Mask

_SAMPLES = 33  # of a profile
_MARGIN_PX = 3.0  # of turf on either side, beside a share of the width
_BRIGHTER = 0.3  # of the way from the turf to the white
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
    reach = 0.7 * width_px + _MARGIN_PX
    steps = np.linspace(-1.0, 1.0, _SAMPLES)
    x = reach[:, None] * steps
    u = (centres[:, :1] + x * normals[:, :1]).astype(np.float32)
    v = (centres[:, 1:] + x * normals[:, 1:]).astype(np.float32)
    sampled = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(cv2.boxFilter(sampled, cv2.CV_32F, (1, _SMOOTHED)), dtype=np.float32)
    inside = ((u[:, [0, -1]] >= 0) & (u[:, [0, -1]] <= grey.shape[1] - 1)).all(axis=1)
    inside &= ((v[:, [0, -1]] >= 0) & (v[:, [0, -1]] <= grey.shape[0] - 1)).all(axis=1)
    half = 0.5 * width_px[:, None]
    core = np.abs(x) <= np.maximum(0.5 * half, 0.75)
    white = ((values * core).sum(axis=1) / core.sum(axis=1))[:, None]
    edges, turf = [], []
    middle, row = _SAMPLES // 2, np.arange(len(values))
    beyond = x[:, middle:] > half + 1.0
    for sign in (-1, 1):
        outward = values[:, middle::sign]
        # The turf's level is the lowest until it gets brighter again: another line may be near.
        lowest = np.minimum.accumulate(np.where(beyond, outward, np.float32(255.0)), axis=1)
        brighter = beyond & (outward > lowest + _BRIGHTER * (white - lowest))
        brighter[:, -1] = True
        level = lowest[row, brighter.argmax(axis=1)]
        bar = 0.5 * (white[:, 0] + level)
        below = outward < bar[:, None]
        first = np.maximum(below.argmax(axis=1), 1)
        inner, outer = outward[row, first - 1], outward[row, first]
        share = (inner - bar) / np.maximum(inner - outer, 1e-3)
        found = below.any(axis=1) & ~below[:, 0]
        edges.append(np.where(found, (first - 1 + share) * sign, np.nan) * reach * (steps[1] - steps[0]))
        turf.append(level)
    width = edges[1] - edges[0]
    step = white[:, 0] - np.maximum(turf[0], turf[1])
    good = inside & np.isfinite(width) & (step > 0) & (width > 0.4 * width_px) & (width < 2.0 * width_px + 1.0)
    good &= np.abs(turf[0] - turf[1]) < step
    return Profiles(0.5 * (edges[0] + edges[1]), width, step, good)
