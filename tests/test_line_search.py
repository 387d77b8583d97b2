import dataclasses
import itertools

import numpy as np
import pytest
from line_views import (
    ALL,
    CAMERA,
    DETECTION,
    HALF_TURN,
    MOUNT_AT,
    POSE,
    SPL,
    found_at,
    gaps,
    ground_lines,
    image_of,
    mount_at,
    right_ones,
    seen_from,
)

from fieldloc.field import FieldMap
from fieldloc.fixes.line_estimate import log_ends_fit, solve
from fieldloc.fixes.line_map import line_grid, turned_grid
from fieldloc.fixes.line_matching import LineMatcher, Matches
from fieldloc.fixes.line_solutions import line_constraints, line_readings, line_solutions, unexplained_of
from fieldloc.fixes.lines import GroundLines, lines_on_the_ground
from fieldloc.ground import project_points
from fieldloc.measurements import LineObservation
from fieldloc.pose import FloatArray, apply, compose, inverse, local, wrap


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


def test_choices_are_the_same_all_at_once_and_line_by_line(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = with_false_line(POSE)
    at_once = line_solutions(lines, SPL, DETECTION, 5, most=ALL)
    monkeypatch.setattr(LineMatcher, "_choices", LineMatcher._likely_choices)
    by_line = line_solutions(lines, SPL, DETECTION, 5, most=ALL)
    assert len(at_once.poses) > 20
    np.testing.assert_array_equal(at_once.matches, by_line.matches)
    np.testing.assert_array_equal(at_once.log_weights, by_line.log_weights)


def test_of_too_many_choices_the_likely_ones_are_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = with_false_line(POSE)
    every = line_solutions(lines, SPL, DETECTION, 5, most=ALL)
    monkeypatch.setattr("fieldloc.fixes.line_matching._MOST", 40)
    found = line_solutions(lines, SPL, DETECTION, 5, most=ALL)
    assert 0 < len(found.poses) < len(every.poses)
    np.testing.assert_allclose(found.log_weights[0], every.log_weights[0], atol=1e-9)


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
