"""How wide a painted line looks: what tells lines of a field from nets, seams and shadows.

Light that spreads, the lens and the camera's colour pattern make thin lines wider, so none is ever seen thinner than
it is painted, and hardly one as thin as two pixels.
"""

import math

import numpy as np

from fieldloc.locate.sight import Sight
from fieldloc.pose import FloatArray

_OFF_PX, _OFF = 0.7, 0.13  # how far off a line's width may be: light, and lines laid by hand
_ROUGH = 0.01  # and so much more for each pixel by which states may be off
_BLUR_PX, _BLUR_OFF_PX = 2.5, 1.0  # white is so wide where nearly nothing is painted; and how sure that is
_WIDEST_PX = 1e3
_LOG_ANY = -math.log(30.0)  # any width up to this
_LOG_2PI = math.log(2.0 * math.pi)


def widths_fit(sight: Sight, px_per_m: FloatArray, line_width_m: float, widen_px: float) -> FloatArray:
    """(k, l) log density of the widths at both ends where the map has so many pixels per metre (k, l, 2), less that of
    any width; zero where they are not known."""
    known = np.isfinite(sight.widths)
    out = np.zeros(px_per_m.shape[:2])
    rows = np.flatnonzero(known.any(axis=1))
    if not len(rows):
        return out
    known = known[rows]
    seen, sigma = np.where(known, sight.widths[rows], 0.0), np.where(known, sight.width_sigmas[rows], 1.0)
    painted = np.minimum(px_per_m[:, rows] * line_width_m, _WIDEST_PX)
    expected = np.sqrt(painted * painted + _BLUR_PX**2)
    share = (_OFF + _ROUGH * widen_px) * painted * painted / expected
    variance = sigma**2 + _OFF_PX**2 + (_BLUR_PX * _BLUR_OFF_PX / expected) ** 2 + share * share
    off = seen - expected
    fit = -0.5 * (off * off / variance + np.log(variance) + _LOG_2PI) - _LOG_ANY
    # both ends' widths are one and the same error: their mean says it
    out[:, rows] = (fit * (known / known.sum(axis=1, keepdims=True))).sum(axis=2)
    return out
