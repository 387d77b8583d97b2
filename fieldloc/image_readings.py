"""Every way to read the posts of an image beside its lines: seeds of poses, and which further posts fit them."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.image_anchors import Anchors
from fieldloc.image_posts import PostsSeen
from fieldloc.image_states import Readings, Solved, solve
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap

_GATE = 18.42  # chi-square of two degrees: a right post fails once in ten thousand
_SIGMAS = 4.0  # by how much a misfit may exceed its mean, as a normal variable does by as many sigmas
_AROUND_M = 1.0  # a robot can stand outside of the lines
_FARTHEST_M = 25.0
_SEED_STEPS = 3
_STEPS = 2


def read(anchors: Anchors, posts: PostsSeen, field: FieldMap, turn_rad: float) -> Solved:
    """All readings that determine a pose, with how likely they are. turn_rad: 2 pi, or the field's symmetry, of which
    then one turn is enough."""
    none = np.zeros(0, dtype=np.intp)
    start = Readings(none, np.zeros((0, len(posts)), dtype=np.intp), np.zeros((0, 3)))
    by_posts = [make(anchors, posts, field) for make in (_along_lines, _pairs)] if len(posts) else []
    for seeds in by_posts:
        start = start.beside(seeds)
    start = start.take(_one_turn(start.poses[:, 2], turn_rad))
    found = solve(start, anchors, posts, field, _SEED_STEPS) if len(start) else None
    whole = np.flatnonzero(anchors.whole)
    base = Readings(whole, np.full((len(whole), len(posts)), -1, dtype=np.intp), anchors.poses[whole])
    covariances = anchors.covariances[whole]
    if found is not None:
        found = found.take(_possible(found, anchors, field))
        base = base.beside(found.readings)
        covariances = np.concatenate([covariances, found.covariances])
    every = _with_more_posts(base, covariances, posts, field) if len(posts) else base
    if not len(every):
        return _nothing(len(posts))
    out = solve(every, anchors, posts, field, _STEPS)
    return out.take(_possible(out, anchors, field))


def one_turn(headings_rad: FloatArray, turn_rad: float) -> NDArray[np.bool_]:
    """One each of headings that differ by whole turns of a symmetry; the edge is where no field's lines run."""
    return np.asarray((headings_rad - _EDGE_RAD) % (2 * np.pi) < turn_rad)


_EDGE_RAD = 0.6173
_one_turn = one_turn


def _along_lines(anchors: Anchors, posts: PostsSeen, field: FieldMap) -> Readings:
    """Lines of one direction cut by one post each, the first of those that are the map's."""
    rows = np.flatnonzero(~anchors.whole & anchors.whitening.any(axis=(1, 2)))
    post, mark = np.nonzero(posts.allowed)
    index = np.repeat(rows, len(post))
    post, mark = np.tile(post, len(rows)), np.tile(mark, len(rows))
    heading = anchors.poses[index, 2]
    offset = posts.below_camera
    c, s = np.cos(heading), np.sin(heading)
    ahead = heading + posts.fused[post, 0]
    sight = np.stack([np.cos(ahead), np.sin(ahead)], axis=-1)
    # where the robot would be at the post
    at_post = field.positions[mark] - np.stack([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]], axis=-1)
    free = anchors.free[index]
    across = np.stack([free[:, 1], -free[:, 0]], axis=-1)
    gap = np.sum(across * (at_post - anchors.poses[index, :2]), axis=-1)
    cosine, sine = np.sum(across * sight, axis=-1), np.sum(free * sight, axis=-1)
    # inverse distance by the line and by the post, the better counts for more
    safe = np.where(np.abs(gap) < 1e-3, 1e-3, gap)
    by_line = cosine / safe
    variance = anchors.covariances[index]
    line_variance = (variance[:, 0, 0] * sine**2 + by_line**2 * variance[:, 1, 1]) / safe**2 + 1e-6
    own, own_variance = posts.fused[post, 1], posts.fused_covariance[post, 1, 1]
    agree = (by_line - own) ** 2 < 2.0 * _GATE * (line_variance + own_variance)
    inverse = (by_line / line_variance + own / own_variance) / (1.0 / line_variance + 1.0 / own_variance)
    distance = 1.0 / np.maximum(inverse, 1.0 / _FARTHEST_M)
    position = at_post - distance[:, None] * sight
    poses = np.concatenate([position, heading[:, None]], axis=-1)
    kept = agree & _inside(poses, field)
    matched = np.full((len(index), len(posts)), -1, dtype=np.intp)
    matched[np.arange(len(index)), post] = mark
    return Readings(index, matched, poses).take(kept)


def _pairs(anchors: Anchors, posts: PostsSeen, field: FieldMap) -> Readings:
    """Two posts without any line, the first two of those that are the map's."""
    found = []
    none = len(anchors) - 1  # the anchor that says nothing
    inverse = np.maximum(posts.fused[:, 1], 1.0 / _FARTHEST_M)
    bearing = posts.fused[:, 0]
    seen = posts.below_camera + np.stack([np.cos(bearing), np.sin(bearing)], axis=-1) / inverse[:, None]
    for i, j in combinations(range(len(posts)), 2):
        one, other = np.nonzero(
            posts.allowed[i][:, None] & posts.allowed[j] & ~np.eye(len(field.landmarks), dtype=bool)
        )
        p, q = field.positions[one], field.positions[other]
        apart, on_map = seen[j] - seen[i], q - p
        # how far apart they are must agree with how far apart they look
        spread = np.sqrt(posts.fused_covariance[[i, j], 1, 1]) / inverse[[i, j]]
        slack = 2.0 * _SIGMAS * np.hypot(*(spread / inverse[[i, j]])) + 0.2
        agree = np.abs(np.hypot(*on_map.T) - np.hypot(*apart)) < slack
        heading = np.arctan2(on_map[:, 1], on_map[:, 0]) - np.arctan2(apart[1], apart[0])
        share = inverse[[i, j]] ** 2 / np.sum(inverse[[i, j]] ** 2)
        middle = share[0] * seen[i] + share[1] * seen[j]
        c, s = np.cos(heading), np.sin(heading)
        turned = np.stack([c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]], axis=-1)
        poses = np.concatenate([share[0] * p + share[1] * q - turned, wrap(heading)[:, None]], axis=-1)
        matched = np.full((len(poses), len(posts)), -1, dtype=np.intp)
        matched[:, i], matched[:, j] = one, other
        found.append(Readings(np.full(len(poses), none), matched, poses).take(agree))
    if not found:
        return Readings(np.zeros(0, dtype=np.intp), np.zeros((0, len(posts)), dtype=np.intp), np.zeros((0, 3)))
    out = found[0]
    for more in found[1:]:
        out = out.beside(more)
    return out


def _with_more_posts(base: Readings, covariances: FloatArray, posts: PostsSeen, field: FieldMap) -> Readings:
    """The readings, and those with further posts that stand where they should from the pose; each set once."""
    if not len(base):
        return base
    value, slope = posts.predicted(base.poses[:, None], field.positions)
    error = value[:, None] - posts.fused[:, None]
    error[..., 0] = wrap(error[..., 0])
    # twice the sum, as the mount's errors are in both
    spread = (slope @ covariances[:, None] @ np.swapaxes(slope, -1, -2))[:, None] + posts.fused_covariance[:, None]
    a, b, d = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
    x, y = error[..., 0], error[..., 1]
    distance = (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b)
    last = np.where(base.matched >= 0, np.arange(len(posts)), -1).max(axis=1)
    fits = (distance < 2.0 * _GATE) & posts.allowed & (np.arange(len(posts)) > last[:, None])[..., None]
    every, parents = base, np.arange(len(base))
    for post in range(len(posts)):
        row, mark = np.nonzero(
            fits[parents, post] & (every.matched[:, :, None] != np.arange(fits.shape[2])).all(axis=1)
        )
        if len(row):
            more = every.take(row)
            more.matched[:, post] = mark
            every, parents = every.beside(more), np.concatenate([parents, parents[row]])
    return every


def _possible(solved: Solved, anchors: Anchors, field: FieldMap) -> NDArray[np.bool_]:
    """Inside the field, where the lines are long enough, and no worse a fit than noise can make it."""
    poses, rows = solved.readings.poses, solved.readings.anchors
    spread = 2.0 / (9.0 * np.maximum(solved.degrees, 1))  # Wilson and Hilferty, 1931
    bound = np.maximum(solved.degrees, 1) * (1.0 - spread + _SIGMAS * np.sqrt(spread)) ** 3
    at = np.sum(anchors.free[rows] * poses[:, :2], axis=-1)
    reach = _SIGMAS * np.sqrt(solved.covariances[:, 0, 0] + solved.covariances[:, 1, 1])
    along = anchors.along_m[rows]
    long_enough = ~anchors.free[rows].any(axis=1) | ((along[:, 0] - reach < at) & (at < along[:, 1] + reach))
    return np.asarray(_inside(poses, field) & long_enough & (solved.misfit < bound) & np.isfinite(solved.log_integrals))


def _inside(poses: FloatArray, field: FieldMap) -> NDArray[np.bool_]:
    low_x, low_y, high_x, high_y = field.bounds
    x, y = poses[:, 0], poses[:, 1]
    return np.asarray(
        (x > low_x - _AROUND_M) & (x < high_x + _AROUND_M) & (y > low_y - _AROUND_M) & (y < high_y + _AROUND_M)
    )


def _nothing(posts: int) -> Solved:
    none: IntArray = np.zeros(0, dtype=np.intp)
    readings = Readings(none, np.zeros((0, posts), dtype=np.intp), np.zeros((0, 3)))
    return Solved(readings, np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0), none)
