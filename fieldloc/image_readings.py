"""Every way to read the posts of an image beside its lines.

A whole pose comes from lines of both directions; or from lines of one direction, cut by a post; or from two posts. To
each the other posts are added that stand where they should from there, or are left as none of the map's. Complete in
that sense: what is not here fails a gate that a right reading fails once in ten thousand times.

Where a post is so far that the likelihood bends (along the circle on which two posts appear under one angle, or along
a line of sight), it is cut into windows that are straight enough, each a solution of its own.
"""

from itertools import combinations

import numpy as np

from fieldloc.covariance import log_peaks
from fieldloc.image_anchors import Anchors, one_turn
from fieldloc.image_map import ImageMap
from fieldloc.image_posts import PostsSeen, seen_together
from fieldloc.image_states import Readings, Solved, Windows, inside, solve
from fieldloc.pose import FloatArray, wrap

_GATE = 18.42  # chi-square of two degrees: a right post fails once in ten thousand
_SIGMAS = 4.0  # by how much a misfit may exceed its mean, as a normal variable does by as many sigmas
_FARTHEST_M = 25.0
_GRID = np.linspace(-1.0, 1.0, 41)  # of places on a circle
_LEAST_ANGLE_RAD = 1e-3
_LARGEST_LOG_RATIO = 3.0  # of two posts' distances
_SEED_STEPS = 2
_SEED_SLACK_M = 1.0  # how far a seed may be off beside the field
_WINDOW_STEPS = 4
_STRAIGHT_LOG_M = 0.15  # standard deviation of a log distance up to which a likelihood is a Gaussian
_STRAIGHT_RAD = 0.08  # the same of the direction from two posts
_APART = 2.0  # windows, in their width: then their sum is flat to a hundredth
_LOG_WORTH_CUTTING = -7.0  # of the best solution: a thousandth
_MOST_WINDOWS = 7  # to each side


def read(anchors: Anchors, posts: PostsSeen, field: ImageMap, turn_rad: float, least: float) -> Solved:
    """All readings that determine a pose, with how likely they are; those nowhere likelier than `least` are left out.

    turn_rad: 2 pi, or the field's symmetry, of which then one turn is enough. The last anchor may be one that says
    nothing: then posts by themselves are readings too.
    """
    whole = _of_lines(anchors, len(posts))
    if not len(posts):
        return whole
    out = whole
    found = None
    seeds = [make(anchors, posts, field) for make in (_along_lines, _pairs)]
    if any(map(len, seeds)):
        start = seeds[0].beside(seeds[1])
        start = start.take(one_turn(start.poses[:, 2], turn_rad))
        found = solve(start, anchors, posts, field, _SEED_STEPS)
        found = found.take(found.log_integrals > -np.inf)
        out = whole.beside(found)
    more, predicted = _with_more_posts(out, posts, field)
    if found is not None:
        best = float(whole.log_integrals.max(initial=-np.inf))
        straight = _straightened(found, anchors, posts, field, least, best)
        out = whole.beside(_bent(straight, anchors, field))
    if len(more):
        out = out.beside(solve(more, anchors, posts, field, 1, predicted=predicted))
    return out.take(_log_peaks(out) > least)


def _log_peaks(solved: Solved) -> FloatArray:
    """(k,) log density of each at its own pose."""
    return np.asarray(solved.log_integrals + log_peaks(solved.covariances))


def _of_lines(anchors: Anchors, posts: int) -> Solved:
    """Whole poses of lines, with no post matched."""
    rows = np.flatnonzero(anchors.whole)
    readings = Readings(rows, np.full((len(rows), posts), -1, dtype=np.intp), anchors.poses[rows])
    return Solved(readings, anchors.covariances[rows], anchors.log_weights[rows])


def _along_lines(anchors: Anchors, posts: PostsSeen, field: ImageMap) -> Readings:
    """Lines of one direction cut by one post each, the first of those that are the map's."""
    rows = np.flatnonzero(anchors.rank == 2)
    if not len(rows):
        return Readings.none(len(posts))
    post, mark = np.nonzero(posts.allowed)
    index = np.repeat(rows, len(post))
    post, mark = np.tile(post, len(rows)), np.tile(mark, len(rows))
    at = anchors.poses[index]
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    ahead = at[:, 2] + posts.fused[post, 0]
    sight_x, sight_y = np.cos(ahead), np.sin(ahead)
    free = anchors.free[index]
    # the robot if it stood at the post, and from there backwards along the line of sight
    ahead_m, left_m = posts.below_camera
    x = field.landmarks[mark, 0] - c * ahead_m + s * left_m
    y = field.landmarks[mark, 1] - s * ahead_m - c * left_m
    gap = free[:, 1] * (x - at[:, 0]) - free[:, 0] * (y - at[:, 1])
    cosine, sine = free[:, 1] * sight_x - free[:, 0] * sight_y, free[:, 0] * sight_x + free[:, 1] * sight_y
    gap = np.where(np.abs(gap) < 1e-3, 1e-3, gap)
    # inverse distance by the line and by the post, the better counts for more
    by_line, own = cosine / gap, posts.fused[post, 1]
    variance = anchors.covariances[index]
    line_variance = (variance[:, 0, 0] * sine**2 + by_line**2 * variance[:, 1, 1]) / gap**2 + 1e-6
    own_variance = posts.fused_covariance[post, 1, 1]
    agree = (by_line - own) ** 2 < 2.0 * _GATE * (line_variance + own_variance)
    inverse = (by_line * own_variance + own * line_variance) / (own_variance + line_variance)
    distance = 1.0 / np.maximum(inverse, 1.0 / _FARTHEST_M)
    poses = np.stack([x - distance * sight_x, y - distance * sight_y, at[:, 2]], axis=-1)
    along = free[:, 0] * poses[:, 0] + free[:, 1] * poses[:, 1]
    reach = 1.0 + _SIGMAS * np.sqrt(own_variance) * distance**2
    bounds = anchors.along_m[index]
    agree &= (bounds[:, 0] - reach < along) & (along < bounds[:, 1] + reach)
    kept = np.flatnonzero(agree & inside(poses, field, _SEED_SLACK_M))
    matched = np.full((len(kept), len(posts)), -1, dtype=np.intp)
    matched[np.arange(len(kept)), post[kept]] = mark[kept]
    return Readings(index[kept], matched, poses[kept])


def _pairs(anchors: Anchors, posts: PostsSeen, field: ImageMap) -> Readings:
    """Two posts without any line, the first two of those that are the map's.

    The angle between them puts the robot on a circle (see `fieldloc.fixes.two_posts`): here are the places on it that
    explain the distances best, which are two where the robot is aside of the posts to either hand.
    """
    count = len(posts)
    if count < 2 or anchors.rank[-1] > 0:
        return Readings.none(count)
    i, j = np.array(list(combinations(range(count), 2))).T
    together, covariance = seen_together(posts, i, j)
    alpha = wrap(together[:, 2] - together[:, 0])[:, None]
    alpha = np.where(np.abs(alpha) < _LEAST_ANGLE_RAD, _LEAST_ANGLE_RAD, alpha)
    unit = np.abs(alpha)
    rho = unit * np.sinh(np.arcsinh(_LARGEST_LOG_RATIO / unit) * _GRID)
    w = 1.0 / np.expm1(1j * alpha - rho)
    different = ~np.eye(len(field.landmarks), dtype=np.bool_)
    pair, one, other = np.nonzero(posts.allowed[i][:, :, None] & posts.allowed[j][:, None, :] & different)
    p, chord = field.landmarks[one], field.landmarks[other] - field.landmarks[one]
    length = np.hypot(chord[:, 0], chord[:, 1])[:, None]
    of_i = (1.0 / np.abs(w))[pair] / length - together[pair, 1][:, None]
    of_j = (1.0 / np.abs(1.0 + w))[pair] / length - together[pair, 3][:, None]
    a, b, d = (covariance[pair, row, column][:, None] for row, column in ((1, 1), (1, 3), (3, 3)))
    misfit = (d * of_i**2 - 2.0 * b * of_i * of_j + a * of_j**2) / (a * d - b * b)
    lowest = misfit < _GATE
    lowest[:, 1:] &= misfit[:, 1:] < misfit[:, :-1]
    lowest[:, :-1] &= misfit[:, :-1] <= misfit[:, 1:]
    row, column = np.nonzero(lowest)
    at, toward = w[pair[row], column], chord[row, 0] + 1j * chord[row, 1]
    place = p[row, 0] + 1j * p[row, 1] - toward * at
    heading = wrap(np.angle(toward * at) - together[pair[row], 0])
    place = place - np.exp(1j * heading) * complex(*posts.below_camera)
    poses = np.stack([place.real, place.imag, heading], axis=-1)
    matched = np.full((len(row), count), -1, dtype=np.intp)
    each = np.arange(len(row))
    matched[each, i[pair[row]]], matched[each, j[pair[row]]] = one[row], other[row]
    return Readings(np.full(len(row), len(anchors) - 1), matched, poses)


def _with_more_posts(base: Solved, posts: PostsSeen, field: ImageMap) -> tuple[Readings, FloatArray]:
    """The readings with further posts that stand where they should from the pose; each set of posts once. And what
    those are from there."""
    poses, matched = base.readings.poses, base.readings.matched
    predicted = posts.predicted(poses[:, None], field.landmarks)
    slope, error = predicted[..., :3], predicted[:, None, :, :, 3] - posts.fused[:, None]
    x, y = wrap(error[..., 0]), error[..., 1]
    # twice the sum, as the mount's errors are in both
    spread = (slope @ base.covariances[:, None] @ slope.swapaxes(2, 3))[:, None] + posts.fused_covariance[:, None]
    a, b, d = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
    fits = (d * x - 2.0 * b * y) * x + a * y * y < 2.0 * _GATE * (a * d - b * b)
    fits &= posts.allowed
    order = np.arange(len(posts))
    if (seen := matched >= 0).any():
        last = np.where(seen, order, -1).max(axis=1)
        fits &= (order > last[:, None])[..., None]
    parents = np.arange(len(base))
    for post in order.tolist():
        row, mark = fits[parents, post].nonzero()
        free = (matched[row] != mark[:, None]).all(axis=1)
        row, mark = row[free], mark[free]
        if len(row):
            more = matched[row]
            more[:, post] = mark
            matched, parents = np.concatenate([matched, more]), np.concatenate([parents, parents[row]])
    rows, matched = parents[len(base) :], matched[len(base) :]
    return Readings(base.readings.anchors[rows], matched, poses[rows]), predicted[rows[:, None], matched]


def _straightened(
    found: Solved, anchors: Anchors, posts: PostsSeen, field: ImageMap, least: float, best: float
) -> Solved:
    """Those that are no Gaussian in windows, unless others, the best of which has the log integral `best`, are far
    likelier."""
    poses, matched = found.readings.poses, found.readings.matched
    count = (matched >= 0).sum(axis=1)
    centre = (field.landmarks[matched] * (matched >= 0)[..., None]).sum(axis=1) / count[:, None]
    by_distance = count == 1
    away = poses[:, :2] - centre
    distance = np.hypot(away[:, 0], away[:, 1])
    direction = np.arctan2(away[:, 1], away[:, 0])
    turned = np.where(by_distance, direction, direction + 0.5 * np.pi) - poses[:, 2]
    unit = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    spread = np.sqrt(np.einsum("ki,kij,kj->k", unit, found.covariances[:, :2, :2], unit)) / distance
    likely = _log_peaks(found) > least
    likely &= found.log_integrals > found.log_integrals.max(initial=best) + _LOG_WORTH_CUTTING
    bent = np.flatnonzero((spread > np.where(by_distance, _STRAIGHT_LOG_M, _STRAIGHT_RAD)) & likely)
    if not len(bent):
        return found
    width = np.where(by_distance, _STRAIGHT_LOG_M, _STRAIGHT_RAD)
    to_side = np.minimum(np.ceil(_SIGMAS * spread[bent] / (_APART * width[bent])), _MOST_WINDOWS)
    step = np.arange(-_MOST_WINDOWS, _MOST_WINDOWS + 1)
    row, column = np.nonzero(np.abs(step) <= to_side[:, None])
    row = bent[row]
    shift = _APART * width[row] * step[column]
    at = found.readings.take(row)
    near = np.where(by_distance[row], np.exp(shift), 1.0)[:, None] * away[row]
    turn = np.where(by_distance[row], 0.0, shift)
    c, s = np.cos(turn), np.sin(turn)
    at.poses[:, 0] = centre[row, 0] + c * near[:, 0] - s * near[:, 1]
    at.poses[:, 1] = centre[row, 1] + s * near[:, 0] + c * near[:, 1]
    at.poses[:, 2] += turn
    middle = np.where(by_distance[row], np.log(distance[row]), direction[row]) + shift
    windows = Windows(centre[row], middle, by_distance[row], width[row])
    cut = solve(at, anchors, posts, field, _WINDOW_STEPS, windows)
    cut.log_integrals[:] += np.log(_APART / np.sqrt(2.0 * np.pi))
    straight = np.ones(len(found), dtype=np.bool_)
    straight[bent] = False
    return found.take(straight).beside(cut)


def _bent(found: Solved, anchors: Anchors, field: ImageMap) -> Solved:
    """With the covariance of what is left of the bend where posts alone are known, second moment about the solution:
    s along a circle of radius r is s^2 / 2r aside of its tangent."""
    rows = np.flatnonzero(anchors.rank[found.readings.anchors] == 0)
    if not len(rows):
        return found
    matched = found.readings.matched[rows]
    seen = (matched >= 0)[..., None]
    away = (found.readings.poses[rows, None, :2] - field.landmarks[matched]) * seen
    # a circle through two posts is at least as large as half the way to them
    radius = 0.5 * np.sqrt((away**2).sum(axis=(1, 2)) / seen.sum(axis=(1, 2)))
    values, vectors = np.linalg.eigh(found.covariances[rows, :2, :2])
    aside = 0.75 * (values[:, 1] / radius) ** 2
    across = vectors[:, :, 0]
    found.covariances[rows, :2, :2] += aside[:, None, None] * across[:, :, None] * across[:, None, :]
    return found
