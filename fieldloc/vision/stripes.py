"""Where the middle of a stripe on the ground is in the picture: not half way between its edges, as the farther half
looks narrower.

Across a stripe, w pixels wide and V pixels below the horizon, the middle is seen w^2 n / 4 V nearer to the horizon than
the middle between the edges, where n is the share of the picture's downward direction in the direction across.
"""

import math

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.turf import Turf

LOWEST, HIGHEST = 0.06, 0.35  # of the picture's height is the horizon above the field's border: where that is eight
# metres away from a camera half a metre high, or two from one at 0.7 m
_BLUR_PX = 2.35  # the width that a lens with a sigma of a pixel gives to a thread


def middle_shift(
    pixels: FloatArray, normals: FloatArray, width_px: FloatArray, turf: Turf, height: int
) -> tuple[FloatArray, FloatArray]:
    """(...,) along the unit normals (..., 2), from the middles between the edges (..., 2) to those of the stripes, and
    its standard deviation, as the horizon is only known to be above the field's border.
    """
    # Any height of the horizon between the two is as likely by its logarithm.
    typical = math.sqrt(LOWEST * HIGHEST) * height
    spread = typical * math.log(HIGHEST / LOWEST) / math.sqrt(12.0)
    below = np.maximum(turf.below_px(pixels), 0.0) + typical
    shift = -0.25 * np.maximum(width_px**2 - _BLUR_PX**2, 0.0) * normals[..., 1] / below
    return shift, np.abs(shift) * spread / below
