"""Many scans' solutions as factors at once, against one by one."""

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.factors import PoseFactor
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.scan_mixture import ScanMixture, scan_mixture
from fieldloc.scan_noise import AS_STATED, ScanNoise
from fieldloc.scan_poses import factors_of

PLACES = np.random.default_rng(0).uniform(-4.0, 4.0, (9, 2))
MOUNTS = np.array([[0.2, -0.1, 0.7], [0.0, 0.0, 0.0]])


def field_of(survey_m: float = 0.0) -> FieldMap:
    covariance = survey_m**2 * np.eye(2)
    marks = tuple(Landmark(str(i), place, 0.1, covariance) for i, place in enumerate(PLACES))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def mixture(
    random: np.random.Generator, field: FieldMap, noise: ScanNoise, again: bool, sigma: float
) -> tuple[ScanMixture, list[int]]:
    """Up to six landmarks, some farther than they are, and its solutions there."""
    pose = random.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi])
    mount: FloatArray = MOUNTS[random.integers(2)]
    which = random.choice(9, size=random.integers(1, 7), replace=False)
    at = se2.apply(se2.inverse(se2.compose(pose, mount)), PLACES[which])
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    seen[:, 0] += np.where(random.random(len(seen)) < 0.05, 0.5, 0.0)
    sigmas = sigma * np.array([1.0, 0.5])
    out = scan_mixture(
        LandmarkScan(
            int(random.integers(1000)),
            tuple(map(str, which)),
            seen + sigmas * random.normal(size=seen.shape),
            np.tile(np.diag(sigmas**2), (len(which), 1, 1)),
            mount,
        ),
        field,
        Detection(),
        random.uniform(1.0, 3.0, (9, 2)) if again else np.ones((9, 2)),
        noise=noise,
        wider_shared=np.array([2.0, 1.5]) if again else None,
    )
    assert out is not None
    return out, out.expand(pose[None], np.diag([0.05, 0.05, 0.03])[None] ** 2).ids.tolist()


@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("noise", [AS_STATED, ScanNoise(0.6, 0.8, 0.3, 0.4)])
@pytest.mark.parametrize("sigma", [0.01, 0.15])
def test_many_solutions_at_once_are_each_of_them(again: bool, noise: ScanNoise, sigma: float) -> None:
    random = np.random.default_rng(3)
    fields = [field_of(), field_of(), field_of(0.3)]
    mixtures = [mixture(random, fields[k % 3], noise, again, sigma) for k in range(60)]
    asked = [(one, ids[0]) for one, ids in mixtures if ids]
    together = factors_of([one for one, _ in asked], [solution for _, solution in asked])
    poses = 0
    for (one, solution), factors in zip(asked, together, strict=True):
        alone = one.chosen(solution)
        assert [type(factor) for factor in factors] == [type(factor) for factor in alone]
        for mine, theirs in zip(factors, alone, strict=True):
            assert mine.stamp_ns == theirs.stamp_ns
            # both stop when a step is nothing beside a sigma
            np.testing.assert_allclose(mine.covariance, theirs.covariance, rtol=1e-4, atol=1e-9)
            if isinstance(mine, PoseFactor) and isinstance(theirs, PoseFactor):
                poses += 1
                off = se2.local(theirs.pose, mine.pose)
                assert off @ np.linalg.solve(theirs.covariance, off) < 1e-8
                assert mine.by_sight
    assert poses > 20


def test_of_nothing_comes_nothing() -> None:
    assert factors_of([], []) == []
