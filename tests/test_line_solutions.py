import numpy as np
from hypothesis import assume, given, settings
from line_views import (
    ALL,
    CAMERA,
    DETECTION,
    HALF_TURN,
    MOUNT_AT,
    NOISE,
    POSE,
    SPL,
    gaps,
    image_of,
    mount_at,
    one_line,
    poses_on_the_field,
    right_ones,
    seen_from,
)

from fieldloc.field import FieldMap
from fieldloc.fixes.line_map import line_grid
from fieldloc.fixes.line_solutions import line_constraints, line_readings, line_solutions
from fieldloc.fixes.lines import lines_on_the_ground
from fieldloc.ground import project_points
from fieldloc.measurements import LineObservation
from fieldloc.pose import FloatArray, apply, compose, inverse, local, wrap
from fieldloc.view import visible_parts


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
    assert found.log_weights[right < 1e-8].max() == found.log_weights[twin < 1e-8].max()
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
    pose = np.array([2.0, 1.8, 1.5])
    lines = seen_from(pose)
    assert lines is not None
    constraints = line_constraints(lines, moved, DETECTION)
    for other_pose in (pose, compose(HALF_TURN, pose)):
        assert right_ones(constraints, compose(shift, other_pose)).sum() == 1
    stack, there = line_constraints(lines, SPL, DETECTION).stack, constraints.stack
    along = stack.normal_rad + shift[2] + 0.5 * np.pi
    rooms = stack.along_m + (np.cos(along) * shift[0] + np.sin(along) * shift[1])[:, None]
    for heading, room in zip(stack.heading_rad + shift[2], rooms, strict=True):
        same = np.abs(wrap(there.heading_rad - heading)) < 1e-8
        assert np.abs(there.along_m[same] - room).max(axis=1).min() < 1e-8


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
