"""The circle from what was measured as lines are and is bent for sure: arcs too short or too flat to be told from
straight lines by the runs alone. An ellipse is fitted to one, two or three of them; all that lie on it say how good it
is.
"""

from itertools import combinations

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.circle import Ellipse, View, fit_ellipse, is_seen

_MOST = 6  # arcs, the longest
_NEAR_PX, _NEAR_SHARE = 0.5, 0.05  # root mean square from the ellipse of an arc on it, beside the share of its width
_LEAST_ARCS = 2  # on the ellipse: through one short arc go many


def ellipse_of(arcs: list[FloatArray], view: View) -> Ellipse | None:
    """The ellipse on which most of the arcs are, each (m, 3) points in the plane and the width there."""
    arcs = sorted(arcs, key=len, reverse=True)[:_MOST]
    best, most = None, 0
    for count in range(_LEAST_ARCS, min(len(arcs), 3) + 1):
        for some in combinations(arcs, count):
            ellipse = fit_ellipse(np.concatenate(some)[:, :2])
            on = [] if ellipse is None else [arc for arc in arcs if _is_on(ellipse, arc)]
            if ellipse is None or len(on) < _LEAST_ARCS:
                continue
            table = np.concatenate(on)
            ellipse = fit_ellipse(table[:, :2], ellipse.weights(table[:, :2]))
            if ellipse is None or len(table) <= most or not all(_is_on(ellipse, arc) for arc in on):
                continue
            if is_seen(ellipse, table[:, :2], _NEAR_PX + _NEAR_SHARE * table[:, 2], view):
                best, most = ellipse, len(table)
    return best


def _is_on(ellipse: Ellipse, arc: FloatArray) -> bool:
    off = ellipse.distance(arc[:, :2])
    return bool(np.sqrt(off @ off / len(off)) < _NEAR_PX + _NEAR_SHARE * arc[:, 2].mean())
