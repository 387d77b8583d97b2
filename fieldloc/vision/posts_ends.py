"""Where a post ends below on the ground and above at its crossbar, in a few columns of pixels side by side.

Each end is told from numbers and from the light they may stand for, as edges are (`fieldloc.vision.posts_fit`). A round
post's ends are arcs: its foot is lowest in its middle, its top highest.
"""

from typing import TypeVar

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_fit import LIGHT
from fieldloc.vision.turf import Turf

_MIDDLE = 0.25, 0.75  # of the width: where a foot is nearly level
_OUTER = 0.06, 0.6  # of the width from the outer edge: beside the bar that the post carries
_REACH = 1.2  # of the width, up and down
_BELOW_PX = np.array([2.0, 3.0, 4.0])
_ROWS_BELOW, _LINE = 6, 0.6  # looked at for turf, over that much of the post's width
_NEAR_PX = 5.0  # up and down from where the hue changes
_GREEN = 0.22  # of the way from the post's hue to the turf's: in the sun turf is nearly white
_NEARLY = 0.6  # as steep as the steepest
_REACH_PX = 6.0, 24.0
_COLUMNS = 5, 15
_LEAST_STEP = 0.3  # of what post and turf differ: with less, no foot is seen
_LEAST_CONTRAST = 10.0  # of 255, between a top and what is above it
_LEVEL = 3.0  # standard deviations of the columns, beyond which one is left out
_ALIKE = 3.0  # neighbouring columns share blur and the grain of the turf: about every third is new

_Number = TypeVar("_Number", int, float)
Lines = tuple[FloatArray, FloatArray]
"""u = a + b v of both edges, (2,) each."""


def foot_of(
    picture: UInt8Array, edges: Lines, foot_v: float, own: FloatArray, turf: Turf
) -> tuple[float, float] | None:
    """The row of the middle of a post's foot and its variance; None where it is hidden or beside the picture.

    foot_v: where it is roughly. own: (3,) the post's colour.
    """
    near_v = _hue_change(picture, edges, foot_v, own, turf.colour)
    if near_v is None or not _has_turf_below(edges, near_v, turf):
        return None
    v = np.minimum(np.rint(near_v + _BELOW_PX), len(picture) - 1)
    middle = np.rint(0.5 * (edges[0][0] + edges[1][0] + (edges[0][1] + edges[1][1]) * v))
    column = np.minimum(np.maximum(middle, 0), picture.shape[1] - 1)
    below = picture[v.astype(np.intp), column.astype(np.intp)].mean(axis=0)
    found = _steps(picture, edges, near_v, _MIDDLE, below - own, 1, _LEAST_STEP, _NEAR_PX)
    if found is None:
        return None
    places, rows, light_rows = found
    arc = np.sqrt(1.0 - (2.0 * places - 1.0) ** 2) - 1.0
    return _level(arc, rows, light_rows)


def top_of(
    picture: UInt8Array, edges: Lines, top_v: float, own: FloatArray, bar_right: bool
) -> tuple[float, float] | None:
    """The row of a post's upper end at its outer edge, and its variance; None where nothing else begins there."""
    places = _OUTER if bar_right else (1.0 - _OUTER[1], 1.0 - _OUTER[0])
    width = _width(edges, top_v)
    u = float(edges[0] @ (1.0, top_v) + 0.5 * (places[0] + places[1]) * width)
    v = _within(round(top_v - max(0.5 * width, 3.0)), 0, len(picture) - 1)
    above = picture[v, _within(round(u), 0, picture.shape[1] - 1)].astype(np.float64)
    if np.abs(above - own).max() < _LEAST_CONTRAST:
        return None
    found = _steps(picture, edges, top_v, places, above - own, -1, 0.5)
    if found is None:
        return None
    places_found, rows, light_rows = found
    return _level(np.sqrt(1.0 - (2.0 * places_found - 1.0) ** 2), rows, light_rows)


def _has_turf_below(edges: Lines, foot_v: float, turf: Turf) -> bool:
    """A line may come first, but what hides a foot goes on."""
    v = foot_v + 2.0 + np.arange(_ROWS_BELOW) / (_ROWS_BELOW - 1) * (2.0 + _LINE * max(_width(edges, foot_v), 0.0))
    u = 0.5 * (edges[0][0] + edges[1][0] + (edges[0][1] + edges[1][1]) * v)
    return bool(np.count_nonzero(turf.at_uv(u, v)) >= _ROWS_BELOW // 3)


def _hue_change(picture: UInt8Array, edges: Lines, foot_v: float, own: FloatArray, turf: FloatArray) -> float | None:
    """The row at which the post's hue becomes the turf's, whatever the light on both, near foot_v."""
    reach = _within(_REACH * _width(edges, foot_v), *_REACH_PX)
    v = np.arange(max(0, int(foot_v - reach)), min(len(picture) - 1, int(foot_v + reach)) + 1)
    left, right = edges[0][0] + edges[0][1] * v, edges[1][0] + edges[1][1] * v
    column = np.rint(left + np.array([[0.35], [0.5], [0.65]]) * (right - left)).astype(np.intp)
    if len(v) < 4 or (column < 0).any() or (column >= picture.shape[1]).any():
        return None
    colours = np.concatenate([[own, turf], picture[v, column].mean(axis=0)])
    hue = colours / (colours.sum(axis=1, keepdims=True) + 30.0)
    towards = hue[1] - hue[0]
    share = (hue[2:] - hue[0]) @ towards / max(float(towards @ towards), 1e-9)
    green = share > _GREEN
    begins = np.flatnonzero(green[:-1] & green[1:])
    if not len(begins) or green[0]:
        return None
    return float(v[begins[0]]) - 0.5


def _width(edges: Lines, v: float) -> float:
    return float(edges[1][0] - edges[0][0] + (edges[1][1] - edges[0][1]) * v)


def _within(value: _Number, low: _Number, high: _Number) -> _Number:
    return min(max(value, low), high)


def _median(values: FloatArray) -> float:
    ordered, half = np.sort(values), len(values) // 2
    return float(ordered[half] if len(values) % 2 else 0.5 * (ordered[half - 1] + ordered[half]))


def _steps(
    picture: UInt8Array,
    edges: Lines,
    near_v: float,
    places: tuple[float, float],
    direction: FloatArray,
    outwards: int,
    least: float,
    most_px: float = np.inf,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Places across the post and the rows of the step in each, by numbers and by light.

    outwards: 1 where the post ends below, -1 above. direction: (3,) in colour, from the post to what is beyond; `least`
    of it is a step. most_px: up and down from near_v.
    """
    width = _width(edges, near_v)
    reach = min(_within(_REACH * width, *_REACH_PX), most_px)
    height, columns = picture.shape[:2]
    v = np.rint(near_v).astype(np.intp) + outwards * np.arange(-round(reach), round(reach) + 1)
    v = v[(v >= 0) & (v < height)]
    if len(v) < 8:
        return None
    count = _within(int((places[1] - places[0]) * width + 1.0), *_COLUMNS)
    at = places[0] + (places[1] - places[0]) / (count - 1) * np.arange(count)
    left, right = edges[0][0] + edges[0][1] * v, edges[1][0] + edges[1][1] * v
    column = np.rint(left + at[:, None] * (right - left)).astype(np.intp)
    if (column < 0).any() or (column >= columns).any():
        return None
    numbers = picture[v, column]
    span = float(direction @ direction)
    profiles = np.array([numbers, LIGHT[numbers]], dtype=np.float64) @ direction
    step = _step(profiles.reshape(-1, len(v)), least * span)
    rows = (v[0] + outwards * step).reshape(2, -1)
    good = np.isfinite(rows).all(axis=0)
    if np.count_nonzero(good) < max(3, len(at) // 2):
        return None
    return at[good], rows[0, good], rows[1, good]


def _step(profiles: FloatArray, least: float) -> FloatArray:
    """(k,) where along profiles (k, s) the steepest rise is half done; NaN where it is less than `least` of numbers."""
    change = profiles[:, 2:] - profiles[:, :-2]
    inner = change[:, 1:-1]
    # the first of those that are nearly as steep as the steepest: a line or a shadow may come after the end
    steep = inner >= _NEARLY * inner.max(axis=1, keepdims=True)
    summit = (inner >= change[:, :-2]) & (inner >= change[:, 2:])
    peak = (steep & summit).argmax(axis=1) + 1
    each, last = np.arange(len(profiles)), profiles.shape[1] - 1
    before, high, after = change[each, peak - 1], change[each, peak], change[each, peak + 1]
    fastest = peak + 1 + np.clip(0.5 * (before - after) / np.minimum(before - 2.0 * high + after, -1e-6), -1.0, 1.0)
    inside, outside = profiles[each, np.maximum(peak - 2, 0)], profiles[each, np.minimum(peak + 4, last)]
    low, up = profiles[each, peak], profiles[each, peak + 2]
    share = (0.5 * (inside + outside) - low) / np.where(np.abs(up - low) > 1e-6, up - low, 1.0)
    half = peak + 2.0 * np.clip(share, -0.5, 1.5)
    seen = (high > 0.0) & (outside - inside > least)
    return np.where(seen, 0.5 * (fastest + half), np.nan)


def _level(arc: FloatArray, rows: FloatArray, light_rows: FloatArray) -> tuple[float, float]:
    """The row where the arc (k,) is 0, and its variance, from the scatter and from how numbers and light differ."""
    both = 0.5 * (rows + light_rows)
    off = np.abs(both - _median(both))
    kept = off <= max(_LEVEL * 1.4826 * _median(off), 1.0)
    arc = arc[kept]
    # an arc as high as rows are apart could be anything: it is drawn to none, as if that had been seen once
    count, first, second = len(arc), float(arc.sum()), float(arc @ arc) + 0.5
    determinant = count * second - first**2
    side, cross = float(both[kept].sum()), float(arc @ both[kept])
    level, height = (second * side - first * cross) / determinant, (count * cross - first * side) / determinant
    residual = both[kept] - level - height * arc
    variance = float(residual @ residual) / max(count - 2, 1)
    tone = _median(rows[kept] - light_rows[kept])
    return level, _ALIKE * variance * second / determinant + tone**2 / 12.0
