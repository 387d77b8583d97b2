"""Where the camera may be: closed-form places from pairs of things seen, given how it is turned and how high it is.

In axes along the grid, centred below the camera, a seen line is one coordinate; so the camera's x follows from any line
that runs along y and any such line of the map, its y likewise, and each is voted for by all lines of that direction
(paper, eqs. 14-15). The circle's middle and a post are whole places, a post's bearing and a line one too. Two posts
need no line: paper, eqs. 3-12.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.fixes.two_posts import poses_from_two_posts
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.locate.states import cross, rotations
from fieldloc.pose import FloatArray, rotation, wrap

_MOST_COORDINATES = 7
_APART_M = 0.15
_OFF, _OFF_M = 0.08, 0.1  # how far off a distance on the ground may be while height and attitude are rough
_AROUND_M = 0.5
_ASKEW = np.sin(np.radians(12.0))
_SCALES = (1.0, 0.8, 1.25)  # of a height that only widths tell


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What is seen, on the ground below the camera, in axes turned against the grid by a quarter turn or none.

    families: (l,) 0 along x, 1 along y, -1 of neither. offsets: (l,) the other coordinate, metres. posts: (p, 2)
    places, which may be far off along their direction. circle: (2,) or None.
    """

    families: NDArray[np.intp]
    offsets: FloatArray
    weights: FloatArray
    posts: FloatArray
    circle: FloatArray | None


def candidates(sight: Sight, shape: Shape, prior: CameraPrior, angles: FloatArray) -> FloatArray:
    """States (k, 6) from attitudes (a, 3); of a map with a half turn one of each two."""
    found = []
    for heading, pitch, roll in angles:
        for height in _heights(sight, shape, prior, np.array([heading, pitch, roll])):
            upright = np.array([0.0, 0.0, heading, height, pitch, roll])
            ground = _ground(sight, shape, upright)
            for turn in range(2 if len(shape.symmetries) else 4):
                places = _places(ground, shape, turn)
                states = np.tile(upright, (len(places), 1))
                states[:, :2] = places
                states[:, 2] = heading + 0.5 * np.pi * turn + shape.grid_rad
                found.append(states)
    if len(sight.post_rays) > 1:
        heading, pitch, roll = angles[0]
        found.append(_of_two_posts(sight, shape, prior, pitch, roll))
    states = np.concatenate(found) if found else np.zeros((0, 6))
    states[:, 2] = wrap(states[:, 2])
    inside = (states[:, :2] > shape.box[:2] - _AROUND_M) & (states[:, :2] < shape.box[2:] + _AROUND_M)
    return np.asarray(states[inside.all(axis=1)])


def _heights(sight: Sight, shape: Shape, prior: CameraPrior, angles: FloatArray) -> list[float]:
    """Heights at which sizes seen are those of the map; the prior's own where that is sharp."""
    known = [float(prior.mean[0])] if prior.knows_height else []
    turned = rotations(np.array([[0.0, 0.0, angles[0], 1.0, angles[1], angles[2]]]))[0]
    circle = _circle(sight, turned)
    if circle is not None and len(shape.circles):
        known.append(float(shape.circles[0, 2]) / circle[2])
    elif not known:
        rough = _rough_height(sight, shape, turned)
        known = [rough * scale for scale in _SCALES] if rough else [0.3, 0.5, 0.8, 1.3]
    low, high = prior.mean[0] - 4.0 * prior.sigmas[0], prior.mean[0] + 4.0 * prior.sigmas[0]
    out: list[float] = []
    for height in known:
        if max(low, 0.1) <= height <= high and all(abs(height - other) > 0.03 * height for other in out):
            out.append(height)
    return out


def _rough_height(sight: Sight, shape: Shape, turned: FloatArray) -> float | None:
    """From lines' widths and posts' widths beside their feet."""
    heights = []
    rays, across = sight.line_rays @ turned.T, sight.line_across @ turned.T
    for line in range(len(rays)):
        for end in (0, 1):
            width, down = sight.widths[line, end], -rays[line, end, 2]
            if not np.isfinite(width) or down < 0.05 or width < 2.5:
                continue
            # a pixel across is so much of the ground, in heights: the part of it that is across the line's direction
            direction = cross(cross(rays[line, 0], rays[line, 1]), np.array([0.0, 0.0, 1.0]))[:2]
            length = float(np.hypot(*direction))
            moved = across[line, end, :2] / down + rays[line, end, :2] * across[line, end, 2] / down**2
            step = abs(direction[0] * moved[1] - direction[1] * moved[0]) / max(length, 1e-9)
            heights.append(shape.line_width_m / max(width * step, 1e-9))
    feet = sight.feet.rays @ turned.T
    ranges = _post_ranges(sight, shape)
    for post in np.flatnonzero(sight.feet.known):
        if feet[post, 2] < -0.02 and np.isfinite(ranges[post]):
            heights.append(-feet[post, 2] / float(np.hypot(*feet[post, :2])) * ranges[post])
    return float(np.median(heights)) if heights else None


def _post_ranges(sight: Sight, shape: Shape) -> FloatArray:
    """(p,) level distance from the width: the angle between the edges' planes, both upright."""
    if not len(shape.radii):
        return np.full(len(sight.post_rays), np.nan)
    left = cross(sight.post_rays[:, 0], sight.post_rays[:, 1])
    right = cross(sight.post_rays[:, 2], sight.post_rays[:, 3])
    sine = np.linalg.norm(cross(left, right), axis=-1)
    sine = sine / np.maximum(np.linalg.norm(left, axis=-1) * np.linalg.norm(right, axis=-1), 1e-12)
    # parallel edges, as noise leaves them, are told apart by their middles
    middles = sight.post_rays.reshape(-1, 2, 2, 3).mean(axis=2)
    middles = middles / np.linalg.norm(middles, axis=-1, keepdims=True)
    wide = np.linalg.norm(middles[:, 0] - middles[:, 1], axis=-1)
    width = np.where((sine > 0.5 * wide) & (sine < 2.0 * wide), sine, wide)
    return np.asarray(float(np.mean(shape.radii)) / np.maximum(np.sin(0.5 * width), 1e-6))


def _circle(sight: Sight, turned: FloatArray) -> FloatArray | None:
    """Middle and radius (3,) of the circle on the ground, in heights."""
    rays = sight.circle_rays @ turned.T
    rays = rays[rays[:, 2] < -0.02]
    if len(rays) < 5:
        return None
    x, y = (rays[:, :2] / -rays[:, 2:]).T
    weight = rays[:, 2] ** 2  # far points are blurred along the line of sight
    design = np.column_stack([x, y, np.ones_like(x)]) * weight[:, None]
    solved, _, rank, _ = np.linalg.lstsq(design, (x * x + y * y) * weight, rcond=None)
    radius2 = solved[2] + 0.25 * (solved[0] ** 2 + solved[1] ** 2)
    if rank < 3 or radius2 <= 0.0:
        return None
    return np.array([0.5 * solved[0], 0.5 * solved[1], np.sqrt(radius2)])


def _ground(sight: Sight, shape: Shape, upright: FloatArray) -> Ground:
    turned, height = rotations(upright[None])[0], float(upright[3])
    normals = cross(sight.line_rays[:, 0], sight.line_rays[:, 1]) @ turned.T
    level = np.maximum(np.hypot(normals[:, 0], normals[:, 1]), 1e-12)
    below = ((sight.line_rays @ turned.T)[..., 2] < -0.01).all(axis=1)
    across = normals[:, :2] / level[:, None]
    families = np.where(np.abs(across[:, 0]) < _ASKEW, 0, np.where(np.abs(across[:, 1]) < _ASKEW, 1, -1))
    families = np.where(below, families, -1).astype(np.intp)
    other = np.where(families == 0, normals[:, 1], normals[:, 0])
    offsets = height * normals[:, 2] / np.where(np.abs(other) < 1e-9, 1e-9, other)
    middles = sight.post_rays.sum(axis=1) @ turned.T
    bearing = middles[:, :2] / np.maximum(np.hypot(middles[:, 0], middles[:, 1]), 1e-9)[:, None]
    feet = sight.feet.rays @ turned.T
    standing = sight.feet.known & (feet[:, 2] < -0.03)
    radius = float(np.mean(shape.radii)) if len(shape.radii) else 0.0
    reach = height * np.hypot(feet[:, 0], feet[:, 1]) / np.where(standing, -feet[:, 2], 1.0) + radius
    far = np.where(standing, reach, _post_ranges(sight, shape))
    circle = _circle(sight, turned)
    return Ground(
        families,
        offsets,
        np.minimum(sight.line_lengths / 60.0, 1.0),
        bearing * far[:, None],
        None if circle is None else height * circle[:2],
    )


def _places(ground: Ground, shape: Shape, turn: int) -> FloatArray:
    """(n, 2) in the field, of a camera whose axes are turned by so many quarter turns against the grid."""
    quarter = rotation(0.5 * np.pi * turn)
    grid = rotation(shape.grid_rad)
    lists = []
    for axis in (0, 1):  # the coordinate that is looked for; lines along the other axis tell it
        family = (1 - axis + turn) % 2
        rows = ground.families == family
        # a line at offset d along the other of its own axes is turned to +-d of this one
        sign = quarter[axis, 1 - family]
        marks = shape.offsets[shape.families == 1 - axis]
        lists.append(_coordinates(sign * ground.offsets[rows], ground.weights[rows], marks))
    found = []
    xs, ys = lists
    if len(xs) and len(ys):
        found.append(np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2))
    marks = shape.posts @ grid  # in grid axes
    posts = ground.posts @ quarter.T
    if len(posts) and len(marks):
        posts = posts[np.isfinite(posts).all(axis=1)]
        found.append((marks[None] - posts[:, None]).reshape(-1, 2))
        towards = posts / np.maximum(np.hypot(posts[:, 0], posts[:, 1]), 1e-9)[:, None]
        for axis, values in ((0, xs), (1, ys)):
            steep = np.abs(towards[:, axis]) > 0.15
            if not len(values) or not steep.any():
                continue
            reach = (marks[None, :, None, axis] - values) / towards[steep, axis][:, None, None]
            pq = marks[None, :, None, 1 - axis] - reach * towards[steep, 1 - axis][:, None, None]
            both = np.empty((*pq.shape, 2))
            both[..., axis], both[..., 1 - axis] = values, pq
            found.append(both[(reach > 0.3) & (reach < 15.0)])
    if ground.circle is not None and len(shape.circles):
        found.append(shape.circles[:, :2] @ grid - quarter @ ground.circle)
    places = np.concatenate(found) if found else np.zeros((0, 2))
    return np.asarray(places @ grid.T)


def _coordinates(seen: FloatArray, weights: FloatArray, marks: FloatArray) -> FloatArray:
    """The camera's coordinate from distances to lines (n,) and the lines' own (m,), those with most votes first."""
    if not len(seen) or not len(marks):
        return np.zeros(0)
    values = (marks[None, :] - seen[:, None]).ravel()
    off = values[:, None, None] + seen[None, :, None] - marks[None, None, :]
    nearest = np.abs(off).min(axis=2)
    votes = np.exp(-0.5 * (nearest / (_OFF_M + _OFF * np.abs(seen))) ** 2) @ weights
    kept: list[float] = []
    for row in np.argsort(-votes, kind="stable"):
        if all(abs(values[row] - other) > _APART_M for other in kept):
            kept.append(float(values[row]))
            if len(kept) == _MOST_COORDINATES:
                break
    return np.array(kept)


def _of_two_posts(sight: Sight, shape: Shape, prior: CameraPrior, pitch: float, roll: float) -> FloatArray:
    """Of any two posts as any two of the map's; none of the heading's quarter turns enters."""
    turned = rotations(np.array([[0.0, 0.0, 0.0, 1.0, pitch, roll]]))[0]
    middles = sight.post_rays.sum(axis=1) @ turned.T
    bearings = np.arctan2(middles[:, 1], middles[:, 0])
    sizes = 1.0 / _post_ranges(sight, shape)
    seen = np.array([(i, j) for i in range(len(bearings)) for j in range(i)])
    marks = np.array([(i, j) for i in range(len(shape.posts)) for j in range(len(shape.posts)) if i != j])
    if not len(marks):
        return np.zeros((0, 6))
    found = poses_from_two_posts(bearings[seen][:, None], sizes[seen][:, None], shape.posts[marks][None])
    poses = found.pose[found.solvable]
    states = np.empty((len(poses), 6))
    states[:, :3] = poses
    states[:, 3:] = prior.mean[0], pitch, roll
    return states
