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
    table = np.concatenate(arcs)
    sizes = np.array([len(arc) for arc in arcs])
    begins = np.cumsum(sizes) - sizes
    near = _NEAR_PX + _NEAR_SHARE * np.add.reduceat(table[:, 2], begins) / sizes

    def on(ellipse: Ellipse) -> tuple[int, ...]:
        """Which of the arcs are on an ellipse."""
        off = ellipse.distance(table[:, :2])
        return tuple(np.flatnonzero(np.add.reduceat(off * off, begins) < near * near * sizes).tolist())

    starts = fit_ellipses([arc[:, :2] for arc in arcs], choices)
    fits = [some for some in dict.fromkeys(on(one) for one in starts if one is not None) if len(some) >= _LEAST_ARCS]
    for chosen in sorted(fits, key=lambda some: -sum(len(arcs[n]) for n in some)):
        part = np.concatenate([arcs[n] for n in chosen])
        ellipse = fit_ellipse(part[:, :2])
        ellipse = ellipse and fit_ellipse(part[:, :2], ellipse.weights(part[:, :2]))
        if ellipse is None or not set(chosen) <= set(on(ellipse)):
            continue
        if is_seen(ellipse, part[:, :2], _NEAR_PX + _NEAR_SHARE * part[:, 2], view):
            return ellipse
    return None
