"""Where the camera may be: closed-form places from pairs of things seen, given how it is turned and how high it is.

In axes along the grid, centred below the camera, a seen line is one coordinate; so the camera's x follows from any line
that runs along y and any such line of the map, its y likewise, and each is voted for by all lines of that direction
(paper, eqs. 14-15). The circle's middle and a post are whole places, a post's bearing and a line one too. Two posts
need no line: paper, eqs. 3-12. All places are worth the votes for their coordinates; the best are told.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.fixes.two_posts import poses_from_two_posts
from fieldloc.locate.cameras import not_zero
from fieldloc.locate.heights import circle_on_ground, heights, post_ranges
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.locate.states import cross, rotations
from fieldloc.locate.widths import widths_fit
from fieldloc.pose import FloatArray, rotation, wrap

_MOST, _LEAST, _ALL_LINES = 480, 64, 2400  # candidates: the fewer lines there are, the less do votes tell,
_HEIGHTS = 2  # times as many where the height is not known
_MOST_COORDINATES = 7
_MOST_POSTS = 4  # the largest
_STEP_M = 0.05  # of the coordinates that are voted for
_OFF, _OFF_M = 0.06, 0.1  # how far off a distance on the ground may be while height and attitude are rough
_AROUND_M = 0.5
_WIDEN_PX = 10.0  # how far off what is seen may be for the same reason
_ASKEW = np.sin(np.radians(12.0))
_SAME_M = 0.25
_NEAREST_M, _FARTHEST_M = 0.3, 15.0  # of a post of which only the bearing is used
_POST, _BEARING, _CIRCLE = 1.0, 0.5, 2.0  # what they are worth beside a line's one vote
_CIRCLE_M, _CIRCLE_LARGE = 0.3, 0.05  # how far off its place is, and its size


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What is seen, on the ground below each of g cameras, in axes turned against the grid by a quarter turn or none.

    families: (g, l) 0 along x, 1 along y, -1 of neither. offsets: (g, l) the other coordinate, metres. weights: (g, l),
    less of lines that are too thin or too wide. posts: (g, p, 2) places, which may be far off along their direction.
    circle: (g, 3) with its radius, NaN for none.
    """

    families: NDArray[np.intp]
    offsets: FloatArray
    weights: FloatArray
    posts: FloatArray
    circle: FloatArray


def candidates(sight: Sight, shape: Shape, prior: CameraPrior, angles: FloatArray) -> FloatArray:
    """States (k, 6) from attitudes (a, 3); of a map with a half turn one of each two."""
    rows = [(row, height) for row, one in enumerate(angles) for height in heights(sight, shape, prior, one)]
    found, votes, keys = [np.zeros((0, 6))], [np.zeros(0)], [np.zeros((0, 2))]
    if rows:
        attitude = np.array([row for row, _ in rows])
        uprights = np.zeros((len(rows), 6))
        uprights[:, 2], uprights[:, 4:] = angles[attitude, 0], angles[attitude, 1:]
        uprights[:, 3] = [height for _, height in rows]
        ground = _ground(sight, shape, uprights)
        for turn in range(2 if len(shape.symmetries) else 4):
            places, worth, of = _places(ground, shape, turn)
            states = uprights[of]
            states[:, :2] = places
            states[:, 2] += 0.5 * np.pi * turn + shape.grid_rad
            found.append(states)
            votes.append(worth)
            keys.append(np.column_stack([attitude[of], np.full(len(of), turn)]))
    states, worth = np.concatenate(found), np.concatenate(votes)
    inside = (states[:, :2] > shape.box[:2] - _AROUND_M) & (states[:, :2] < shape.box[2:] + _AROUND_M)
    order = np.flatnonzero(inside.all(axis=1))
    order = order[np.argsort(-worth[order], kind="stable")]
    # the same place from other heights or other things is the same candidate
    key = np.column_stack([np.concatenate(keys)[order], np.floor(states[order, :2] / _SAME_M)]).astype(np.intp)
    key -= key.min(axis=0, initial=0)
    flat = np.ravel_multi_index(tuple(key.T), tuple(key.max(axis=0, initial=0) + 1)) if len(key) else key[:, 0]
    _, first = np.unique(flat, return_index=True)
    enough = _ALL_LINES * (1 if prior.knows_height else _HEIGHTS) // max(len(sight.line_rows), 1) ** 2
    most = min(max(enough, _LEAST), _MOST)
    states = states[order[np.sort(first)[:most]]]
    if len(sight.post_rows) > 1 and len(angles):
        states = np.concatenate([states, _of_two_posts(sight, shape, prior, *angles[0, 1:])])
    states[:, 2] = wrap(states[:, 2])
    return states


def _ground(sight: Sight, shape: Shape, uprights: FloatArray) -> Ground:
    turned, height = rotations(uprights), uprights[:, 3, None]
    transposed = np.swapaxes(turned, 1, 2)
    normals = cross(sight.line_rays[:, 0], sight.line_rays[:, 1]) @ transposed
    level = np.maximum(np.hypot(normals[..., 0], normals[..., 1]), 1e-12)
    down = sight.line_rays.reshape(-1, 3) @ turned[:, 2, :, None]
    below = (down.reshape(len(uprights), -1, 2) < -0.01).all(axis=2)
    across = np.abs(normals[..., :2]) / level[..., None]
    families = np.where(across[..., 0] < _ASKEW, 0, np.where(across[..., 1] < _ASKEW, 1, -1))
    families = np.where(below, families, -1).astype(np.intp)
    other = np.where(families == 0, normals[..., 1], normals[..., 0])
    offsets = height * normals[..., 2] / np.where(np.abs(other) < 1e-9, 1e-9, other)
    largest = np.argsort(-sight.post_widths, kind="stable")[:_MOST_POSTS]
    middles = sight.post_rays[largest].sum(axis=1) @ transposed
    bearing = middles[..., :2] / np.maximum(np.hypot(middles[..., 0], middles[..., 1]), 1e-9)[..., None]
    feet = sight.feet.rays[largest] @ transposed
    standing = sight.feet.known[largest] & (feet[..., 2] < -0.03)
    radius = float(np.mean(shape.radii)) if len(shape.radii) else 0.0
    reach = height * np.hypot(feet[..., 0], feet[..., 1]) / np.where(standing, -feet[..., 2], 1.0) + radius
    far = np.where(standing, reach, post_ranges(sight, shape)[largest])
    circles = [circle_on_ground(sight, one) for one in turned]
    circle = np.array([[np.nan] * 3 if one is None else one for one in circles])
    rays, across = (
        (part.reshape(-1, 3) @ transposed).reshape(len(uprights), -1, 2, 3)
        for part in (sight.line_rays, sight.line_across)
    )
    # the plane through a camera so high and a line on the ground
    planes = height[..., None] * normals / level[..., None]
    px_per_m = np.abs(rays[..., 2] / not_zero((across * planes[:, :, None]).sum(axis=-1)))
    fit = widths_fit(sight, px_per_m, shape.line_width_m, _WIDEN_PX)
    weights = np.minimum(sight.line_lengths / 60.0, 1.0) * np.exp(np.minimum(fit, 0.0))
    return Ground(families, offsets, weights, bearing * far[..., None], height * circle)


@dataclass(frozen=True, slots=True, eq=False)
class _Votes:
    """values: (g, n) for coordinates low + step i; peaks: (g, c) the best of these, NaN beyond the last."""

    low: float
    values: FloatArray
    peaks: FloatArray

    @staticmethod
    def of(seen: FloatArray, weights: FloatArray, shape: Shape, axis: int) -> "_Votes":
        """Of distances to lines (g, l), of which (g, l) count so much, as any of the map's lines across the axis."""
        low, table, count = _distances(shape, axis)
        told = np.flatnonzero(weights.any(axis=0))
        if not len(table) or not len(told):
            return _Votes(low, np.zeros((len(seen), count)), np.full((len(seen), 0), np.nan))
        seen, weights = seen[:, told], weights[:, told]
        first = np.rint(seen / _STEP_M).astype(np.intp)
        rows = first[..., None] + np.arange(count)
        away = table[np.minimum(np.maximum(rows, 0), len(table) - 1)]
        off = away / (_OFF_M + _OFF * np.abs(seen))[..., None]
        values = (weights[:, None] @ np.exp(-0.5 * off * off))[:, 0]
        top = np.zeros_like(values)
        higher = (values[:, 1:-1] >= values[:, :-2]) & (values[:, 1:-1] > values[:, 2:])
        top[:, 1:-1] = np.where(higher, values[:, 1:-1], 0.0)
        best = np.argsort(-top, axis=1, kind="stable")[:, :_MOST_COORDINATES]
        peaks = np.where(top[np.arange(len(top))[:, None], best] > 0.1, low + _STEP_M * best, np.nan)
        return _Votes(low, values, peaks)

    def at(self, rows: NDArray[np.intp], coordinates: FloatArray) -> FloatArray:
        """(n,) of cameras and coordinates (n,)."""
        columns = np.rint((coordinates - self.low) / _STEP_M)
        columns = np.minimum(np.maximum(columns, 0.0), self.values.shape[1] - 1.0).astype(np.intp)
        return np.asarray(self.values[rows, columns])


@lru_cache(maxsize=32)
def _distances(shape: Shape, axis: int) -> tuple[float, FloatArray, int]:
    """From where on, how far coordinates on and about the field are from the nearest line across the axis (n,), empty
    where there is none, and of how many coordinates."""
    corners = shape.box[[[0, 1], [0, 3], [2, 1], [2, 3]]] @ rotation(shape.grid_rad)
    low, high = corners[:, axis].min() - _AROUND_M, corners[:, axis].max() + _AROUND_M
    marks = shape.offsets[shape.families == 1 - axis]
    coordinates = np.arange(low, high + _STEP_M, _STEP_M)
    table = np.abs(coordinates[:, None] - marks).min(axis=1) if len(marks) else np.zeros(0)
    return float(low), table, int((high - low) / _STEP_M) + 1


def _places(ground: Ground, shape: Shape, turn: int) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Places (n, 2) in the field of cameras whose axes are turned by so many quarter turns against the grid, what each
    is worth (n,) and of which camera it is (n,)."""
    quarter, grid = rotation(0.5 * np.pi * turn), rotation(shape.grid_rad)
    votes = []
    for axis in (0, 1):  # the coordinate that is looked for; lines along the other axis tell it
        family = (1 - axis + turn) % 2
        # a line at offset d along the other of its own axes is turned to +-d of this one
        sign = quarter[axis, 1 - family]
        weights = ground.weights * (ground.families == family)
        votes.append(_Votes.of(sign * ground.offsets, weights, shape, axis))
    count = len(ground.offsets)
    xs, ys = votes[0].peaks, votes[1].peaks
    found: list[tuple[FloatArray, float]] = []
    both = np.empty((count, xs.shape[1], ys.shape[1], 2))
    both[..., 0], both[..., 1] = xs[:, :, None], ys[:, None, :]
    found.append((both, 0.0))
    marks = shape.posts @ grid  # in grid axes
    if ground.posts.shape[1] and len(marks):
        posts = ground.posts @ quarter.T
        found.append((marks[:, None] - posts[:, None], _POST))
        towards = posts / np.maximum(np.hypot(posts[..., 0], posts[..., 1]), 1e-9)[..., None]
        for axis, values in ((0, xs), (1, ys)):
            steep = np.where(np.abs(towards[..., axis]) > 0.15, towards[..., axis], np.nan)[:, :, None, None]
            reach = (marks[:, None, axis] - values[:, None, None, :]) / steep  # (g, p, q, c)
            reach = np.where((reach > _NEAREST_M) & (reach < _FARTHEST_M), reach, np.nan)
            across = marks[:, None, 1 - axis] - reach * towards[:, :, 1 - axis, None, None]
            both = np.empty((*across.shape, 2))
            both[..., axis], both[..., 1 - axis] = values[:, None, None, :], across
            found.append((both, _BEARING))
    circles = shape.circles[:, :2] @ grid - (ground.circle[:, :2] @ quarter.T)[:, None]  # (g, c, 2)
    found.append((circles, 0.0))
    all_places = np.concatenate([both.reshape(count, -1, 2) for both, _ in found], axis=1)
    bonuses = np.concatenate([np.full(both.size // (2 * count), bonus) for both, bonus in found])
    rows, columns = np.nonzero(np.isfinite(all_places).all(axis=2))
    places = all_places[rows, columns]
    worth = bonuses[columns] + votes[0].at(rows, places[:, 0]) + votes[1].at(rows, places[:, 1])
    if np.isfinite(circles).any():
        off = (places[:, None] - circles[rows]) / _CIRCLE_M
        large = (ground.circle[:, 2:] / shape.circles[:, 2] - 1.0) / _CIRCLE_LARGE
        fits = np.exp(-0.5 * (off[..., 0] ** 2 + off[..., 1] ** 2 + (large * large)[rows]))
        worth = worth + _CIRCLE * np.nan_to_num(fits).max(axis=1)
    return places @ grid.T, worth, rows


def _of_two_posts(sight: Sight, shape: Shape, prior: CameraPrior, pitch: float, roll: float) -> FloatArray:
    """Of any two posts as any two of the map's; none of the heading's quarter turns enters."""
    turned = rotations(np.array([[0.0, 0.0, 0.0, 1.0, pitch, roll]]))[0]
    largest = np.argsort(-sight.post_widths, kind="stable")[:_MOST_POSTS]
    middles = sight.post_rays[largest].sum(axis=1) @ turned.T
    bearings = np.arctan2(middles[:, 1], middles[:, 0])
    sizes = 1.0 / post_ranges(sight, shape)[largest]
    seen = np.array([(i, j) for i in range(len(bearings)) for j in range(i)])
    marks = np.array([(i, j) for i in range(len(shape.posts)) for j in range(len(shape.posts)) if i != j])
    if not len(marks):
        return np.zeros((0, 6))
    found = poses_from_two_posts(bearings[seen][:, None], sizes[seen][:, None], shape.posts[marks][None])
    poses = found.pose[found.solvable]
    inside = (poses[:, :2] > shape.box[:2] - _AROUND_M) & (poses[:, :2] < shape.box[2:] + _AROUND_M)
    poses = poses[inside.all(axis=1)]
    states = np.empty((len(poses), 6))
    states[:, :3] = poses
    states[:, 3:] = prior.mean[0], pitch, roll
    return states
