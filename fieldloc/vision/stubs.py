"""Where a line that is seen meets another one, of which the picture's border leaves but a stub: profiles across such a
stub would run out of the picture, but rows along the line that it leaves cut both of its edges.

A stub goes straight on from the line's own edge to the picture's border, with turf on either side.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenLine
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.straight import Plane
from fieldloc.vision.stripes import middle_shift
from fieldloc.vision.turf import Turf

_FIRST_PX, _ROWS = 2.0, 36  # rows beside a line's edge, a pixel apart: the first, how many
_FEWEST = 3  # rows of a stub
_AT_ONCE = 6  # rows
_NEAR_PX = 40.0  # from the picture's border do stubs begin: what is longer is found as a line
_BEYOND_WIDTHS, _BEYOND_PX = 3.0, 12.0  # beyond a line's end, too: it may end where a stub begins
_LEAST_PX = 30.0  # of a line that stubs are looked for at
_WIDTHS = (0.3, 5.0)  # of a stub along the line, in the line's own width
_LEAN = 3  # along the line for one out
_ROUGHEST_PX, _ROUGHEST_SHARE = (
    0.7,
    0.06,
)  # standard deviation of a stub's middles about a straight line, or of its width
_FLOOR_PX, _FLOOR_SHARE = (
    0.2,
    0.01,
)  # of a middle, or of the width: what pixels and light of the line beside them err by
_SEEN_PX = 2  # of turf on either side
_COLOUR = 0.5  # share of a stub's sides that has to have the turf's colour
_WHITER = 0.6  # of half a line's contrast: so much brighter or darker than the line may a stub be
_THIN_PX = 4.0  # what is thinner is never as bright
_SAME = 0.15  # sine of the angle between two pieces of one line
_AWAY = _FIRST_PX + np.arange(_ROWS, dtype=np.float64)
_CORE, _BESIDE = np.linspace(0.1, 0.9, 9), np.array([-1.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """Of line `row`: a point of its edge, the edge's direction, the unit vector away from it (2,) each; bar and white:
    brightness between turf and white, and of the white."""

    row: int
    origin: FloatArray
    along: FloatArray
    out: FloatArray
    bar: float
    white: float

    def points(self, place: FloatArray, away: FloatArray) -> FloatArray:
        """(..., 2)."""
        return np.asarray(self.origin + place[..., None] * self.along + away[..., None] * self.out)


def find_stubs(
    grey: UInt8Array, lines: tuple[SeenLine, ...], plane: Plane, turf: Turf, settings: VisionSettings
) -> tuple[SeenLine, ...]:
    """Beside lines of the picture `grey`. None through a lens that bends them."""
    if not plane.is_picture or not lines:
        return ()
    kept: list[SeenLine] = []
    for side, begin, end in _white_beside(grey, lines, settings):
        line = lines[side.row]
        edges = _tracked(grey, side, begin, end)
        stub = None if edges is None else _seen(grey, side, edges, turf)
        if stub is None or any(_is_part(stub, other) for other in (*lines, *kept)):
            continue
        if _as_white(grey, stub, line, side) and not _goes_through(grey, stub, line, side.bar):
            kept.append(stub)
    return tuple(kept)


def _white_beside(
    grey: UInt8Array, lines: tuple[SeenLine, ...], settings: VisionSettings
) -> list[tuple[_Side, float, float]]:
    """White right beside a line, near the picture's border: from where to where along it."""
    ends = np.array([line.ends_px for line in lines])
    width = np.array([line.width_px for line in lines])
    way = ends[:, 1] - ends[:, 0]
    length = np.hypot(way[:, 0], way[:, 1])
    along = way / length[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    core = ends[:, None, 0] + _CORE[:, None] * way[:, None]
    aside = (0.5 * width.mean(axis=1) + _FIRST_PX + 1.0)[:, None, None, None] * _BESIDE[:, None] * normal[:, None, None]
    white = _median(_values(grey, core))
    dark = _median(_values(grey, core[:, :, None] + aside).reshape(len(lines), -1))
    good = (length >= _LEAST_PX) & (white - dark >= settings.least_contrast)
    # both sides of each: (n, 2, 2)
    out = _BESIDE[:, None] * normal[:, None]
    origin = ends[:, :1] + 0.5 * width[:, :1, None] * out
    edge = along[:, None] + (0.5 * (width[:, 1] - width[:, 0]) / length)[:, None, None] * out
    extra = _BEYOND_WIDTHS * width.max(axis=1) + _BEYOND_PX
    first = origin + _FIRST_PX * out
    size = np.array(grey.shape[::-1]) - 1.0
    low, high = _within(first, edge, np.zeros(2), size)
    low, high = np.maximum(low, -extra[:, None]), np.minimum(high, (length + extra)[:, None])
    leaves, comes = _within(first, edge, np.full(2, _NEAR_PX), size - _NEAR_PX)
    wide = _BEYOND_WIDTHS * width.max(axis=1)[:, None]  # whole stubs, of which a part is as near
    leaves, comes = leaves + wide, comes - wide
    far = leaves >= comes  # all of it is near the border
    leaves, comes = np.where(far, high, leaves), np.where(far, high, comes)
    begin, end = np.array([low, np.maximum(low, comes)]), np.array([np.minimum(high, leaves), high])
    part, row, which = np.nonzero((end - begin > _FEWEST) & good[:, None])
    if not len(row):
        return []
    begin = begin[part, row, which]
    counts = (end[part, row, which] - begin).astype(np.intp) + 1
    starts = np.cumsum(counts) - counts
    place = np.arange(counts.sum()) - np.repeat(starts - begin, counts)
    points = np.repeat(first[row, which], counts, axis=0) + place[:, None] * np.repeat(edge[row, which], counts, axis=0)
    bar = 0.5 * (white + dark)
    above = _values(grey, points) > np.repeat(bar[row], counts)
    above[starts] = above[starts + counts - 1] = False  # what goes on beyond has its edge elsewhere
    change = np.flatnonzero(above[1:] != above[:-1]) + 1
    found = []
    for one, other in change.reshape(-1, 2).tolist():
        now = int(np.searchsorted(starts, one, side="right")) - 1
        line, beside = int(row[now]), int(which[now])
        if _WIDTHS[0] < (other - one) / float(width[line].mean()) < _WIDTHS[1]:
            side = _Side(
                line, origin[line, beside], edge[line, beside], out[line, beside], float(bar[line]), float(white[line])
            )
            found.append((side, float(place[one]), float(place[other])))
    return found


def _within(start: FloatArray, along: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """From where to where along straight lines (..., 2) they are in a box; nowhere where the first is larger."""
    slope = np.where(np.abs(along) < 1e-9, 1e-9, along)
    one, other = (low - start) / slope, (high - start) / slope
    return np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)


def _tracked(grey: UInt8Array, side: _Side, start: float, stop: float) -> FloatArray | None:
    """(m, 2) both edges, as places along the line, in the rows from the first one out to the picture's border."""
    edges: list[tuple[float, float]] = []
    reach = _LEAN * _AT_ONCE + _SEEN_PX
    for first in range(0, _ROWS, _AT_ONCE):  # most of what is white beside a line is soon seen to be something else
        place = np.arange(start - reach, stop + reach)
        points = side.points(place[None], _AWAY[first : first + _AT_ONCE, None])
        u, v = points[..., 0], points[..., 1]
        inside = (u >= 0.0) & (u <= grey.shape[1] - 1) & (v >= 0.0) & (v <= grey.shape[0] - 1)
        u, v = u.astype(np.float32), v.astype(np.float32)
        values = np.asarray(cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64)
        above = values > side.bar
        begin, end = reach, len(place) - reach
        for now in range(_AT_ONCE):
            inner = np.flatnonzero(above[now, begin:end])
            if not len(inner):
                return None  # it ends on turf
            low, high = begin - _LEAN, end + _LEAN
            begin, end = begin + int(inner[0]), begin + int(inner[-1]) + 1
            while begin > low and above[now, begin - 1]:
                begin -= 1
            while end < high and above[now, end]:
                end += 1
            if not inside[now, begin - _SEEN_PX : end + _SEEN_PX].all():
                return np.array(edges) if len(edges) >= _FEWEST else None
            before, after = values[now, begin - 1], values[now, end]
            if before > side.bar or after > side.bar:
                return None
            share = (values[now, begin] - side.bar) / (values[now, begin] - before)
            beyond = (values[now, end - 1] - side.bar) / (values[now, end - 1] - after)
            edges.append((place[begin] - share, place[end - 1] + beyond))
        start, stop = float(place[begin]), float(place[end])
    return None  # it is no stub


def _seen(grey: UInt8Array, side: _Side, edges: FloatArray, turf: Turf) -> SeenLine | None:
    away = _AWAY[: len(edges)]
    middle, width = edges.mean(axis=1), edges[:, 1] - edges[:, 0]
    off = away - away.mean()
    power = float(off @ off)
    slope, taper = off @ middle / power, off @ width / power
    rest = middle - middle.mean() - slope * off
    rough = float(np.sqrt(rest @ rest / (len(rest) - 2.0)))
    if rough > max(_ROUGHEST_PX, _ROUGHEST_SHARE * float(width.mean())):
        return None
    beside = np.array([edges[:, 0] - 3.0, edges[:, 1] + 3.0])
    if (turf.at(side.points(beside, np.stack([away, away]))).mean(axis=1) < _COLOUR).any():
        return None
    at = off[[0, -1]]
    ends = side.points(middle.mean() + slope * at, away[[0, -1]])
    along = ends[1] - ends[0]
    along = along / np.hypot(*along)
    normal = np.array([-along[1], along[0]])
    aslant = abs(float(side.along @ normal))  # of a length along the line, across the stub
    chords = np.maximum(width.mean() + taper * at, 1.0)
    variance = rough**2 + _FLOOR_PX**2 + (_FLOOR_SHARE * float(width.mean())) ** 2
    # neighbouring rows share their pixels
    shape = 2.0 * (1.0 / len(off) + at[:, None] * at / power)
    # the middle of any chord of a stripe on the ground is on the stripe's middle
    directions = np.array([side.along, side.along])
    shift, unsure = middle_shift(ends, directions, chords, turf, grey.shape[0])
    covariance = (variance * shape + unsure[:, None] * unsure) * aslant**2
    full = (covariance[:, None, :, None] * np.outer(normal, normal)[None, :, None]).reshape(4, 4)
    for i in (0, 2):  # along it nothing is known of an end
        full[i : i + 2, i : i + 2] += covariance[i // 2, i // 2] * np.outer(along, along)
    sigma = np.sqrt(np.diagonal(shape) * variance * aslant**2 + 2.0 * _FLOOR_PX**2)
    return SeenLine(ends + shift[:, None] * directions, full, chords * aslant, sigma)


def _goes_through(grey: UInt8Array, stub: SeenLine, line: SeenLine, bar: float) -> bool:
    """Whether it is seen on the line's other side, too: a net's cords are."""
    way = line.ends_px[1] - line.ends_px[0]
    length = float(np.hypot(*way))
    back = stub.ends_px[0] - stub.ends_px[1]
    back = back / np.hypot(*back)
    out = abs(float(back[1] * way[0] - back[0] * way[1])) / length
    share = float((stub.ends_px[0] - line.ends_px[0]) @ way) / length**2
    wide = float(np.interp(share, [0.0, 1.0], line.width_px))
    reach = (1.2 * wide + 2.0 * _FIRST_PX) / max(out, 0.05)
    return bool((_values(grey, stub.ends_px[0] + (reach + np.arange(3.0))[:, None] * back) > bar).all())


def _as_white(grey: UInt8Array, stub: SeenLine, line: SeenLine, side: _Side) -> bool:
    """Whether its middle is as bright as the line; blur makes thin ones darker."""
    middle = stub.ends_px[0] + np.linspace(0.0, 1.0, 5)[:, None] * (stub.ends_px[1] - stub.ends_px[0])
    brighter = (float(_median(_values(grey, middle))) - side.white) / (side.white - side.bar)
    darkest = -np.inf if stub.width_px.mean() < _THIN_PX else -_WHITER
    return darkest < brighter < (np.inf if line.width_px.mean() < _THIN_PX + 2.0 else _WHITER)


def _is_part(stub: SeenLine, line: SeenLine) -> bool:
    """Whether it is a part of that line."""
    way, own = line.ends_px[1] - line.ends_px[0], stub.ends_px[1] - stub.ends_px[0]
    length = float(np.hypot(*way))
    turned = abs(float(way[0] * own[1] - way[1] * own[0])) / (length * float(np.hypot(*own)))
    relative = stub.ends_px.mean(axis=0) - line.ends_px[0]
    place = float(relative @ way) / length
    off = abs(float(way[0] * relative[1] - way[1] * relative[0])) / length
    wide = float(line.width_px.max())
    return turned < _SAME and off < wide and -2.0 * wide < place < length + 2.0 * wide


def _median(values: NDArray[np.uint8]) -> FloatArray:
    """(...,) of values (..., k)."""
    ordered, half = np.sort(values, axis=-1).astype(np.float64), values.shape[-1] // 2
    return np.asarray(0.5 * (ordered[..., half] + ordered[..., (values.shape[-1] - 1) // 2]))


def _values(grey: UInt8Array, points: FloatArray) -> NDArray[np.uint8]:
    """Of the nearest pixels to points (..., 2)."""
    height, width = grey.shape
    column = np.minimum(np.maximum(np.rint(points[..., 0]).astype(np.intp), 0), width - 1)
    row = np.minimum(np.maximum(np.rint(points[..., 1]).astype(np.intp), 0), height - 1)
    return np.asarray(grey[row, column])
