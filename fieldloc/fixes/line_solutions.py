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
from fieldloc.fixes.line_estimate import Solved, log_ends_fit, solve, with_map_noise
from fieldloc.fixes.line_map import turned_grid
from fieldloc.fixes.line_matching import LineMatcher
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray, wrap
from fieldloc.stacks import LineStack

MOST = 64
_LOG_CLUTTER = -math.log(2.0 * 20.0)  # of a line's direction and distance
_LOG_BEARING = -math.log(0.5 * math.pi)  # modulo a quarter turn
_LOG_NEGLIGIBLE = math.log(1e-5)  # against what the image is when nothing in it is right

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
    and a metre around it, within four sigmas; of more than `most` the likeliest. Only what is sure to fit is not tried
    as none of the map's: a line within two sigmas of where another one puts it, its ends well on the map's line; what
    that leaves out weighs less than one in a hundred. sigma_map_m: how well the map knows where its lines are.
    """
    return _Reader(lines, field, detection, max_unexplained, sigma_map_m, most).solutions()


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
    return _Reader(lines, field, detection, max_unexplained, sigma_map_m, most).constraints()


def line_readings(
    lines: GroundLines, field: FieldMap, detection: Detection, max_unexplained: int | None = None
) -> tuple[LineSolutions, LineConstraints]:
    """Both of the above, for little more than one of them."""
    reader = _Reader(lines, field, detection, max_unexplained, 0.0, MOST)
    return reader.solutions(), reader.constraints()


def log_clutter(lines: GroundLines) -> float:
    """Log density of all lines if none is the map's."""
    return _LOG_BEARING + _LOG_CLUTTER * len(lines.families)


def unexplained_of(count: int) -> int:
    """How many of so many lines may be none of the map's: one, two of seven or more, never all."""
    return min(count - 1, 1 if count < 7 else 2)


class _Reader:
    """One image's lines against a map."""

    def __init__(
        self,
        lines: GroundLines,
        field: FieldMap,
        detection: Detection,
        max_unexplained: int | None,
        sigma_map_m: float,
        most: int,
    ) -> None:
        count = len(lines.families)
        self._lines, self._grid, self._sigma_map_m = lines, turned_grid(field), sigma_map_m
        self._tolerance_m, self._most = field.line_width_m, most
        spare = unexplained_of(count) if max_unexplained is None else max_unexplained
        in_family = np.bincount(lines.families, minlength=2)
        # of which direction lines must be explained, and whether those of the other may all be left
        self._alone = [family for family in (0, 1) if in_family[family] and in_family[1 - family] <= spare]
        self._both = bool(in_family.all())
        covariance = with_map_noise(lines.covariance, sigma_map_m)
        self._matcher = LineMatcher(lines, covariance, self._grid, self._tolerance_m, spare)
        clutter = math.log(detection.clutter)
        log_explained = math.log1p(-detection.clutter) - math.log(max(self._grid.count, 1))
        self._log_prior = count * log_explained
        self._log_unexplained = clutter + _LOG_CLUTTER - log_explained
        self._log_least = log_clutter(lines) + math.log(detection.nothing_right) + _LOG_NEGLIGIBLE

    def solutions(self) -> LineSolutions:
        lines, grid = self._lines, self._grid
        if not self._both:
            none, matches = np.zeros((0, 3, 3)), np.zeros((0, len(lines.families)), dtype=np.intp)
            return LineSolutions(np.zeros((0, 3)), none, none, np.zeros((0, 3, 4)), np.zeros(0), matches)
        found = solve(lines, grid, self._sigma_map_m, self._matcher.pairs(), (0, 1, 2))
        log_ends = log_ends_fit(lines, grid, self._tolerance_m, found)
        best, log_weights, matches = self._likeliest(found, log_ends)
        turns = found.turns[best]
        c, s = grid.cosines[turns], grid.sines[turns]
        x, y, heading = found.states[best].T
        poses = np.empty((len(best), 3))
        poses[:, 0], poses[:, 1] = c * x - s * y, s * x + c * y
        poses[:, 2] = heading + 0.5 * np.pi * turns + grid.heading_rad
        # in the turned grid the robot's heading is minus the bearing, up to the noise of that
        cb, sb = math.cos(lines.bearing_rad), math.sin(lines.bearing_rad)
        to_robot = np.array([[cb, -sb, 0.0], [sb, cb, 0.0], [0.0, 0.0, 1.0]])
        full = to_robot @ found.covariances @ to_robot.T
        pixel = to_robot @ found.pixel_covariances @ to_robot.T
        by_mount = to_robot @ found.by_mount
        pattern = found.pattern[best]
        if grid.twins is not None:
            twins = -poses
            twins[:, :2] += 2.0 * grid.centre_in_field_m
            twins[:, 2] = poses[:, 2] + np.pi
            poses, pattern = _in_turn(poses, twins), np.repeat(pattern, 2)
        poses[:, 2] = wrap(poses[:, 2])
        return LineSolutions(poses, full[pattern], pixel[pattern], by_mount[pattern], log_weights, matches)

    def constraints(self) -> LineConstraints:
        count = len(self._lines.families)
        parts = [self._constraints(family) for family in self._alone]
        if len(parts) == 1:
            return parts[0]
        if not parts:
            none, covariance, by_mount = np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2, 4))
            stack = LineStack(none, none, none, np.zeros((0, 2)), covariance)
            return LineConstraints(stack, covariance, by_mount, none, np.zeros((0, count), dtype=np.intp))
        s, t = (part.stack for part in parts)
        stack = LineStack(
            np.concatenate([s.heading_rad, t.heading_rad]),
            np.concatenate([s.normal_rad, t.normal_rad]),
            np.concatenate([s.offset_m, t.offset_m]),
            np.concatenate([s.along_m, t.along_m]),
            np.concatenate([s.covariances, t.covariances]),
        )
        log_weights = np.concatenate([part.log_weights for part in parts])
        best = np.argsort(-log_weights, kind="stable")[: self._most]
        return LineConstraints(
            stack.take(best),
            np.concatenate([part.pixel_covariances for part in parts])[best],
            np.concatenate([part.by_mount for part in parts])[best],
            log_weights[best],
            np.concatenate([part.matches for part in parts])[best],
        )

    def _constraints(self, family: int) -> LineConstraints:
        """From lines of one family, of which 0 says something about y, 1 about x."""
        lines, grid, across = self._lines, self._grid, 1 - family
        found = solve(lines, grid, self._sigma_map_m, self._matcher.alone(family), (across, 2))
        low, high = self._matcher.room(found.turns, found.columns)
        best, log_weights, matches = self._likeliest(found, np.where(low < high, 0.0, -np.inf))
        offset_m, heading_rad = found.states[best].T
        turned: FloatArray = 0.5 * np.pi * found.turns[best].astype(np.float64) + grid.heading_rad
        heading_rad = heading_rad + turned
        normal_rad = turned + 0.5 * np.pi * across
        low, high = low[best], high[best]
        along_m = np.stack([-high, -low] if across else [low, high], axis=-1)
        pattern = found.pattern[best]
        if grid.twins is not None:
            # the half turn about c takes (heading, normal n, offset) to (heading + pi, -n, offset - 2 n . c)
            c, s = np.cos(normal_rad), np.sin(normal_rad)
            x, y = grid.centre_in_field_m
            heading_rad = _in_turn(heading_rad, heading_rad + np.pi)
            normal_rad = _in_turn(normal_rad, normal_rad + np.pi)
            offset_m = _in_turn(offset_m, offset_m - 2.0 * (c * x + s * y))
            along_m = _in_turn(along_m, along_m - 2.0 * (c * y - s * x)[:, None])
            pattern = np.repeat(pattern, 2)
        # (heading, offset), as the stack's errors are
        full, pixel = (a[:, ::-1, ::-1][pattern] for a in (found.covariances, found.pixel_covariances))
        stack = LineStack(wrap(heading_rad), wrap(normal_rad), offset_m, along_m, full)
        return LineConstraints(stack, pixel, found.by_mount[:, ::-1][pattern], log_weights, matches)

    def _likeliest(self, found: Solved, log_ends: FloatArray) -> tuple[_IntArray, FloatArray, _IntArray]:
        """Which to keep, best first; log weights and matches of those, with their twins behind them.

        One that is nowhere near what the image is when nothing in it is right changes nothing.
        """
        grid = self._grid
        explained = found.columns >= 0
        unexplained = explained.shape[1] - explained.sum(axis=1)
        log_prior = self._log_prior + self._log_unexplained * unexplained + log_ends
        kept = np.flatnonzero(found.log_peaks + log_prior >= self._log_least)
        log_weights = (found.log_weights + log_prior)[kept]
        order = np.argsort(-log_weights, kind="stable")[: self._most if grid.twins is None else self._most // 2]
        best, log_weights = kept[order], log_weights[order]
        rows = grid.rows[found.turns[best][:, None], self._lines.families, found.columns[best]]
        matches = np.where(explained[best], rows, -1)
        if grid.twins is None:
            return best, log_weights, matches
        return best, np.repeat(log_weights, 2), _in_turn(matches, grid.twins[matches])


def _in_turn(rows: NDArray[_Number], twins: NDArray[_Number]) -> NDArray[_Number]:
    """(2k, ...): each row, and its twin behind it."""
    out = np.empty((2 * len(rows), *rows.shape[1:]), dtype=rows.dtype)
    out[::2], out[1::2] = rows, twins
    return out
