import numpy as np
import pytest
from line_views import ALL, DETECTION, SPL, gaps, ground_lines, one_line
from scipy.stats import multivariate_normal

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_map import line_grid
from fieldloc.fixes.line_solutions import line_constraints, line_solutions, log_clutter
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray


def density(lines: GroundLines, poses: FloatArray, matches: FloatArray, field: FieldMap, clutter: float) -> FloatArray:
    """(...) p(lines, matches | pose) of poses (..., 3) near a quarter turn, ends apart: as the module states it."""
    grid = line_grid(field)
    assert abs(grid.heading_rad) < 1e-12
    quarter = np.rint((poses[..., 2] + lines.bearing_rad) / (np.pi / 2))
    expected = [quarter * np.pi / 2 - poses[..., 2]]
    c, s = np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)
    out = np.ones(poses.shape[:-1])
    kept = [0]
    for i, (row, family) in enumerate(zip(matches, lines.families, strict=True)):
        if row < 0:
            out *= clutter / (2.0 * 20.0)
            continue
        out *= (1.0 - clutter) / len(grid.axes)
        # a point of the map line in the robot's axes turned by the bearing
        middle = grid.extents_m[row].mean()
        point = np.array([grid.offsets_m[row], middle] if grid.axes[row] == 0 else [middle, grid.offsets_m[row]])
        x, y = point[0] - poses[..., 0], point[1] - poses[..., 1]
        expected.append(c * x + s * y if family == 1 else c * y - s * x)
        kept.append(1 + i)
    seen = np.append(lines.bearing_rad, lines.distances_m)[kept]
    noise = lines.covariance[np.ix_(kept, kept)]
    return np.asarray(out * multivariate_normal(seen, noise).pdf(np.stack(expected, axis=-1)))


@pytest.mark.parametrize("clutter", [0.02, 0.3])
def test_the_weights_are_integrals_over_all_poses(clutter: float) -> None:
    """Summed over a grid of poses around each solution."""
    mixing = np.array([[2.0, 0.5, 0.3, 0.2], [0.5, 7.0, 4.0, 1.0], [0.3, 4.0, 8.0, 1.5], [0.2, 1.0, 1.5, 6.0]])
    ends = np.array([[-0.4, 0.4], [-0.4, 0.4], [-0.3, 0.5]])
    distances = np.array([2.25, 1.6, 3.0])  # goal line and area's front, as far apart as that, and another line
    lines = ground_lines([1, 1, 0], distances, ends, 0.01, 1e-3 * mixing)
    detection = Detection(clutter=clutter)
    found = line_solutions(lines, SPL, detection, 1, most=ALL)
    assert {int((row < 0).sum()) for row in found.matches} == {0, 1}
    inside = []
    for row in range(0, len(found.poses), 7):
        sigma = np.sqrt(found.covariances[row].diagonal().max())
        steps = np.linspace(-6.0, 6.0, 49) * sigma
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
        values = density(lines, found.poses[row] + grid, found.matches[row], SPL, clutter)
        inside.append(np.log(values.sum() * (steps[1] - steps[0]) ** 3) - found.log_weights[row])
    np.testing.assert_allclose(np.median(inside), 0.0, atol=1e-6)
    # an end that stands out over the map's makes some rarer, and nothing makes one likelier
    assert np.min(inside) > -1e-6
    alone = line_constraints(lines, SPL, detection, 1, most=ALL)
    for row in range(0, len(alone.log_weights), 7):
        stack = alone.stack.take(np.array([row]))
        heading = stack.heading_rad[0] + np.linspace(-6.0, 6.0, 101) * np.sqrt(stack.covariances[0, 0, 0])
        offset = stack.offset_m[0] + np.linspace(-6.0, 6.0, 101) * np.sqrt(stack.covariances[0, 1, 1])
        poses = np.zeros((101, 101, 3))
        poses[..., 0] = np.cos(stack.normal_rad[0]) * offset[:, None]
        poses[..., 1] = np.sin(stack.normal_rad[0]) * offset[:, None]
        poses[..., 2] = heading
        values = density(lines, poses, alone.matches[row], SPL, clutter)
        total = np.log(values.sum() * (heading[1] - heading[0]) * (offset[1] - offset[0]))
        np.testing.assert_allclose(total, alone.log_weights[row], atol=1e-6)


def test_all_lines_and_their_bearing_are_alike_where_none_is_the_maps() -> None:
    lines = one_line(-1.0, 1.0)
    # a bearing of a quarter turn's range; two directions and 20 m of distance
    assert log_clutter(lines) == pytest.approx(-np.log(np.pi / 2) - np.log(2 * 20.0))
    three = ground_lines([0, 1, 1], np.ones(3), np.tile([0.0, 1.0], (3, 1)), 0.01, np.eye(4))
    assert log_clutter(three) == pytest.approx(-np.log(np.pi / 2) - 3 * np.log(2 * 20.0))


def test_a_line_that_stands_out_over_the_maps_is_rarer_the_farther_it_does() -> None:
    """Seen from the centre: the goal area's front, 2.2 m long, with its far end 0, 1, 2 and 3 sigmas too far."""
    front = SPL.lines[(np.ptp(SPL.lines[:, :, 0], axis=1) == 0.0) & (SPL.lines[:, 0, 0] == 3.9)][0]
    width = np.ptp(front[:, 1])
    weights = []
    for sigmas in (0.0, 1.0, 2.0, 3.0, 5.0):
        high = width / 2 + SPL.line_width_m + sigmas * 0.1
        extents = np.array([[-width / 2, high], [-0.3, 0.3]])
        lines = ground_lines([1, 0], np.array([3.9, 3.0]), extents, 0.1, np.diag([1e-6, 1e-6, 1e-6]))
        found = line_solutions(lines, SPL, DETECTION, 0, most=ALL)
        here = gaps(found.poses, np.zeros(3)) < 1e-6
        weights.append(found.log_weights[here][0] if here.any() else -np.inf)
    np.testing.assert_allclose(np.diff(weights[:4]), [-0.5, -1.5, -2.5], atol=1e-3)
    assert weights[4] == -np.inf


def test_only_the_likeliest_are_kept_and_nobody_beyond_the_field() -> None:
    lines = ground_lines([1, 0], np.array([2.0, 1.5]), np.tile([-0.1, 0.1], (2, 1)), 0.5, 4e-3 * np.eye(3))
    every, some = (line_solutions(lines, SPL, DETECTION, most=most) for most in (ALL, 10))
    assert len(every.poses) > 64
    np.testing.assert_array_equal(some.log_weights, every.log_weights[:10])
    assert len(line_solutions(lines, SPL, DETECTION).poses) == 64
    assert np.abs(every.poses[:, 0]).max() < SPL.bounds[2] + 1.0 + 4 * 0.064
    assert np.abs(every.poses[:, 1]).max() < SPL.bounds[3] + 1.0 + 4 * 0.064
