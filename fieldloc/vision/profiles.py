"""Both edges of a white line, to a fraction of a pixel, in profiles of brightness across it.

An edge is where a profile comes halfway from the white to the turf on its side: blur and thin lines move both edges
alike, so that their middle stays where it is.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.turf import Mask

_SAMPLES = 41  # of a profile
_MARGIN_PX = 4.0  # of turf on either side, beside a share of the width
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
    reach = 0.9 * width_px + _MARGIN_PX
    steps = np.linspace(-1.0, 1.0, _SAMPLES)
    x = reach[:, None] * steps
    u = (centres[:, :1] + x * normals[:, :1]).astype(np.float32)
    v = (centres[:, 1:] + x * normals[:, 1:]).astype(np.float32)
    sampled = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(cv2.boxFilter(sampled, cv2.CV_32F, (1, _SMOOTHED)), dtype=np.float32)
    inside = ((u[:, [0, -1]] >= 0) & (u[:, [0, -1]] <= grey.shape[1] - 1)).all(axis=1)
    inside &= ((v[:, [0, -1]] >= 0) & (v[:, [0, -1]] <= grey.shape[0] - 1)).all(axis=1)
    half = 0.5 * width_px[:, None]
    beyond = np.abs(x) > half + 1.5
    left, right = beyond & (x < 0), beyond & (x > 0)
    turf = np.stack([_mean(values, left), _mean(values, right)], axis=1)
    core = np.abs(x) <= np.maximum(0.5 * half, 0.75)
    white = _mean(values, core)
    edges = []
    middle = _SAMPLES // 2
    for side, sign in ((0, -1), (1, 1)):
        bar = 0.5 * (white + turf[:, side])[:, None]
        outward = values[:, middle::sign]
        below = outward < bar
        first = np.maximum(below.argmax(axis=1), 1)
        row = np.arange(len(values))
        inner, outer = outward[row, first - 1], outward[row, first]
        share = (inner - bar[:, 0]) / np.maximum(inner - outer, 1e-3)
        found = below.any(axis=1) & ~below[:, 0]
        edges.append(np.where(found, (first - 1 + share) * sign, np.nan) * reach * (steps[1] - steps[0]))
    width = edges[1] - edges[0]
    step = white - turf.max(axis=1)
    good = inside & np.isfinite(width) & (step > 0) & (width > 0.4 * width_px) & (width < 2.0 * width_px + 1.0)
    return Profiles(0.5 * (edges[0] + edges[1]), width, step, good)


def _mean(values: NDArray[np.float32], mask: Mask) -> FloatArray:
    return np.asarray((values * mask).sum(axis=1) / np.maximum(mask.sum(axis=1), 1), dtype=np.float64)
