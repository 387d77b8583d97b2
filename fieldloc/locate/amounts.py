"""How much of the model's noise a picture may have, and how often that much is met.

None to speak of, where a picture is drawn or the field and the lens are surveyed, as often as what people lay out by
tape; what is in between is rare. Which of both it is, the lines tell before anything is fitted to them: paint, grain
and a lens leave the middle of a real line scattered about a straight one, by ten times as much as in a drawing.
"""

import numpy as np

from fieldloc.locate.sight import Sight
from fieldloc.pose import FloatArray

AMOUNTS = np.array([1e-6, 0.01, 0.2, 1.0, 5.0])  # variances
_OFTEN: FloatArray = np.log(np.array([0.6, 0.005, 0.19, 0.19, 0.01]))
_EXACT = AMOUNTS < 0.1
_LONG_PX = 100.0  # of lines that are long enough to tell
# Of the straightest of these, how far its ends may be off by its own scatter, px: the logarithm's mean and deviation.
_DRAWN = np.log(0.018), 0.35
_REAL = np.log(0.09), 0.8  # 0.03 to 0.4 px in pictures of five cameras
_NOISY = 0.5  # share of the exact ones in which it is as in the others, by noise of the camera or of another detector


def log_often(sight: Sight) -> FloatArray:
    """(a,) log of how often each amount is met where lines are so straight; as always where none is long enough."""
    long = sight.line_lengths >= _LONG_PX
    if not long.any():
        return _OFTEN
    scatter = 0.5 * float(np.log(sight.line_variances[long].mean(axis=1).min()))
    drawn, real = (-0.5 * ((scatter - mean) / sigma) ** 2 - np.log(sigma) for mean, sigma in (_DRAWN, _REAL))
    exact = np.logaddexp(np.log(1.0 - _NOISY) + drawn, np.log(_NOISY) + real)
    return np.asarray(_OFTEN + np.where(_EXACT, exact - real, 0.0))
