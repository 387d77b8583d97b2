"""What a rendered picture truly shows: the visible pieces of lines, circles, posts, bars and marks, in pixels.

Positions are exact projections of the map. Where something nearer hides a part, its end is known to half a pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.render.canvas import Canvas
from fieldloc.render.crossings import crossings_of
from fieldloc.render.goals import crossbars, post_of
from fieldloc.render.scene import Goals

_SAMPLES = 801  # along each thing
_HALVINGS = 20  # 1/800 of a line halved so often is a millionth of a pixel

Runs = list[tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class LineTruth:
    """A visible piece of a line's middle. line: its row on the map. ends_px, ends_m: (2, 2), in its direction."""

    line: int
    ends_px: FloatArray
    ends_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CircleTruth:
    """points_px: (n, 2) visible points of the middle of a circle's line, in order; circle: its row on the map."""

    circle: int
    points_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PostTruth:
    """The longest visible piece of either edge, (2, 2) from its upper to its lower end, None where none is visible.

    foot_px: (2,) the middle of its visible contact with the ground; top_px: (2,) the upper end of its outer edge,
    beside the crossbar; None where hidden or beside the picture.
    """

    label: str
    left_px: FloatArray | None
    right_px: FloatArray | None
    foot_px: FloatArray | None
    top_px: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class BarTruth:
    """The longest visible piece (2, 2) of either edge of a crossbar, None where none is visible."""

    labels: tuple[str, str]
    upper_px: FloatArray | None
    lower_px: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class MarkTruth:
    """centre_px: (2,) of a visible mark; mark: its row on the map."""

    mark: int
    centre_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CrossingTruth:
    """point_px: (2,) where the middles of two lines, rows of the map, meet in sight; kind: L, T or X."""

    lines: tuple[int, int]
    kind: str
    point_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """hidden: (h, w) where something stands in front of the ground and the sky."""

    lines: tuple[LineTruth, ...]
    circles: tuple[CircleTruth, ...]
    posts: tuple[PostTruth, ...]
    bars: tuple[BarTruth, ...]
    marks: tuple[MarkTruth, ...]
    crossings: tuple[CrossingTruth, ...]
    hidden: NDArray[np.bool_]


def truth_of(canvas: Canvas, camera: Camera, field_map: FieldMap, goals: Goals, ranks: dict[int, int]) -> Truth:
    """ranks: as `paint_standing` returns them."""
    sight = _Sight(canvas, camera)
    lines = []
    for row, (start, end) in enumerate(field_map.lines):

        def along(shares: FloatArray, start: FloatArray = start, end: FloatArray = end) -> FloatArray:
            return _on_ground(start + shares[:, None] * (end - start))

        for run in sight.runs(along, 0):
            points = along(np.array(run))
            lines.append(LineTruth(row, sight.pixels(points)[0], points[:, :2]))
    circles = []
    for row, (x, y, radius) in enumerate(field_map.circles):
        turn = np.linspace(-np.pi, np.pi, _SAMPLES)[:-1]
        around = np.array([x, y]) + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        pixels, seen = sight.visible(_on_ground(around), 0)
        if seen.any():
            first = int(np.argmin(seen))  # begin behind a gap, so that the points are in order
            circles.append(CircleTruth(row, np.roll(pixels, -first, axis=0)[np.roll(seen, -first)]))
    posts = [_post(sight, field_map, goals, row, ranks[row]) for row in range(len(field_map.landmarks)) if row in ranks]
    bars = _bars(sight, field_map, goals, ranks)
    centres, seen = sight.visible(_on_ground(field_map.marks), 0)
    marks = tuple(MarkTruth(int(row), centres[row]) for row in np.flatnonzero(seen))
    meeting = crossings_of(field_map)
    points, seen = sight.visible(_on_ground(np.array([one.point for one in meeting]).reshape(-1, 2)), 0)
    crossings = [CrossingTruth(meeting[row].lines, meeting[row].kind, points[row]) for row in np.flatnonzero(seen)]
    shown = [post for post in posts if post.left_px is not None or post.right_px is not None]
    hidden = (canvas.rank > 0).reshape(camera.height_px, camera.width_px)
    return Truth(tuple(lines), tuple(circles), tuple(shown), tuple(bars), marks, tuple(crossings), hidden)


class _Sight:
    """From points of the field to pixels, and whether something nearer hides them."""

    def __init__(self, canvas: Canvas, camera: Camera) -> None:
        self.eye = canvas.eye.centre
        self._camera, self._rank = camera, canvas.rank
        self._field_from_camera = canvas.eye.field_from_camera

    def pixels(self, points: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(n, 2) of points (n, 3), and which are on the image."""
        return self._camera.project((points - self.eye) @ self._field_from_camera)

    def visible(self, points: FloatArray, rank: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Pixels (n, 2) of points (n, 3) on something painted at that rank, and which of them can be seen."""
        pixels, seen = self.pixels(points)
        last = [self._camera.width_px - 1, self._camera.height_px - 1]
        u, v = np.clip(np.rint(pixels[seen]).astype(np.intp), 0, last).T
        seen[seen] = self._rank[v * self._camera.width_px + u] <= rank
        return pixels, seen

    def runs(self, along: Callable[[FloatArray], FloatArray], rank: int) -> Runs:
        """Visible pieces of a curve: from which share of its way (0 to 1) to which."""
        shares = np.linspace(0.0, 1.0, _SAMPLES)
        _, seen = self.visible(along(shares), rank)
        change = np.diff(np.concatenate([[0], seen.astype(np.int8), [0]]))
        first, last = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
        good = shares[np.concatenate([first, last])]
        bad = shares[np.concatenate([np.maximum(first - 1, 0), np.minimum(last + 1, _SAMPLES - 1)])]
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            _, inside = self.visible(along(middle), rank)
            good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
        return list(zip(good[: len(first)].tolist(), good[len(first) :].tolist(), strict=True))

    def longest(self, start: FloatArray, end: FloatArray, rank: int) -> FloatArray | None:
        """Ends (2, 2) in pixels of the longest visible piece from start (3,) to end (3,)."""

        def along(shares: FloatArray) -> FloatArray:
            return start + shares[:, None] * (end - start)

        runs = self.runs(along, rank)
        if not runs:
            return None
        low, high = max(runs, key=lambda run: run[1] - run[0])
        return self.pixels(along(np.array([low, high])))[0]

    def point(self, point: FloatArray, rank: int) -> FloatArray | None:
        pixels, seen = self.visible(point[None], rank)
        return pixels[0] if seen[0] else None


def _post(sight: _Sight, field_map: FieldMap, goals: Goals, index: int, rank: int) -> PostTruth:
    post, label = post_of(field_map, index, goals), field_map.labels[index]
    touched = post.touched(sight.eye)
    if touched is None:
        return PostTruth(label, None, None, None, None)
    edges = [sight.longest(np.append(at, post.high_m), np.append(at, 0.0), rank) for at in touched]
    foot = sight.point(np.append(post.foot(sight.eye), 0.0), rank)
    top = None
    for partner in (a if b == label else b for a, b in field_map.crossbars if label in (a, b)):
        other = field_map.positions[field_map.labels.index(partner)]
        outer = touched[int(np.linalg.norm(touched - other, axis=-1).argmax())]
        top = sight.point(np.append(outer, post.high_m), rank)
    return PostTruth(label, edges[0], edges[1], foot, top)


def _bars(sight: _Sight, field_map: FieldMap, goals: Goals, ranks: dict[int, int]) -> list[BarTruth]:
    out = []
    for row, bar in enumerate(crossbars(field_map, goals)):
        part, edges = len(field_map.landmarks) + row, bar.touched(sight.eye)
        if part not in ranks or edges is None:
            continue
        upper, lower = (sight.longest(start, end, ranks[part]) for start, end in edges)
        if upper is not None or lower is not None:
            out.append(BarTruth(field_map.crossbars[row], upper, lower))
    return out


def _on_ground(points: FloatArray) -> FloatArray:
    return np.column_stack([points, np.zeros(len(points))])
