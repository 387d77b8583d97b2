"""All that the lines of one image say about the pose: solutions with weights that compare with each other.

The step the paper leaves open after eqs. 13-15: which of the map's lines were seen. Lines of both directions give
poses; lines of a single direction give a heading and one coordinate, and the robot is free to move along them.

What is seen of n lines is (bearing, n distances), of dimension rad m^n, and the direction of each. Given a pose, each
line is, independently of the others,
    with probability clutter none of the map's: either direction alike, its distance anywhere within 20 m;
    else one of the map's, each of them alike: so a map of more lines explains more by chance, and pays for it.
The errors of all are jointly normal, as they share the mount's. A seen end that stands out over the map line's end
makes the solution rarer as a normal density does.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_estimate import LineProblem, Solved, log_ends_fit, rows_of, solve
from fieldloc.fixes.line_map import line_grid, turned_grid
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray, rotation, rotation3, wrap
from fieldloc.stacks import LineStack

MOST = 64
_LOG_CLUTTER = -math.log(2.0 * 20.0)  # of a line's direction and distance
_LOG_BEARING = -math.log(0.5 * math.pi)  # modulo a quarter turn
_LOG_NEGLIGIBLE = math.log(1e-3)  # against what the image is when nothing in it is right

_IntArray = NDArray[np.intp]
_Number = TypeVar("_Number", np.float64, np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class LineSolutions:
    """Whole poses, the likeliest first.

    poses: (k, 3) field_from_robot. covariances: (k, 3, 3) in the robot frame of each, which are pixel_covariances, from
    the noise of the pixels and the map alone, + by_mount C by_mount' with the C of the mount. by_mount: (k, 3, 4) what
    another mount (height, pan, tilt, roll) would change in the pose, as that tangent.
    log_weights: (k,) logarithm of the integral over all poses (m^2 rad) of p(lines, solution | pose).
    matches: (k, n) row of the LineGrid per line, -1 for none of the map's.
    """

    poses: FloatArray
    covariances: FloatArray
    pixel_covariances: FloatArray
    by_mount: FloatArray
    log_weights: FloatArray
    matches: _IntArray


@dataclass(frozen=True, slots=True, eq=False)
class LineConstraints:
    """Heading and distance along one normal, the likeliest first; the rest as in LineSolutions.

    stack: its covariances are of (heading_rad, offset_m) in full. pixel_covariances: (k, 2, 2), by_mount (k, 2, 4).
    log_weights: (k,) logarithm of the integral over heading and offset alone of p(lines, solution | pose).
    """

    stack: LineStack
    pixel_covariances: FloatArray
    by_mount: FloatArray
    log_weights: FloatArray
    matches: _IntArray


def line_solutions(
    lines: GroundLines,
    field: FieldMap,
    detection: Detection,
    max_unexplained: int | None = None,
    *,
    sigma_map_m: float = 0.0,
    most: int = MOST,
) -> LineSolutions:
    """Poses from lines of both directions; none where one direction was not seen.

    Complete up to so many lines that are none of the map's (`unexplained_of` many if not given), among poses on the map
    and a metre around it; of more than `most` the likeliest. A line that fits within two sigmas of the surest of its
    direction is not left unexplained. sigma_map_m: how well the map knows where its lines are.
    """
    problem = line_problem(lines, field, max_unexplained, sigma_map_m)
    found = solve(problem, problem.matcher.pairs(), (0, 1, 2))
    log_ends = log_ends_fit(problem, found)
    best, log_weights = _likeliest(problem, found, log_ends, detection, field, most)
    grid, heading_rad = problem.grid, line_grid(field).heading_rad
    turned = np.asarray(0.5 * np.pi * found.turns[best] + heading_rad, dtype=np.float64)
    poses = found.states[best]
    poses[:, :2] = (rotation(turned) @ poses[:, :2, None])[..., 0]
    poses[:, 2] = wrap(poses[:, 2] + turned)
    # in the turned grid the robot's heading is minus the bearing, up to the noise of that
    to_robot = rotation3(lines.bearing_rad)
    full = to_robot @ found.covariances[best] @ to_robot.T
    pixel = to_robot @ found.pixel_covariances[best] @ to_robot.T
    by_mount = to_robot @ found.by_mount[best]
    matches = rows_of(problem, found)[best]
    if grid.twins is None:
        return LineSolutions(poses, full, pixel, by_mount, log_weights, matches)
    there = poses.copy()
    there[:, :2] = 2.0 * rotation(heading_rad) @ grid.centre_m - poses[:, :2]
    there[:, 2] = wrap(poses[:, 2] + np.pi)
    return LineSolutions(
        _in_turn(poses, there),
        _twice(full),
        _twice(pixel),
        _twice(by_mount),
        _twice(log_weights),
        _in_turn(matches, np.append(grid.twins, -1)[matches]),
    )


def line_constraints(
    lines: GroundLines,
    field: FieldMap,
    detection: Detection,
    max_unexplained: int | None = None,
    *,
    sigma_map_m: float = 0.0,
    most: int = MOST,
) -> LineConstraints:
    """What lines of one direction say, all of the other direction's left unexplained; bounds as in `line_solutions`."""
    problem = line_problem(lines, field, max_unexplained, sigma_map_m)
    first, second = (_constraints(problem, family, detection, field, most) for family in (0, 1))
    if not len(first.log_weights) or not len(second.log_weights):
        return first if len(first.log_weights) else second
    s, t = first.stack, second.stack
    stack = LineStack(
        np.concatenate([s.heading_rad, t.heading_rad]),
        np.concatenate([s.normal_rad, t.normal_rad]),
        np.concatenate([s.offset_m, t.offset_m]),
        np.concatenate([s.along_m, t.along_m]),
        np.concatenate([s.covariances, t.covariances]),
    )
    log_weights = np.concatenate([first.log_weights, second.log_weights])
    best = np.argsort(-log_weights, kind="stable")[:most]
    return LineConstraints(
        stack.take(best),
        np.concatenate([first.pixel_covariances, second.pixel_covariances])[best],
        np.concatenate([first.by_mount, second.by_mount])[best],
        log_weights[best],
        np.concatenate([first.matches, second.matches])[best],
    )


def log_clutter(lines: GroundLines) -> float:
    """Log density of all lines if none is the map's."""
    return _LOG_BEARING + _LOG_CLUTTER * len(lines.families)


def unexplained_of(count: int) -> int:
    """How many of so many lines may be none of the map's: one of two, two of five or more, never all."""
    return min(count - 1, 1 if count < 5 else 2)


def line_problem(lines: GroundLines, field: FieldMap, max_unexplained: int | None, sigma_map_m: float) -> LineProblem:
    spare = unexplained_of(len(lines.families)) if max_unexplained is None else max_unexplained
    return LineProblem.of(lines, turned_grid(field), field.line_width_m, sigma_map_m, spare)


def _constraints(
    problem: LineProblem, family: int, detection: Detection, field: FieldMap, most: int
) -> LineConstraints:
    """From lines of one family."""
    grid, grid_heading_rad = problem.grid, line_grid(field).heading_rad
    across = 1 - family  # family 0 says something about y, family 1 about x
    found = solve(problem, problem.matcher.alone(family), (across, 2))
    low, high = problem.matcher.room(found.turns, found.columns)
    best, log_weights = _likeliest(problem, found, np.where(low < high, 0.0, -np.inf), detection, field, most)
    offset_m, heading = found.states[best].T
    low, high = low[best], high[best]
    turned = np.asarray(0.5 * np.pi * found.turns[best] + grid_heading_rad, dtype=np.float64)
    heading_rad, normal_rad = wrap(heading + turned), wrap(turned + 0.5 * np.pi * across)
    along_m = np.stack([-high, -low] if across else [low, high], axis=-1)
    flip = [1, 0]  # (heading, offset), as the stack's errors are
    full, pixel = (a[best][:, flip][:, :, flip] for a in (found.covariances, found.pixel_covariances))
    by_mount, matches = found.by_mount[best][:, flip], rows_of(problem, found)[best]
    if grid.twins is None:
        stack = LineStack(heading_rad, normal_rad, offset_m, along_m, full)
        return LineConstraints(stack, pixel, by_mount, log_weights, matches)
    # the half turn about the centre c takes (heading, normal, offset) to (heading + pi, normal + pi, offset - 2 n . c)
    centre = rotation(grid_heading_rad) @ grid.centre_m
    c, s = np.cos(normal_rad), np.sin(normal_rad)
    twin_offset_m = offset_m - 2.0 * (c * centre[0] + s * centre[1])
    twin_along_m = along_m - 2.0 * (c * centre[1] - s * centre[0])[:, None]
    stack = LineStack(
        _in_turn(heading_rad, wrap(heading_rad + np.pi)),
        _in_turn(normal_rad, wrap(normal_rad + np.pi)),
        _in_turn(offset_m, twin_offset_m),
        _in_turn(along_m, twin_along_m),
        _twice(full),
    )
    twins = np.append(grid.twins, -1)[matches]
    return LineConstraints(stack, _twice(pixel), _twice(by_mount), _twice(log_weights), _in_turn(matches, twins))


def _likeliest(
    problem: LineProblem, found: Solved, log_ends: FloatArray, detection: Detection, field: FieldMap, most: int
) -> tuple[_IntArray, FloatArray]:
    """The solutions to keep, best first, and their log weights.

    One that is nowhere more than a thousandth of what the image is when nothing in it is right changes nothing.
    """
    explained = np.sum(found.columns >= 0, axis=1)
    unexplained = found.columns.shape[1] - explained
    log_one = np.log1p(-detection.clutter) - np.log(max(len(line_grid(field).axes), 1))
    log_prior = explained * log_one + unexplained * (np.log(detection.clutter) + _LOG_CLUTTER) + log_ends
    log_peaks, log_weights = found.log_peaks + log_prior, found.log_weights + log_prior
    least = log_clutter(problem.lines) + np.log(detection.nothing_right) + _LOG_NEGLIGIBLE
    best = np.argsort(-log_weights, kind="stable")
    best = best[log_peaks[best] >= least][: most if problem.grid.twins is None else most // 2]
    return best, log_weights[best]


def _twice(rows: FloatArray) -> FloatArray:
    return np.repeat(rows, 2, axis=0)


def _in_turn(rows: NDArray[_Number], twins: NDArray[_Number]) -> NDArray[_Number]:
    """(2k, ...): each row, and its twin behind it."""
    return np.stack([rows, twins], axis=1).reshape(2 * len(rows), *rows.shape[1:])
