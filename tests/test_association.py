from collections.abc import Sequence
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from walks import FIELD, scan

from fieldloc import pose as se2
from fieldloc.association import Belief, associate, seen_in_robot
from fieldloc.covariance import central_difference
from fieldloc.factors import LandmarkFactor, innovation_covariance
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray

MOUNT = np.array([0.2, -0.1, 0.7])
SURE = np.diag([0.05, 0.05, 0.03]) ** 2
NOBODY: frozenset[int] = frozenset()

poses = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-7, 7)).map(np.array)


def field_of(positions: FloatArray, surveys: Sequence[FloatArray] | None = None) -> FieldMap:
    surveys = [np.zeros((2, 2))] * len(positions) if surveys is None else surveys
    marks = tuple(
        Landmark(str(i), position, 0.1, survey)
        for i, (position, survey) in enumerate(zip(positions, surveys, strict=True))
    )
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def unlabelled(points: FloatArray, covariance: FloatArray) -> LandmarkScan:
    """Landmarks seen at points (n, 2) of the robot frame."""
    range_bearing = np.stack([np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])], axis=-1)
    return LandmarkScan(1, (None,) * len(points), range_bearing, np.tile(covariance, (len(points), 1, 1)))


@settings(deadline=None, max_examples=50)
@given(r=st.floats(0.3, 9.0), bearing=st.floats(-3.2, 3.2), mounted=st.booleans())
def test_a_landmark_is_seen_where_its_range_and_bearing_put_it(r: float, bearing: float, mounted: bool) -> None:
    mount = MOUNT if mounted else np.zeros(3)
    noise = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])

    def point(z: FloatArray) -> FloatArray:
        return se2.apply(mount, z[0] * np.array([np.cos(z[1]), np.sin(z[1])]))

    z = np.array([r, bearing])
    seen, covariance = seen_in_robot(LandmarkScan(1, (None,), z[None], noise[None], mount))
    np.testing.assert_allclose(seen, [point(z)], atol=1e-12)
    jacobian = central_difference(point, z)
    np.testing.assert_allclose(covariance, [jacobian @ noise @ jacobian.T], atol=1e-9)


@settings(deadline=None, max_examples=50)
@given(pose=poses, mounted=st.booleans(), seed=st.integers(0, 99))
def test_unlabelled_landmarks_find_their_own_from_a_pose_nearby(pose: FloatArray, mounted: bool, seed: int) -> None:
    random = np.random.default_rng(seed)
    made = scan(1, pose, random, max_range_m=9.0, labelled=False, mount=MOUNT if mounted else None, noisy=False)
    truth = scan(1, pose, random, max_range_m=9.0, mount=MOUNT if mounted else None, noisy=False).labels
    belief = Belief(se2.retract(pose, np.array([0.05, -0.05, 0.03])), SURE)
    assert {row: FIELD.labels[index] for row, index in associate(made, FIELD, belief, NOBODY).items()} == dict(
        enumerate(truth)
    )


def test_rows_with_a_label_and_landmarks_that_are_taken_are_left_alone() -> None:
    pose = np.zeros(3)
    made = scan(1, pose, np.random.default_rng(0), max_range_m=9.0, labelled=False, noisy=False)
    half = LandmarkScan(1, ("0", None, None, "3", None, None), made.range_bearing, made.covariance)
    assert associate(half, FIELD, Belief(pose, SURE), frozenset({0, 3})) == {1: 1, 2: 2, 4: 4, 5: 5}
    assert associate(half, FIELD, Belief(pose, SURE), frozenset(range(6))) == {}


def test_a_scan_without_unlabelled_landmarks_gives_no_association() -> None:
    assert associate(unlabelled(np.zeros((0, 2)), 1e-4 * np.eye(2)), FIELD, Belief(np.zeros(3), SURE), NOBODY) == {}
    labelled = scan(1, np.zeros(3), np.random.default_rng(0))
    assert associate(labelled, FIELD, Belief(np.zeros(3), SURE), NOBODY) == {}


@pytest.mark.parametrize(("off_sigmas", "found"), [(3.5, True), (3.9, False)])
def test_a_landmark_in_a_thousand_is_outside_the_gate(off_sigmas: float, found: bool) -> None:
    # a chi-square of two degrees of freedom passes 13.82 = 3.717**2 once in a thousand
    noise = np.diag([0.1, 1e-6]) ** 2
    made = unlabelled(np.array([[2.0 + 0.1 * off_sigmas, 0.0]]), noise)
    belief = Belief(np.zeros(3), 1e-12 * np.eye(3))
    assert bool(associate(made, field_of(np.array([[2.0, 0.0]])), belief, NOBODY)) is found


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10_000))
def test_the_assignment_is_the_likeliest_of_those_that_leave_the_fewest_out(seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.uniform(-2, 2, (4, 2)) + np.array([3.0, 0.0])
    surveys = [np.diag([scale, 2 * scale]) ** 2 for scale in (0.02, 0.5, 0.1, 0.3)]  # each explains more or less
    field = field_of(positions, surveys)
    root = np.array([[0.3, 0.0, 0.0], [0.05, 0.2, 0.0], [0.08, -0.08, 0.1]])
    belief = Belief(np.array([0.1, 0.2, 0.3]), root @ root.T)
    noise = np.diag([0.1, 0.05]) ** 2
    made = unlabelled(se2.apply(se2.inverse(belief.pose), positions[:3] + random.normal(0, 0.3, (3, 2))), noise)
    seen, covariance = seen_in_robot(made)
    cost = np.full((3, 4), np.inf)
    for row in range(3):
        for column in range(4):
            turn = se2.rotation(-belief.pose[2])
            factor = LandmarkFactor(1, positions[column], seen[row], covariance[row] + turn @ surveys[column] @ turn.T)
            _, expected = innovation_covariance(factor, belief.pose, belief.covariance)
            error = factor.error(belief.pose)
            distance = error @ np.linalg.solve(expected, error)
            if distance <= 13.82:
                cost[row, column] = distance + np.log(np.linalg.det(expected))

    def total(columns: tuple[int, ...]) -> tuple[int, float]:
        """Every column above 3 stands for leaving the row out."""
        chosen = [(row, column) for row, column in enumerate(columns) if column < 4 and np.isfinite(cost[row, column])]
        return -len(chosen), float(sum(cost[pair] for pair in chosen))

    best = min(total(columns) for columns in permutations(range(7), 3))
    found = associate(made, field, belief, NOBODY)
    assert all(np.isfinite(cost[pair]) for pair in found.items())
    count, value = total(tuple(found.get(row, 4 + row) for row in range(3)))
    assert count == best[0]
    assert value == pytest.approx(best[1], abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(by=poses, seed=st.integers(0, 99))
def test_moving_the_whole_field_changes_no_association(by: FloatArray, seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.uniform(-3, 3, (5, 2))
    pose, survey = np.array([0.3, -0.4, 1.0]), np.array([[0.02, 0.005], [0.005, 0.01]])
    points = se2.apply(se2.inverse(pose), positions[:4] + random.normal(0, 0.2, (4, 2)))
    made = unlabelled(points, np.diag([0.1, 0.05]) ** 2)
    covariance = np.diag([0.3, 0.1, 0.1]) ** 2
    here = associate(made, field_of(positions, [survey] * 5), Belief(pose, covariance), NOBODY)
    turn = se2.rotation(by[2])
    there_map = field_of(se2.apply(by, positions), [turn @ survey @ turn.T] * 5)
    assert associate(made, there_map, Belief(se2.compose(by, pose), covariance), NOBODY) == here
