"""The circle from what was measured as lines are and is bent for sure: arcs too short or too flat to be told from
straight lines by the runs alone. An ellipse is fitted to one, two or three of them; all that lie on it say how good it
is.
"""

from itertools import combinations

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.circle import View, is_seen
from fieldloc.vision.ellipse import Ellipse, fit_ellipse, fit_ellipses

_MOST = 6  # arcs, the longest
_NEAR_PX, _NEAR_SHARE = 0.5, 0.05  # root mean square from the ellipse of an arc on it, beside the share of its width
_LEAST_ARCS = 2  # on the ellipse: through one short arc go many


def ellipse_of(arcs: list[FloatArray], view: View) -> Ellipse | None:
    """The ellipse on which most of the arcs are, each (m, 3) points in the plane and the width there."""
    arcs = sorted(arcs, key=len, reverse=True)[:_MOST]
    if len(arcs) < _LEAST_ARCS:
        return None
    choices = [some for count in (2, 3) for some in combinations(range(len(arcs)), count)]
    on = [_on(start, arcs) for start in fit_ellipses([arc[:, :2] for arc in arcs], choices) if start is not None]
    best, most = None, 0
    for chosen in dict.fromkeys(tuple(there) for there in on):
        table = np.concatenate([arcs[n] for n in chosen]) if len(chosen) >= _LEAST_ARCS else np.zeros((0, 3))
        if len(table) <= most:
            continue
        ellipse = fit_ellipse(table[:, :2])
        ellipse = ellipse and fit_ellipse(table[:, :2], ellipse.weights(table[:, :2]))
        if ellipse is None or not set(chosen) <= set(_on(ellipse, arcs)):
            continue
        if is_seen(ellipse, table[:, :2], _NEAR_PX + _NEAR_SHARE * table[:, 2], view):
            best, most = ellipse, len(table)
    return best


def _on(ellipse: Ellipse, arcs: list[FloatArray]) -> list[int]:
    """Which of the arcs are on an ellipse."""
    sizes = np.array([len(arc) for arc in arcs])
    begins = np.cumsum(sizes) - sizes
    table = np.concatenate(arcs)
    rough = np.sqrt(np.add.reduceat(ellipse.distance(table[:, :2]) ** 2, begins) / sizes)
    near = _NEAR_PX + _NEAR_SHARE * np.add.reduceat(table[:, 2], begins) / sizes
    return np.flatnonzero(rough < near).tolist()
