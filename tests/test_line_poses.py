import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldloc.camera import Camera
from fieldloc.field import FieldMap, load_field
from fieldloc.fixes.line_map import line_grid
from fieldloc.fixes.line_poses import LineConstraint, constraints_from_lines, poses_from_lines
from fieldloc.fixes.lines import GroundLines, lines_on_the_ground
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray, apply, compose, inverse, wrap
from fieldloc.view import visible_parts

CAMERA = Camera("pinhole", 640, 480, 450.0, 450.0, 319.5, 239.5, (-0.2, 0.05, 0.001, -0.001))
SPL = load_field("spl")
MOUNT_AT = np.array([0.5, 0.2, 0.35, 0.03])
NOISE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
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


@settings(deadline=None, max_examples=40)
@given(pose=poses_on_the_field)
def test_an_exact_image_gives_the_pose_and_its_half_turn_with_equal_weight(pose: FloatArray) -> None:
    lines = seen_from(pose)
    assume(lines is not None and len(set(lines.families.tolist())) == 2)
    assert lines is not None
    fixes = poses_from_lines(lines, SPL)
    poses = np.array([fix.pose for fix in fixes])
    right, twin = gaps(poses, pose), gaps(poses, compose(HALF_TURN, pose))
    assert right.min() < 1e-8
    assert twin.min() < 1e-8
    np.testing.assert_allclose(fixes[right.argmin()].log_weight, fixes[twin.argmin()].log_weight, rtol=1e-9)
    weights = [fix.log_weight for fix in fixes]
    assert weights == sorted(weights, reverse=True)
    separate = np.array([np.sort(gaps(poses, p))[1] for p in poses])
    assert separate.min() > 1e-3  # no pose is listed twice
    for fix in fixes:
        assert np.linalg.eigvalsh(fix.covariance)[0] > 0


def test_the_search_finds_what_trying_every_assignment_finds() -> None:
    """Three observed lines, all 17^3 assignments in each of four orientations, in the few lines of a textbook."""
    lines = seen_from(np.array([2.6, 0.9, 0.5]))
    assert lines is not None
    assert len(set(lines.families[:3].tolist())) == 2
    keep = slice(0, 3)
    few = GroundLines(
        lines.bearing_rad,
        lines.families[keep],
        lines.distances_m[keep],
        lines.extents_m[keep],
        np.full((3, 2), 1e-4),
        1e-6 * np.eye(4),
        lines.observed[keep],
        0.0,
    )
    expected: list[FloatArray] = []
    for quarter, assigned in itertools.product(range(4), itertools.product(SPL.lines, repeat=3)):
        heading = quarter * np.pi / 2 - few.bearing_rad
        turn = np.array([0.0, 0.0, quarter * np.pi / 2])
        position = np.full(2, np.nan)
        good = True
        segments = []
        for family, d, extent, line in zip(few.families, few.distances_m, few.extents_m, assigned, strict=True):
            ends = np.array([[s, d] if family == 0 else [d, s] for s in extent])
            segment = apply(turn, ends)
            axis = 0 if abs(segment[0, 0] - segment[1, 0]) < 1e-9 else 1
            at = line[:, axis] - segment[:, axis]
            good &= np.ptp(line[:, axis]) < 1e-9 and bool(
                np.isnan(position[axis]) or abs(position[axis] - at[0]) < 0.01
            )
            position[axis] = at[0]
            segments.append((segment, line, 1 - axis))
        for segment, line, along in segments if good else []:
            reach = segment[:, along] + position[along]
            good &= bool(reach.min() > line[:, along].min() - 0.06 and reach.max() < line[:, along].max() + 0.06)
        if good:
            expected.append(np.array([*position, wrap(heading)]))
    distinct = np.unique(np.round(expected, 2), axis=0)
    found = np.unique(np.round([fix.pose for fix in poses_from_lines(few, SPL)], 2), axis=0)
    assert len(distinct) >= 2
    np.testing.assert_allclose(found, distinct, atol=0.011)


def test_the_truth_is_among_the_poses_and_as_near_as_its_covariance_says() -> None:
    rng = np.random.default_rng(4)
    squared = []
    for _ in range(150):
        pose = rng.uniform([-4.3, -2.8, -np.pi], [4.3, 2.8, np.pi])
        observations = image_of(SPL, pose, mount_at(rng.multivariate_normal(MOUNT_AT, NOISE)), 0.7, rng)
        lines = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT), observations)
        if lines is None or len(set(lines.families.tolist())) < 2:
            continue
        distances = []
        for fix in poses_from_lines(lines, SPL):
            error = pose - fix.pose
            error[2] = wrap(error[2])
            distances.append(error @ np.linalg.solve(fix.covariance, error))
        squared.append(min(distances))
    count = len(squared)
    assert count > 100
    # mean of chi-square with 3 degrees of freedom: 3 +- sqrt(6 / count), four of those; max: 1e-6 of them exceed 31
    assert abs(np.mean(squared) - 3.0) < 4.0 * np.sqrt(6.0 / count)
    assert max(squared) < 31.0


def test_lines_of_one_direction_give_a_heading_and_one_coordinate_but_no_pose() -> None:
    pose = np.array([2.0, 1.8, 1.5])  # near a touch line, looking at it
    lines = seen_from(pose)
    assert lines is not None
    assert set(lines.families.tolist()) == {1}
    assert poses_from_lines(lines, SPL) == ()
    constraints = constraints_from_lines(lines, SPL)
    right = []
    for constraint in constraints:
        along = np.array([-constraint.normal[1], constraint.normal[0]]) @ pose[:2]
        right.append(
            abs(constraint.normal @ pose[:2] - constraint.offset_m) < 1e-8
            and abs(wrap(constraint.heading_rad - pose[2])) < 1e-8
            and constraint.along_m[0] <= along <= constraint.along_m[1]
        )
        assert constraint.covariance.shape == (2, 2)
        assert np.linalg.eigvalsh(constraint.covariance)[0] > 0
    assert sum(right) == 1
    weights = np.array([constraint.log_weight for constraint in constraints])
    assert (np.diff(weights) <= 0).all()
    twins = np.isclose(weights, weights[right.index(True)], rtol=1e-9)
    assert twins.sum() >= 2  # the other touch line


def test_lines_of_both_directions_give_no_constraint() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    assert constraints_from_lines(lines, SPL) == ()
    assert constraints_from_lines(lines, SPL, extra_unexplained=1) == ()  # both directions have two lines at least


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
    fixes = poses_from_lines(lines, SPL)
    assert gaps(np.array([fix.pose for fix in fixes]), pose).min() > 0.1  # all of them believe the line
    assert constraints_from_lines(lines, SPL) == ()
    constraints = constraints_from_lines(lines, SPL, extra_unexplained=1)
    right = [c for c in constraints if abs(c.normal @ pose[:2] - c.offset_m) < 1e-8 and gaps_of_heading(c, pose) < 1e-8]
    assert len(right) == 1
    assert right[0].log_weight < fixes[0].log_weight


def gaps_of_heading(constraint: LineConstraint, pose: FloatArray) -> float:
    return float(abs(wrap(constraint.heading_rad - pose[2])))


def one_line(low: float, high: float) -> GroundLines:
    """A line 1.5 m ahead, across, seen from `low` to `high`, robot looking along the field's x or another axis."""
    return GroundLines(
        0.0,
        np.array([1]),
        np.array([1.5]),
        np.array([[low, high]]),
        np.full((1, 2), 0.01),
        np.diag([1e-4, 1e-4]),
        np.array([0]),
        0.0,
    )


def test_a_segment_matches_no_line_shorter_than_itself() -> None:
    lengths = np.linalg.norm(SPL.lines[:, 1] - SPL.lines[:, 0], axis=-1)
    for seen in (0.3, 1.0, 3.0, 5.0, 7.0, 9.5):
        found = constraints_from_lines(one_line(-seen / 2, seen / 2), SPL)
        # each line can be met from both of its sides
        assert len(found) == 2 * np.sum(lengths > seen)
        for constraint in found:
            room = constraint.along_m[1] - constraint.along_m[0]
            assert np.abs(lengths - seen - room).min() < 2 * (0.04 + SPL.line_width_m) + 1e-9


def test_the_room_along_the_line_is_where_its_ends_allow() -> None:
    found = constraints_from_lines(one_line(-1.0, 2.0), SPL)
    goal_line = [c for c in found if abs(c.heading_rad) < 1e-9 and abs(c.offset_m - 3.0) < 1e-9]
    assert len(goal_line) == 1  # x = 4.5 seen from x = 3, looking along x
    np.testing.assert_allclose(goal_line[0].normal, [1.0, 0.0], atol=1e-12)
    slack = 4 * 0.01 + SPL.line_width_m
    np.testing.assert_allclose(goal_line[0].along_m, [-2.0 - slack, 1.0 + slack], atol=1e-9)
    touch_line = [c for c in found if abs(c.heading_rad - np.pi / 2) < 1e-9 and abs(c.offset_m - 1.5) < 1e-9]
    assert len(touch_line) == 1  # y = 3 seen from y = 1.5, looking along y: left is -x
    np.testing.assert_allclose(touch_line[0].normal, [0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(touch_line[0].along_m, [-3.5 - slack, 2.5 + slack], atol=1e-9)


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
    fixes = poses_from_lines(lines, SPL)
    poses = np.array([fix.pose for fix in fixes])
    assert gaps(poses, POSE).min() < 1e-8
    assert gaps(poses, compose(HALF_TURN, POSE)).min() < 1e-8
    more = poses_from_lines(lines, SPL, extra_unexplained=1)
    assert len(poses_from_lines(lines, SPL, extra_unexplained=2)) > len(more) > len(fixes)
    assert more[0].log_weight == pytest.approx(fixes[0].log_weight)
    assert all(gaps(np.array([fix.pose for fix in more]), pose).min() < 1e-9 for pose in poses)


def lines_across(distances: FloatArray, covariance: FloatArray) -> GroundLines:
    """Short pieces across, at these distances ahead (n,), and the touch line 3 m to the left; covariance (n, n)."""
    count = len(distances)
    noise = 1e-4 * np.eye(2 + count)
    noise[1:-1, 1:-1] = covariance
    extents = np.array([*[[-0.3, 0.3]] * count, [-0.3, 0.3]])
    return GroundLines(
        0.0,
        np.array([*[1] * count, 0]),
        np.array([*distances, 3.0]),
        extents,
        np.full((count + 1, 2), 0.01),
        noise,
        np.arange(count + 1),
        0.0,
    )


FROM_CENTRE = np.array([2.85, 3.9, 4.5])  # the lines ahead of a robot at the centre that looks along x


def test_a_shared_error_leaves_the_gaps_between_lines_sharp() -> None:
    own, shared = 0.02**2 * np.eye(3), np.full((3, 3), 0.5**2)
    together = poses_from_lines(lines_across(FROM_CENTRE + 0.6, own + shared), SPL)
    # 60 cm off, but every gap is right: nothing but the centre, from either side
    assert len(together) == 2
    np.testing.assert_allclose(np.abs([fix.pose[:2] for fix in together]), [[0.6, 0.0]] * 2, atol=1e-6)
    alone = poses_from_lines(lines_across(FROM_CENTRE + 0.6, own + np.diag(np.diagonal(shared))), SPL)
    assert len(alone) > 2


def test_lines_that_fit_in_pairs_but_not_together_are_not_all_explained() -> None:
    distances = np.array([2.85, 2.85, 2.85, 2.85])
    pull = 0.027 * np.array([1.0, -1.0, 1.0, -1.0])  # 2.7 sigmas: 3.8 between two of them, too many in all
    fits = poses_from_lines(lines_across(distances + 0.5 * pull, 1e-4 * np.eye(4)), SPL)
    torn = poses_from_lines(lines_across(distances + pull, 1e-4 * np.eye(4)), SPL)
    at_centre = [sum(np.abs(fix.pose[0]) < 0.05 and abs(fix.pose[1]) < 0.05 for fix in fixes) for fixes in (fits, torn)]
    assert at_centre == [2, 8]  # the pose and its twin; then without each of the four in turn


def test_a_turned_and_shifted_map_gives_turned_and_shifted_poses() -> None:
    shift = np.array([2.0, -1.0, 0.5])
    moved = FieldMap("moved", apply(shift, SPL.lines), np.zeros((0, 3)), ())
    lines = seen_from(POSE)
    assert lines is not None
    for fix, other in zip(poses_from_lines(lines, SPL), poses_from_lines(lines, moved), strict=True):
        expected = [compose(shift, fix.pose), compose(shift, compose(HALF_TURN, fix.pose))]  # twins may change places
        i = int(np.argmin([gaps(other.pose[None], pose)[0] for pose in expected]))
        assert gaps(other.pose[None], expected[i])[0] < 1e-8
        np.testing.assert_allclose(np.linalg.eigvalsh(other.covariance), np.linalg.eigvalsh(fix.covariance), rtol=1e-6)
        error = np.array([np.cos(shift[2] + i * np.pi), np.sin(shift[2] + i * np.pi), 0.0])
        np.testing.assert_allclose(error @ other.covariance @ error, fix.covariance[0, 0], rtol=1e-6)


def test_doubt_about_the_map_widens_the_fix() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    exact, doubtful = poses_from_lines(lines, SPL)[0], poses_from_lines(lines, SPL, sigma_map_m=0.03)[0]
    assert np.linalg.eigvalsh(doubtful.covariance - exact.covariance)[0] > -1e-12
    assert doubtful.covariance[0, 0] > exact.covariance[0, 0]


def test_a_map_without_lines_has_no_poses() -> None:
    empty = FieldMap("empty", np.zeros((0, 2, 2)), np.zeros((0, 3)), ())
    lines = seen_from(POSE)
    assert lines is not None
    assert poses_from_lines(lines, empty) == ()
    assert constraints_from_lines(one_line(-1.0, 1.0), empty) == ()


def test_lines_too_vague_to_tell_apart_still_end_in_finite_poses() -> None:
    lines = seen_from(POSE)
    assert lines is not None
    count = len(lines.families)
    vague = GroundLines(
        lines.bearing_rad,
        lines.families,
        lines.distances_m,
        lines.extents_m,
        np.full((count, 2), 5.0),
        np.diag([1e-2, *np.full(count, 4.0)]),
        lines.observed,
        0.0,
    )
    fixes = poses_from_lines(vague, SPL)
    assert fixes
    assert all(np.isfinite([*fix.pose, fix.log_weight]).all() for fix in fixes)


def test_touching_pieces_are_one_line_and_askew_lines_are_none_of_the_grid() -> None:
    pieces = [[[0.0, 1.0], [2.0, 1.0]], [[2.0, 1.0], [5.0, 1.0]], [[6.0, 1.0], [7.0, 1.0]], [[0.0, 0.0], [1.0, 2.0]]]
    grid = line_grid(FieldMap("pieces", np.array(pieces), np.zeros((0, 3)), ()))
    np.testing.assert_allclose(grid.heading_rad, 0.0, atol=1e-12)
    assert grid.axes.tolist() == [1, 1]
    np.testing.assert_allclose(grid.extents_m, [[0.0, 5.0], [6.0, 7.0]], atol=1e-12)
