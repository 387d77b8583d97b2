"""Where a post ends below on the ground and above at its crossbar, in a few columns of pixels side by side."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.turf import Turf

_MIDDLE = 0.28, 0.72  # of the width: where a round post's foot is nearly level
_OUTER = 0.15, 0.6  # of the width from the outer edge: beside the bar that the post carries
_REACH = 0.8  # of the width, up and down
_LEAST_REACH_PX, _MOST_REACH_PX = 5.0, 24.0
_MOST_COLUMNS = 15
_LEAST_STEP = 0.3  # of what post and turf differ: with less, no foot is seen
_LEVEL = 3.0  # standard deviations of the columns, beyond which one is left out


def foot_of(
    picture: UInt8Array, edges: tuple[FloatArray, FloatArray], foot_v: float, own: FloatArray, turf: Turf
) -> tuple[float, float] | None:
    """The row of the middle of a post's foot and its variance; None where it is hidden or beside the picture.

    edges: lines u = a + b v of both. foot_v: where it is roughly. own: (3,) the post's colour.
    """
    towards = turf.colour - own
    span = float(np.linalg.norm(towards))
    found = _step(picture, edges, foot_v, _MIDDLE, towards / max(span, 1e-9), 1, _LEAST_STEP * span)
    if found is None:
        return None
    places, rows, disagreement = found
    # the foot of a round post is an arc, lowest in its middle
    bent = len(places) >= 7
    design = np.stack([np.ones_like(places), (places - 0.5) ** 2], axis=1)[:, : 2 if bent else 1]
    return _level(design, rows, disagreement)


def top_of(
    picture: UInt8Array, edges: tuple[FloatArray, FloatArray], top_v: float, own: FloatArray, bar_right: bool
) -> tuple[float, float] | None:
    """The row of a post's upper end at its outer edge, and its variance; None where nothing else begins there."""
    places = _OUTER if bar_right else (1.0 - _OUTER[1], 1.0 - _OUTER[0])
    width = _width(edges, top_v)
    u = edges[0] @ (1.0, top_v) + 0.5 * (places[0] + places[1]) * width
    v = int(np.clip(round(top_v - max(0.5 * width, 3.0)), 0, len(picture) - 1))
    above = picture[v, int(np.clip(round(u), 0, picture.shape[1] - 1))].astype(np.float64)
    span = float(np.linalg.norm(above - own))
    found = _step(picture, edges, top_v, places, (above - own) / max(span, 1e-9), -1, 0.5 * span)
    if found is None or span < 10.0:
        return None
    return _level(np.ones((len(found[0]), 1)), found[1], found[2])


def _width(edges: tuple[FloatArray, FloatArray], v: float) -> float:
    return float((edges[1] - edges[0]) @ (1.0, v))


def _step(
    picture: UInt8Array,
    edges: tuple[FloatArray, FloatArray],
    near_v: float,
    places: tuple[float, float],
    direction: FloatArray,
    outwards: int,
    least: float,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Places across the post, rows of the step in each, and by how much two ways of telling it differ there.

    outwards: 1 where the post ends below, -1 above. direction: (3,) in colour, from the post to what is beyond.
    """
    width = _width(edges, near_v)
    reach = float(np.clip(_REACH * width, _LEAST_REACH_PX, _MOST_REACH_PX))
    height, columns = picture.shape[:2]
    v = np.rint(near_v).astype(np.intp) + outwards * np.arange(-round(reach), round(reach) + 1)
    v = v[(v >= 0) & (v < height)]
    count = int(np.clip((places[1] - places[0]) * width + 1.0, 3, _MOST_COLUMNS))
    at = np.linspace(*places, count)
    if len(v) < 8:
        return None
    left, right = edges[0][0] + edges[0][1] * v, edges[1][0] + edges[1][1] * v
    u = left + at[:, None] * (right - left)
    column = np.rint(u).astype(np.intp)
    if (column < 0).any() or (column >= columns).any():
        return None
    profile = picture[v, column].astype(np.float64) @ direction
    change = profile[:, 2:] - profile[:, :-2]  # over two rows: noise is halved
    inner = change[:, 1:-1]
    peak = inner.argmax(axis=1) + 1
    each = np.arange(count)
    before, high, after = change[each, peak - 1], change[each, peak], change[each, peak + 1]
    bend = np.minimum(before - 2.0 * high + after, -1e-6)
    fastest = peak + 1 + np.clip(0.5 * (before - after) / bend, -1.0, 1.0)
    last = profile.shape[1] - 1
    inside = profile[each, np.maximum(peak - 2, 0)]
    outside = profile[each, np.minimum(peak + 4, last)]
    level = 0.5 * (inside + outside)
    low, up = profile[each, peak], profile[each, peak + 2]
    half = peak + 2.0 * np.clip((level - low) / np.where(np.abs(up - low) > 1e-6, up - low, 1.0), -0.5, 1.5)
    good = (outside - inside > least) & (high > 0.0)
    if np.count_nonzero(good) < max(2, count // 2):
        return None
    start = float(v[0])
    rows = start + outwards * 0.5 * (fastest + half)
    return at[good], rows[good], (fastest - half)[good]


def _level(design: FloatArray, rows: FloatArray, disagreement: FloatArray) -> tuple[float, float]:
    """The first coefficient of a robust fit, and its variance."""
    centred = np.abs(rows - np.median(rows))
    kept = centred <= max(_LEVEL * 1.4826 * float(np.median(centred)), 1.0)
    design, rows, disagreement = design[kept], rows[kept], disagreement[kept]
    solution = np.linalg.lstsq(design, rows, rcond=None)[0]
    residual = rows - design @ solution
    count, unknowns = design.shape
    variance = float(residual @ residual) / max(count - unknowns, 1)
    # neighbouring columns share blur and the grain of the turf: about every third is new
    share = 3.0 * float(np.linalg.pinv(design.T @ design)[0, 0])
    return float(solution[0]), variance * share + 0.25 * float(np.mean(disagreement)) ** 2 + variance / count
