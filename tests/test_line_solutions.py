import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, load_field
from fieldloc.fixes.line_estimate import log_ends_fit, solve
from fieldloc.fixes.line_map import line_grid, turned_grid
from fieldloc.fixes.line_matching import Matches
from fieldloc.fixes.line_solutions import (
    LineConstraints,
    LineSolutions,
    line_constraints,
    line_readings,
    line_solutions,
    log_clutter,
    unexplained_of,
)
from fieldloc.fixes.lines import GroundLines, lines_on_the_ground
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray, apply, compose, inverse, local, wrap
from fieldloc.view import visible_parts

CAMERA = Camera("pinhole", 640, 480, 450.0, 450.0, 319.5, 239.5, (-0.2, 0.05, 0.001, -0.001))
SPL = load_field("spl")
MOUNT_AT = np.array([0.5, 0.2, 0.35, 0.03])
NOISE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
DETECTION = Detection()
ALL = 100_000  # of the solutions
HALF_TURN = np.array([0.0, 0.0, np.pi])
POSE = np.array([1.3, -0.7, 0.4])  # sees the far touch line, the goal line and the left side of both areas


def mount_at(parameters: FloatArray) -> CameraMount:
    height, pan, tilt, roll = (float(p) for p in parameters)
    return CameraMount(height, pan, tilt, roll, NOISE, x_m=0.05, y_m=0.01)


def image_of(
    field_map: FieldMap,
    pose: FloatArray,
    mount: CameraMount,
    sigma_px: float = 0.5,
    rng: np.random.Generator | None = None,
) -> tuple[LineObservation, ...]:
    """The lines longer than 20 px; their ends with noise if a generator is given."""
    parts, _ = visible_parts(CAMERA, mount, apply(inverse(pose), field_map.lines))
    pixels, _ = project_points(CAMERA, mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))
    pixels = pixels[np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=-1) > 20.0]
    if rng is not None:
        pixels = pixels + rng.normal(0.0, sigma_px, pixels.shape)
    return tuple(LineObservation(ends, sigma_px**2 * np.eye(4)) for ends in pixels)


def seen_from(pose: FloatArray, field_map: FieldMap = SPL) -> GroundLines | None:
    mount = mount_at(MOUNT_AT)
    return lines_on_the_ground(CAMERA, mount, image_of(field_map, pose, mount))


def gaps(poses: FloatArray, pose: FloatArray) -> FloatArray:
    """Largest difference of each pose (n, 3) from one."""
    difference = poses - pose
    difference[:, 2] = wrap(difference[:, 2])
    return np.asarray(np.abs(difference).max(axis=1))


poses_on_the_field = st.tuples(st.floats(-4.3, 4.3), st.floats(-2.8, 2.8), st.floats(-3.1, 3.1)).map(np.array)


def ground_lines(
    families: list[int], distances: FloatArray, extents: FloatArray, sigma_m: float, covariance: FloatArray
) -> GroundLines:
    """Lines (n,) ahead of a robot, along its axes; sigma_m of what is seen of their ends, all noise the pixels'."""
    count = len(families)
    return GroundLines(
        bearing_rad=0.0,
        families=np.array(families),
        distances_m=distances,
        extents_m=extents,
        extents_sigma_m=np.full((count, 2), sigma_m),
        covariance=covariance,
        observed=np.arange(count),
        chi_square=0.0,
        pixel_covariance=covariance,
        by_mount=np.zeros((1 + count, 4)),
    )


def found_at(found: LineSolutions, pose: FloatArray, within: float = 1e-8) -> int:
    """How many of the poses are there."""
    return int((gaps(found.poses, pose) < within).sum())


@settings(deadline=None, max_examples=40)
@given(pose=poses_on_the_field)
def test_an_exact_image_gives_the_pose_and_its_half_turn_with_equal_weight(pose: FloatArray) -> None:
    lines = seen_from(pose)
    assume(lines is not None and len(set(lines.families.tolist())) == 2)
    assert lines is not None
    found = line_solutions(lines, SPL, DETECTION, most=ALL)
    right, twin = gaps(found.poses, pose), gaps(found.poses, compose(HALF_TURN, pose))
    assert right.min() < 1e-8
    assert twin.min() < 1e-8
    assert found.log_weights[right.argmin()] == found.log_weights[twin.argmin()]
    assert (np.diff(found.log_weights) <= 0.0).all()
    quarters = np.rint((found.poses[:, 2] + lines.bearing_rad) / (np.pi / 2)) % 4
    readings = np.column_stack([found.matches, quarters])
    assert len(np.unique(readings, axis=0)) == len(readings)  # nothing is listed twice
    assert (np.linalg.eigvalsh(found.covariances)[:, 0] > 0.0).all()


def test_the_matches_are_the_lines_that_made_the_image_and_their_mirror_images() -> None:
    mount = mount_at(MOUNT_AT)
    parts, index = visible_parts(CAMERA, mount, apply(inverse(POSE), SPL.lines))
    pixels, _ = project_points(CAMERA, mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))
    index = index[np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=-1) > 20.0]
    lines = seen_from(POSE)
    assert lines is not None
    found = line_solutions(lines, SPL, DETECTION)
    grid = line_grid(SPL)
    assert abs(grid.heading_rad) < 1e-12
    for pose, turn in ((POSE, np.zeros(3)), (compose(HALF_TURN, POSE), HALF_TURN)):
        matches = found.matches[gaps(found.poses, pose).argmin()]
        ends = apply(turn, SPL.lines[index[lines.observed]])
        for row, line in zip(matches, ends, strict=True):
            axis = grid.axes[row]
            np.testing.assert_allclose(line[:, axis], grid.offsets_m[row], atol=1e-9)
            np.testing.assert_allclose(np.sort(line[:, 1 - axis]), grid.extents_m[row], atol=1e-9)


def assigned_by_trial(few: GroundLines) -> list[tuple[bool, FloatArray]]:
    """Every assignment of three lines to map lines or none, textbook style: whether complete, and the pose."""
    out = []
    x_most, y_most = SPL.bounds[2] + 1.0, SPL.bounds[3] + 1.0
    for quarter, assigned in itertools.product(range(4), itertools.product([None, *SPL.lines], repeat=3)):
        if sum(line is None for line in assigned) > 1:
            continue
        turn = np.array([0.0, 0.0, quarter * np.pi / 2])
        position = np.full(2, np.nan)
        good = True
        segments = []
        for family, d, extent, line in zip(few.families, few.distances_m, few.extents_m, assigned, strict=True):
            if line is None:
                continue
            segment = apply(turn, np.array([[s, d] if family == 0 else [d, s] for s in extent]))
            axis = 0 if abs(segment[0, 0] - segment[1, 0]) < 1e-9 else 1
            at = line[:, axis] - segment[:, axis]
            good &= np.ptp(line[:, axis]) < 1e-9 and bool(
                np.isnan(position[axis]) or abs(position[axis] - at[0]) < 0.01
            )
            position[axis] = at[0]
            segments.append((segment, line, 1 - axis))
        good &= bool(np.isfinite(position).all()) and abs(position[0]) < x_most and abs(position[1]) < y_most
        for segment, line, along in segments if good else []:
            reach = segment[:, along] + position[along]
            good &= bool(reach.min() > line[:, along].min() - 0.06 and reach.max() < line[:, along].max() + 0.06)
        if good:
            heading = float(wrap(quarter * np.pi / 2 - few.bearing_rad))
            out.append((all(line is not None for line in assigned), np.array([*position, heading])))
    return out


def test_the_search_finds_what_trying_every_assignment_finds() -> None:
    """Three observed lines, all 18^3 assignments in each of four orientations."""
    lines = seen_from(np.array([2.6, 0.9, 0.5]))
    assert lines is not None
    assert len(set(lines.families[:3].tolist())) == 2
    few = dataclasses.replace(
        lines,
        families=lines.families[:3],
        distances_m=lines.distances_m[:3],
        extents_m=lines.extents_m[:3],
        extents_sigma_m=np.full((3, 2), 1e-4),
        covariance=1e-6 * np.eye(4),
        pixel_covariance=1e-6 * np.eye(4),
        by_mount=np.zeros((4, 4)),
        observed=lines.observed[:3],
    )
    expected = assigned_by_trial(few)
    complete = np.array([pose for whole, pose in expected if whole])
    assert len(complete) >= 2
    found = line_solutions(few, SPL, DETECTION, 0, most=ALL)
    assert all(found_at(found, pose, 0.02) for pose in complete)
    assert all(gaps(complete, pose).min() < 0.02 for pose in found.poses)
    # with one line left out: wherever that line fits none of the map's
    partial = [pose for whole, pose in expected if not whole and gaps(complete, pose).min() > 0.02]
    assert len(partial) > 10
    found = line_solutions(few, SPL, DETECTION, 1, most=ALL)
    missing = [pose for pose in partial if not found_at(found, pose, 0.02)]
    assert not missing
    assert all(gaps(np.array([pose for _, pose in expected]), pose).min() < 0.02 for pose in found.poses)


def log_weight_of_all(lines: GroundLines, unexplained: int) -> float:
    """Of every assignment of SPL lines to the lines, in half of the turns, that is good enough to count."""
    grid, families = turned_grid(SPL), lines.families
    turns, columns = [], []
    for turn in range(2):
        options = [[-1, *np.flatnonzero(grid.rows[turn, family] >= 0)] for family in families]
        for choice in itertools.product(*options):
            explained = {family for family, column in zip(families, choice, strict=True) if column >= 0}
            if choice.count(-1) <= unexplained and explained == {0, 1}:
                turns.append(turn)
                columns.append(choice)
    found = solve(lines, grid, 0.0, Matches(np.array(turns), np.array(columns)), (0, 1, 2))
    log_weights = found.log_weights + log_ends_fit(lines, grid, SPL.line_width_m, found)
    left_out = np.sum(found.columns < 0, axis=1)
    log_weights += left_out * np.log(DETECTION.clutter / 40.0)
    log_weights += (len(families) - left_out) * np.log((1.0 - DETECTION.clutter) / len(line_grid(SPL).axes))
    low, high = grid.low_m[found.turns] - 1.0, grid.high_m[found.turns] + 1.0
    inside = ((found.states[:, :2] > low) & (found.states[:, :2] < high)).all(axis=1)
    return float(np.logaddexp.reduce(log_weights[inside], initial=-np.inf))


def test_what_the_search_leaves_out_of_all_assignments_weighs_nothing() -> None:
    """Vague lines, some of them false, against every assignment there is; a mount as unsure as a walking robot's."""
    rng = np.random.default_rng(11)
    unsure = np.diag([0.012, 0.022, 0.027, 0.023]) ** 2
    missing: list[float] = []
    while len(missing) < 25:
        pose = rng.uniform([-4.3, -2.8, -np.pi], [4.3, 2.8, np.pi])
        told = dataclasses.replace(mount_at(MOUNT_AT), covariance=unsure)
        seen = list(image_of(SPL, pose, mount_at(rng.multivariate_normal(MOUNT_AT, unsure)), 1.5, rng))
        if len(missing) % 2:
            middle = rng.uniform([100.0, 250.0], [540.0, 450.0])
            seen[1:] = [LineObservation(middle + rng.uniform(-90.0, 90.0, (2, 2)), 2.25 * np.eye(4)), *seen[2:]]
        lines = lines_on_the_ground(CAMERA, told, tuple(seen[:3]))
        if lines is None or len(set(lines.families.tolist())) < 2:
            continue
        spare = unexplained_of(len(lines.families))
        every = log_weight_of_all(lines, spare)
        found = line_solutions(lines, SPL, DETECTION, most=ALL)
        inside = (np.abs(found.poses[:, :2]) < np.array(SPL.bounds[2:]) + 1.0).all(axis=1)
        # twice as much, with the twins in the other two turns
        together = np.logaddexp.reduce(found.log_weights[inside], initial=-np.inf) - np.log(2.0)
        missing.append(1.0 - float(np.exp(together - every)))
    assert np.min(missing) > -1e-9
    assert np.max(missing) < 0.05
    assert np.mean(missing) < 0.01


def test_the_truth_is_among_the_poses_and_as_near_as_its_covariance_says() -> None:
    rng = np.random.default_rng(4)
    squared = []
    for _ in range(150):
        pose = rng.uniform([-4.3, -2.8, -np.pi], [4.3, 2.8, np.pi])
        observations = image_of(SPL, pose, mount_at(rng.multivariate_normal(MOUNT_AT, NOISE)), 0.7, rng)
        lines = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT), observations)
        if lines is None or len(set(lines.families.tolist())) < 2:
            continue
        found = line_solutions(lines, SPL, DETECTION)
        error = local(found.poses, pose)
        squared.append(np.min(np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.covariances), error)))
    count = len(squared)
    assert count > 100
    # mean of chi-square with 3 degrees of freedom: 3 +- sqrt(6 / count), four of those; max: 1e-6 of them exceed 31
    assert abs(np.mean(squared) - 3.0) < 4.0 * np.sqrt(6.0 / count)
    assert max(squared) < 31.0


def test_the_covariance_is_the_spread_of_the_pixels_and_of_the_mount() -> None:
    rng = np.random.default_rng(6)
    observations = image_of(SPL, POSE, mount_at(MOUNT_AT))
    lines = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT), observations)
    assert lines is not None
    found = line_solutions(lines, SPL, DETECTION)
    row = int(gaps(found.poses, POSE).argmin())
    full, pixel, by_mount = found.covariances[row], found.pixel_covariances[row], found.by_mount[row]
    np.testing.assert_allclose(full, pixel + by_mount @ NOISE @ by_mount.T, atol=1e-12)

    def spread(told: FloatArray) -> FloatArray:
        """Of the pose where the real mount is MOUNT_AT and the robot is told these (k, 4)."""
        errors = []
        for parameters in told:
            noisy = tuple(
                LineObservation(line.ends_px + rng.normal(0.0, 0.5, (2, 2)), line.covariance_px2)
                for line in observations
            )
            lines = lines_on_the_ground(CAMERA, mount_at(parameters), noisy)
            if lines is not None and len(lines.families) == len(observations):
                poses = line_solutions(lines, SPL, DETECTION).poses
                errors.append(local(POSE, poses[gaps(poses, POSE).argmin()]))
        assert len(errors) > 0.9 * len(told)
        return np.cov(np.array(errors).T)

    # a variance sampled 300 times is off by 8 %: four of those
    by_pixels = spread(np.repeat(MOUNT_AT[None], 300, axis=0))
    np.testing.assert_allclose(by_pixels.diagonal() / pixel.diagonal(), 1.0, atol=0.33)
    by_all = spread(rng.multivariate_normal(MOUNT_AT, NOISE, 300))
    np.testing.assert_allclose(by_all.diagonal() / full.diagonal(), 1.0, atol=0.33)
    assert full[2, 2] > 3.0 * pixel[2, 2]  # else the test says nothing


def right_ones(found: LineConstraints, pose: FloatArray) -> FloatArray:
    """(k,) whether each holds at the pose."""
    at, turned = found.stack, found.stack.normal_rad + 0.5 * np.pi
    along = np.cos(turned) * pose[0] + np.sin(turned) * pose[1]
    holds = np.abs(at.errors(pose)).max(axis=-1) < 1e-8
    return np.asarray(holds & (at.along_m[:, 0] <= along) & (along <= at.along_m[:, 1]))


def test_lines_of_one_direction_give_a_heading_and_one_coordinate_but_no_pose() -> None:
    pose = np.array([2.0, 1.8, 1.5])  # near a touch line, looking at it
    lines = seen_from(pose)
    assert lines is not None
    assert set(lines.families.tolist()) == {1}
    assert len(line_solutions(lines, SPL, DETECTION).poses) == 0
    found = line_constraints(lines, SPL, DETECTION)
    right, twin = right_ones(found, pose), right_ones(found, compose(HALF_TURN, pose))
    assert right.sum() == 1
    assert twin.sum() == 1
    assert found.log_weights[right] == found.log_weights[twin]
    assert (np.diff(found.log_weights) <= 0.0).all()
    assert (np.linalg.eigvalsh(found.stack.covariances)[:, 0] > 0.0).all()
    whole = found.pixel_covariances + found.by_mount @ NOISE @ found.by_mount.swapaxes(1, 2)
    np.testing.assert_allclose(found.stack.covariances, whole, atol=1e-12)
    # pan turns the heading the other way round and nothing else, as the lines are seen where they are
    np.testing.assert_allclose(found.by_mount[:, 0, 1], -1.0, atol=1e-6)


def test_lines_of_both_directions_give_no_constraint_where_not_all_of_one_can_be_false() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    assert np.bincount(lines.families).tolist() == [3, 3]
    assert len(line_constraints(lines, SPL, DETECTION, 2).log_weights) == 0
    assert len(line_constraints(lines, SPL, DETECTION, 3).log_weights) > 0


def test_the_only_line_of_a_direction_may_be_false_and_then_little_is_known() -> None:
    pose = np.array([2.0, 1.8, 1.5])
    mount = mount_at(MOUNT_AT)
    ends = np.pad(apply(inverse(pose), np.array([[2.1, 2.4], [2.1, 2.8]])), ((0, 0), (0, 1)))
    pixels, visible = project_points(CAMERA, mount, ends)
    assert visible.all()
    false_line = LineObservation(pixels, 0.25 * np.eye(4))
    lines = lines_on_the_ground(CAMERA, mount, (*image_of(SPL, pose, mount), false_line))
    assert lines is not None
    assert set(lines.families.tolist()) == {0, 1}
    solutions, constraints = line_readings(lines, SPL, DETECTION)
    assert gaps(solutions.poses, pose).min() > 0.1  # all of them believe the line
    right = right_ones(constraints, pose)
    assert right.sum() == 1
    assert (constraints.matches[right][0] >= 0).tolist() == (lines.families == 1).tolist()
    # both from one search
    alone = line_solutions(lines, SPL, DETECTION), line_constraints(lines, SPL, DETECTION)
    np.testing.assert_array_equal(alone[0].poses, solutions.poses)
    np.testing.assert_array_equal(alone[1].log_weights, constraints.log_weights)


def one_line(low: float, high: float) -> GroundLines:
    """A line 1.5 m ahead, across, seen from `low` to `high`, robot looking along the field's x or another axis."""
    return ground_lines([1], np.array([1.5]), np.array([[low, high]]), 0.01, np.diag([1e-4, 1e-4]))


def test_a_segment_matches_no_line_shorter_than_itself() -> None:
    lengths = np.linalg.norm(SPL.lines[:, 1] - SPL.lines[:, 0], axis=-1)
    for seen in (0.3, 1.0, 3.0, 5.0, 7.0, 9.5):
        found = line_constraints(one_line(-seen / 2, seen / 2), SPL, DETECTION)
        # each line can be met from both of its sides, unless that is too far from the field
        sides = 2 * np.sum(lengths > seen) - 4 * (seen < 6.0) - 2 * (6.0 <= seen < 9.0)
        assert len(found.log_weights) == sides
        rooms = found.stack.along_m[:, 1] - found.stack.along_m[:, 0]
        for room in rooms:
            assert np.abs(lengths - seen - room).min() < 2 * (0.04 + SPL.line_width_m) + 1e-9


def test_the_room_along_the_line_is_where_its_ends_allow() -> None:
    stack = line_constraints(one_line(-1.0, 2.0), SPL, DETECTION).stack
    slack = 4 * 0.01 + SPL.line_width_m
    goal_line = np.flatnonzero((np.abs(stack.heading_rad) < 1e-9) & (np.abs(stack.offset_m - 3.0) < 1e-9))
    assert len(goal_line) == 1  # x = 4.5 seen from x = 3, looking along x
    np.testing.assert_allclose(stack.normal_rad[goal_line], [0.0], atol=1e-12)
    np.testing.assert_allclose(stack.along_m[goal_line], [[-2.0 - slack, 1.0 + slack]], atol=1e-9)
    touch_line = np.flatnonzero((np.abs(stack.heading_rad - np.pi / 2) < 1e-9) & (np.abs(stack.offset_m - 1.5) < 1e-9))
    assert len(touch_line) == 1  # y = 3 seen from y = 1.5, looking along y: left is -x
    np.testing.assert_allclose(stack.normal_rad[touch_line], [np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(stack.along_m[touch_line], [[-3.5 - slack, 2.5 + slack]], atol=1e-9)


def with_false_line(pose: FloatArray) -> GroundLines:
    """The lines of an image, and one more, parallel to the field's, which is not on the map."""
    mount = mount_at(MOUNT_AT)
    ends = np.pad(apply(inverse(pose), np.array([[3.3, 0.1], [3.3, 1.9]])), ((0, 0), (0, 1)))
    pixels, visible = project_points(CAMERA, mount, ends)
    assert visible.all()
    observations = (LineObservation(pixels, 0.25 * np.eye(4)), *image_of(SPL, pose, mount))
    lines = lines_on_the_ground(CAMERA, mount, observations)
    assert lines is not None
    assert lines.observed[0] == 0  # it looks like a field line
    return lines


def test_a_line_that_is_not_on_the_map_is_left_unexplained() -> None:
    lines = with_false_line(POSE)
    found = line_solutions(lines, SPL, DETECTION)
    for pose in (POSE, compose(HALF_TURN, POSE)):
        right = gaps(found.poses, pose)
        assert right.min() < 1e-8
        assert found.matches[right.argmin(), 0] == -1
    assert gaps(found.poses[:2], POSE).min() < 1e-8  # and nothing is likelier
    nothing_false = line_solutions(lines, SPL, DETECTION, 0)
    assert not len(nothing_false.poses) or gaps(nothing_false.poses, POSE).min() > 0.01
    more = line_solutions(lines, SPL, DETECTION, 3, most=ALL)
    assert all(found_at(more, pose, 1e-9) for pose in found.poses)


@pytest.mark.parametrize("seed", range(3))
def test_false_lines_never_remove_the_truth(seed: int) -> None:
    """One false line among up to six, two among seven or more, each along the field's axes."""
    rng = np.random.default_rng(seed)
    mount, tried = mount_at(MOUNT_AT), 0
    for _ in range(40):
        pose = rng.uniform([-4.3, -2.8, -np.pi], [4.3, 2.8, np.pi])
        true = list(image_of(SPL, pose, mount, 0.5, rng))
        if len(true) < 2:
            continue
        false = []
        for _ in range(1 if len(true) < 6 else 2):
            start = apply(pose, rng.uniform([0.8, -0.8], [2.5, 0.8]))
            along = rng.permutation([rng.uniform(0.4, 0.8), 0.0])
            ends = np.pad(apply(inverse(pose), np.array([start, start + along])), ((0, 0), (0, 1)))
            pixels, visible = project_points(CAMERA, mount, ends)
            if visible.all():
                false.append(LineObservation(pixels, 0.25 * np.eye(4)))
        lines = lines_on_the_ground(CAMERA, mount, (*true, *false))
        assert lines is not None
        clean = lines_on_the_ground(CAMERA, mount, tuple(true))
        # where the false ones cost true ones their place among the lines, the answer lies elsewhere
        if clean is None or not set(clean.observed) <= set(lines.observed) or len(set(clean.families.tolist())) < 2:
            continue
        if np.sum(lines.observed >= len(true)) > unexplained_of(len(lines.families)):
            continue
        tried += 1
        found = line_solutions(lines, SPL, DETECTION, most=ALL)
        error = local(found.poses, pose)
        assert np.min(np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.covariances), error)) < 28.0
    assert tried > 12


def lines_across(distances: FloatArray, covariance: FloatArray) -> GroundLines:
    """Short pieces across, at these distances ahead (n,), and the touch line 3 m to the left; covariance (n, n)."""
    count = len(distances)
    noise = 1e-4 * np.eye(2 + count)
    noise[1:-1, 1:-1] = covariance
    extents = np.array([[-0.3, 0.3]] * (count + 1))
    return ground_lines([*[1] * count, 0], np.array([*distances, 3.0]), extents, 0.01, noise)


FROM_CENTRE = np.array([2.85, 3.9, 4.5])  # the lines ahead of a robot at the centre that looks along x


def test_a_shared_error_leaves_the_gaps_between_lines_sharp() -> None:
    own, shared = 0.02**2 * np.eye(3), np.full((3, 3), 0.5**2)
    together = line_solutions(lines_across(FROM_CENTRE + 0.6, own + shared), SPL, DETECTION, 0)
    # 60 cm off, but every gap is right: nothing but the centre, from either side
    assert len(together.poses) == 2
    np.testing.assert_allclose(np.abs(together.poses[:, :2]), [[0.6, 0.0]] * 2, atol=1e-6)
    alone = lines_across(FROM_CENTRE + 0.6, own + np.diag(np.diagonal(shared)))
    assert len(line_solutions(alone, SPL, DETECTION, 0).poses) > 2


def test_lines_that_fit_in_pairs_but_not_together_are_not_all_explained() -> None:
    pull = 0.027 * np.array([1.0, -1.0, 1.0, -1.0])  # 2.7 sigmas: 3.8 between two of them, too many in all
    for share, whole in ((0.5, 2), (1.0, 0)):
        lines = lines_across(np.full(4, 2.85) + share * pull, 1e-4 * np.eye(4))
        found = line_solutions(lines, SPL, DETECTION, 1, most=ALL)
        at_centre = np.abs(found.poses[:, :2]).max(axis=1) < 0.05
        all_explained = (found.matches >= 0).all(axis=1)
        assert (at_centre & all_explained).sum() == whole
    # then without each of the four in turn, for the pose and its twin
    assert (at_centre & ~all_explained).sum() == 8


def test_map_lines_that_can_hardly_be_told_apart_are_both_answers() -> None:
    doubled = np.concatenate([SPL.lines, SPL.lines[:1] + np.array([0.004, 0.004])])
    field = FieldMap("doubled", doubled, np.zeros((0, 3)), ())
    lines = seen_from(POSE, field)
    assert lines is not None
    found = line_solutions(lines, field, DETECTION, most=ALL)
    near = gaps(found.poses, POSE) < 0.05
    assert near.sum() >= 2
    assert len(np.unique(found.matches[near], axis=0)) == near.sum()


def test_a_map_without_symmetry_is_searched_in_all_four_turns() -> None:
    speck = np.array([[[0.3, 0.3], [0.3, 0.35]]])  # too short to be any line that was seen
    field = FieldMap("speck", np.concatenate([SPL.lines, speck]), np.zeros((0, 3)), ())
    assert len(field.symmetries) == 0
    for pose in (POSE, np.array([2.0, 1.8, 1.5])):
        lines = seen_from(pose)
        assert lines is not None
        (poses, constraints), (other_poses, others) = (
            line_readings(lines, field_map, DETECTION) for field_map in (SPL, field)
        )
        assert len(poses.poses) == len(other_poses.poses)
        assert all(gaps(other_poses.poses, pose).min() < 1e-9 for pose in poses.poses)
        # one more line on the map makes each a little less likely
        shift = np.log(len(line_grid(SPL).axes) / len(line_grid(field).axes))
        for found, other in (
            (poses.log_weights, other_poses.log_weights),
            (constraints.log_weights, others.log_weights),
        ):
            explained = (np.sort(other) - np.sort(found)) / shift
            np.testing.assert_allclose(explained, np.rint(explained), atol=1e-6)
            assert ((explained > 0.5) & (explained < len(lines.families) + 0.5)).all()
        rows, other_rows = (
            np.column_stack([s.offset_m, np.cos(s.heading_rad - 0.2), np.cos(s.normal_rad - 0.2), s.along_m])
            for s in (constraints.stack, others.stack)
        )
        assert len(rows) == len(other_rows)
        assert all(np.abs(other_rows - row).max(axis=1).min() < 1e-9 for row in rows)


def test_a_turned_and_shifted_map_gives_turned_and_shifted_solutions() -> None:
    shift = np.array([2.0, -1.0, 0.5])
    moved = FieldMap("moved", apply(shift, SPL.lines), np.zeros((0, 3)), ())
    lines = seen_from(POSE)
    assert lines is not None
    found, other = line_solutions(lines, SPL, DETECTION), line_solutions(lines, moved, DETECTION)
    assert len(found.poses) == len(other.poses)
    np.testing.assert_allclose(found.log_weights, other.log_weights, atol=1e-6)
    np.testing.assert_allclose(found.covariances, other.covariances, atol=1e-9)
    for pose in compose(shift, found.poses):
        assert gaps(other.poses, pose).min() < 1e-8
    lines = seen_from(np.array([2.0, 1.8, 1.5]))
    assert lines is not None
    right = right_ones(line_constraints(lines, moved, DETECTION), compose(shift, np.array([2.0, 1.8, 1.5])))
    assert right.sum() == 1


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


def test_doubt_about_the_map_widens_the_solutions() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    exact = line_solutions(lines, SPL, DETECTION)
    doubtful = line_solutions(lines, SPL, DETECTION, sigma_map_m=0.03)
    row, other = gaps(exact.poses, POSE).argmin(), gaps(doubtful.poses, POSE).argmin()
    assert np.linalg.eigvalsh(doubtful.covariances[other] - exact.covariances[row])[0] > -1e-12
    assert doubtful.pixel_covariances[other, 0, 0] > exact.pixel_covariances[row, 0, 0]


def test_a_map_without_lines_has_no_solutions() -> None:
    empty = FieldMap("empty", np.zeros((0, 2, 2)), np.zeros((0, 3)), ())
    lines = seen_from(POSE)
    assert lines is not None
    solutions, constraints = line_readings(lines, empty, DETECTION)
    assert solutions.poses.shape == (0, 3)
    assert solutions.by_mount.shape == (0, 3, 4)
    assert solutions.matches.shape == (0, len(lines.families))
    assert constraints.log_weights.shape == (0,)
    single = line_constraints(one_line(-1.0, 1.0), empty, DETECTION)
    assert single.stack.along_m.shape == (0, 2)


def test_a_map_of_one_direction_gives_constraints_alone() -> None:
    rails = FieldMap("rails", SPL.lines[np.ptp(SPL.lines[:, :, 0], axis=1) == 0.0], np.zeros((0, 3)), ())
    lines = seen_from(POSE)
    assert lines is not None
    solutions, constraints = line_readings(lines, rails, DETECTION, max_unexplained=4)
    assert len(solutions.poses) == 0
    assert right_ones(constraints, POSE).sum() == 1


def test_lines_too_vague_to_tell_apart_still_end_in_finite_poses() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    count = len(lines.families)
    covariance = np.diag([1e-2, *np.full(count, 4.0)])
    vague = ground_lines(lines.families.tolist(), lines.distances_m, lines.extents_m, 5.0, covariance)
    found = line_solutions(vague, SPL, DETECTION)
    assert len(found.poses) == 64
    for array in (found.poses, found.covariances, found.log_weights):
        assert np.isfinite(array).all()


def test_touching_pieces_are_one_line_and_askew_lines_are_none_of_the_grid() -> None:
    pieces = [[[0.0, 1.0], [2.0, 1.0]], [[2.0, 1.0], [5.0, 1.0]], [[6.0, 1.0], [7.0, 1.0]], [[0.0, 0.0], [1.0, 2.0]]]
    grid = line_grid(FieldMap("pieces", np.array(pieces), np.zeros((0, 3)), ()))
    np.testing.assert_allclose(grid.heading_rad, 0.0, atol=1e-12)
    assert grid.axes.tolist() == [1, 1]
    np.testing.assert_allclose(grid.extents_m, [[0.0, 5.0], [6.0, 7.0]], atol=1e-12)
