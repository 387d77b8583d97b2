"""One assignment from one pose, by plain numbers, against the arrays that many of them take."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldloc import pose as se2
from fieldloc import scan_expansion
from fieldloc.covariance import cholesky_factors
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import Expansion
from fieldloc.one_pose import arc, spread
from fieldloc.pose import FloatArray
from fieldloc.scan_assignments import likeliest
from fieldloc.scan_coverage import Coverage, Misses, Sightings
from fieldloc.scan_mixture import ScanMixture, scan_mixture
from fieldloc.scan_noise import AS_STATED, ScanNoise
from fieldloc.scan_noises import errors_at_best

MOUNT = np.array([0.2, -0.1, 0.7])
MARKS = 9


def field_of(random: np.random.Generator) -> FieldMap:
    places = random.uniform(-4.0, 4.0, (MARKS, 2))
    marks = tuple(Landmark(str(i), place, 0.1, np.zeros((2, 2))) for i, place in enumerate(places))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def coverage_of(field: FieldMap, random: np.random.Generator) -> Coverage:
    sightings = Sightings(field, 0.4)
    sightings.see(np.column_stack([random.uniform(0.5, 5.0, 500), random.uniform(-1.5, 1.5, 500)]))
    assert sightings.coverage is not None
    return sightings.coverage


def mixture(
    random: np.random.Generator, pose: FloatArray, labelled: bool, noise: ScanNoise, again: bool
) -> ScanMixture:
    """Some landmarks, seen with errors of about one sigma."""
    field = field_of(random)
    which = random.choice(MARKS, size=random.integers(1, 6), replace=False)
    at = se2.apply(se2.inverse(se2.compose(pose, MOUNT)), field.positions[which])
    root = random.normal(0.0, 0.02, (len(which), 2, 2))
    covariance = root @ root.swapaxes(-1, -2) + 1e-4 * np.eye(2)
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    seen = seen + (cholesky_factors(covariance) @ random.normal(size=(len(which), 2, 1)))[..., 0]
    labels = tuple(str(i) if labelled else None for i in which)
    wider = random.uniform(1.0, 3.0, (MARKS, 2)) if again else np.ones((MARKS, 2))
    out = scan_mixture(
        LandmarkScan(0, labels, seen, covariance, MOUNT),
        field,
        Detection(),
        wider,
        Misses(coverage_of(field, random), 0.7, seen),
        noise,
        np.array([2.0, 1.5]) if again else None,
    )
    assert out is not None
    return out


def numbers(of: Expansion) -> list[FloatArray]:
    return [of.constant, of.gradient, of.information, *of.after]


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("noise", [AS_STATED, ScanNoise(0.6, 0.8, 0.3, 0.4)])
def test_plain_numbers_are_those_of_arrays(
    monkeypatch: pytest.MonkeyPatch, labelled: bool, again: bool, noise: ScanNoise
) -> None:
    alone = 0
    for seed in range(30):
        random = np.random.default_rng(seed)
        pose = random.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi])
        seen = mixture(random, pose, labelled, noise, again)
        root = random.normal(0.0, random.choice([0.01, 0.1]), (3, 3))
        covariance = root @ root.T + 1e-5 * np.eye(3)
        believed = se2.retract(pose, root @ random.normal(size=3))
        monkeypatch.setattr(scan_expansion, "MOST", 12)
        one = seen.expand(believed[None], covariance[None])
        monkeypatch.setattr(scan_expansion, "MOST", 0)
        other = seen.expand(believed[None], covariance[None])
        assert one.ids.tolist() == other.ids.tolist()
        alone += len(one.ids) == 1
        for mine, theirs in zip(numbers(one), numbers(other), strict=True):
            # as well as sums of large numbers cancel
            np.testing.assert_allclose(mine, theirs, rtol=1e-8, atol=1e-8 * max(np.abs(theirs).max(initial=0.0), 1e-4))
    assert alone > 5


@given(st.integers(0, 10_000))
def test_what_one_pose_misses_is_what_many_poses_miss(seed: int) -> None:
    random = np.random.default_rng(seed)
    field = field_of(random)
    coverage = coverage_of(field, random)
    pose = random.uniform([-4.0, -4.0, -np.pi], [4.0, 4.0, np.pi])
    root = random.normal(0.0, 0.1, (3, 3))
    covariance = root @ root.T
    seen = np.column_stack([random.uniform(0.5, 3.0, 3), random.uniform(-1.5, 1.5, 3)])
    found = set(random.choice(MARKS, 2).tolist())
    wanted = np.array([[index not in found for index in range(MARKS)]])
    expected = coverage.log_missed(pose[None], covariance[None], seen, wanted).sum()
    x, y, heading = pose.tolist()
    place_m2 = float(covariance[0, 0] + covariance[1, 1])
    missed = coverage.log_missed_alone((x, y, heading), place_m2, float(covariance[2, 2]), seen, found)
    assert missed == pytest.approx(float(expected), abs=1e-9)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_one_arc_is_one_of_many(tangent: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(np.array(arc(*tangent)), se2.exp(np.array(tangent)), atol=1e-12)
    np.testing.assert_allclose(spread(*tangent), se2.right_jacobian(np.array(tangent)), atol=1e-12)


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("noise", [AS_STATED, ScanNoise(0.6, 0.8, 0.3, 0.4)])
def test_landmarks_are_recognised_alike_on_a_map_that_is_exact_and_one_that_is_known_to_be(
    labelled: bool, again: bool, noise: ScanNoise
) -> None:
    """A survey without errors is left to arrays."""
    right = wrong = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        pose = random.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi])
        model = mixture(random, pose, labelled, noise, again).model
        at = se2.retract(se2.compose(pose, MOUNT), random.normal(0.0, 0.05, 3))
        surveyed = replace(model, survey=np.zeros((MARKS, 2, 2)))
        seen = likeliest(model, at)
        assert seen.tolist() == likeliest(surveyed, at).tolist()
        right, wrong = right + np.count_nonzero(seen >= 0), wrong + np.count_nonzero(seen < 0)
    assert right > 20
    assert wrong > 5


def test_errors_are_least_at_the_same_place_by_plain_numbers() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        pose = random.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi])
        seen = mixture(random, pose, True, ScanNoise(0.6, 0.8, 0.3, 0.4), False)
        assert seen.model.named is not None
        at, rows = se2.compose(pose, MOUNT), np.arange(len(seen.model.named))
        one, other = (
            errors_at_best(model, at, seen.model.named, rows, seen.scan, seen.field_map.positions_covariance)
            for model in (seen.model, replace(seen.model, survey=np.zeros((MARKS, 2, 2))))
        )
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-7, atol=1e-9)
