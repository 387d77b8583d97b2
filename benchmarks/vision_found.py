"""What is detected of a rendered picture beside what it truly shows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.truth import PostTruth, Truth
from fieldloc.vision.detections import Detections, SeenPost

_WITHIN_PX = 3.0
_STEP_PX = 2.0
_SHORTEST_PX = 20.0  # of a visible piece of a line, or of a post's edge, that ought to be found
_NARROWEST_PX = 4.0  # of a post
_OVERLAP = 0.5


class Found(NamedTuple):
    """Lines in points two pixels apart, of lines and circles: how many true, of these found, how many seen, of these
    true. Posts likewise."""

    lines: int
    lines_found: int
    lines_seen: int
    lines_right: int
    posts: int
    posts_found: int
    posts_seen: int
    posts_right: int


def found_in(detections: Detections, truth: Truth) -> Found:
    long = [line.ends_px for line in truth.lines if np.linalg.norm(line.ends_px[1] - line.ends_px[0]) >= _SHORTEST_PX]
    rims = [one.points_px for one in truth.circles]
    true = _points(long, rims)
    all_true = _points([line.ends_px for line in truth.lines], rims)
    seen = _points([line.ends_px for line in detections.lines], [one.points_px for one in detections.circles])
    wide = [post for post in truth.posts if _is_wide(post)]
    return Found(
        len(true),
        _near(true, seen),
        len(seen),
        _near(seen, all_true),
        len(wide),
        sum(any(_same(post, one) for one in detections.posts) for post in wide),
        len(detections.posts),
        sum(any(_same(post, one) for post in truth.posts) for one in detections.posts),
    )


def shares(found: Sequence[Found]) -> tuple[float, float, float, float]:
    """Recall and precision of lines, of posts."""
    total = Found(*(sum(values) for values in zip(*found, strict=True)))
    return (
        total.lines_found / max(total.lines, 1),
        total.lines_right / max(total.lines_seen, 1),
        total.posts_found / max(total.posts, 1),
        total.posts_right / max(total.posts_seen, 1),
    )


def _points(lines: Sequence[FloatArray], rims: Sequence[FloatArray]) -> FloatArray:
    """(n, 2): straight lines in steps, and curves, whose neighbours are joined where they are near each other."""
    pieces = [np.zeros((0, 2))]
    for ends in lines:
        count = 1 + round(float(np.linalg.norm(ends[1] - ends[0])) / _STEP_PX)
        pieces.append(ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0]))
    for rim in rims:
        for pair in np.stack([rim[:-1], rim[1:]], axis=1):
            length = float(np.linalg.norm(pair[1] - pair[0]))
            if length < 10.0 * _STEP_PX:
                count = 1 + round(length / _STEP_PX)
                pieces.append(pair[0] + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (pair[1] - pair[0]))
    return np.concatenate(pieces)


def _near(points: FloatArray, others: FloatArray) -> int:
    if not len(points) or not len(others):
        return 0
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(others).query(points)
    return int((distances <= _WITHIN_PX).sum())


def _is_wide(post: PostTruth) -> bool:
    if post.left_px is None or post.right_px is None:
        return False
    heights = [float(np.ptp(edge[:, 1])) for edge in (post.left_px, post.right_px)]
    width = float(post.right_px[:, 0].mean() - post.left_px[:, 0].mean())
    return min(heights) >= _SHORTEST_PX and width >= _NARROWEST_PX


def _same(post: PostTruth, seen: SeenPost) -> bool:
    """Whether they overlap across, in the middle row of the one that is seen."""
    if post.left_px is None or post.right_px is None:
        return False
    row = float(np.concatenate([seen.left_px, seen.right_px])[:, 1].mean())
    low, high = _at(post.left_px, row), _at(post.right_px, row)
    first, last = _at(seen.left_px, row), _at(seen.right_px, row)
    return min(high, last) - max(low, first) >= _OVERLAP * (max(high, last) - min(low, first))


def _at(edge: FloatArray, row: float) -> float:
    """u of an upright edge in a row."""
    (u, v), (u_low, v_low) = edge
    return float(u + (u_low - u) * (row - v) / (v_low - v)) if abs(v_low - v) > 1e-6 else float(u)
