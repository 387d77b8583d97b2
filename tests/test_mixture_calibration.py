"""Whether the Gaussian sum is as sure as it may be: weights against how often they are right, covariances against
errors, sides against a compass that is disturbed. Many walks, each from its own seed."""

from collections.abc import Sequence

import numpy as np
import pytest
from pose_sights import FIELD, HALF_TURN, LOPSIDED, Seen, sight, stroll
from scipy.stats import chi2
from walks import PLAIN, ns, velocities, walk

from estimators.config import Config, Mixture
from estimators.mixture import MixtureFilter
from estimators.mixture.sides import distance
from fieldloc import pose as se2
from fieldloc.heading_mixture import heading_mixture
from fieldloc.measurements import Compass, Odometry
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.repetition import ErrorCorrelation, inflation

FEW, MANY = range(12), range(100)


def expected_calibration_error(said: Sequence[float], was: Sequence[bool]) -> float:
    """In ten bins of probability."""
    p, hit = np.array(said), np.array(was, dtype=np.float64)
    bins = np.minimum((10.0 * p).astype(int), 9)
    return float(sum(abs(p[bins == b].sum() - hit[bins == b].sum()) for b in range(10)) / len(p))


def squared_sigmas(one: Seen) -> FloatArray:
    """(n,) of the truth from each of the hypotheses."""
    out = []
    for h in one.ambiguity.hypotheses:
        error = h.pose - one.truth
        error[2] = se2.wrap(error[2])
        out.append(error @ np.linalg.solve(h.covariance, error))
    return np.array(out)


@pytest.mark.parametrize("region", [FIELD, LOPSIDED], ids=["symmetric", "lopsided"])
@pytest.mark.parametrize("decoys", [1, 4])
def test_what_is_said_to_be_so_likely_is_right_so_often(region: Region, decoys: int) -> None:
    said: list[float] = []
    was: list[bool] = []
    for seed in range(20):
        _, seen = stroll(seed, 3.0, region, Config(), decoys=decoys)
        for one in seen:
            apart = squared_sigmas(one)
            right = int(np.argmin(apart)) if apart.min() < chi2.ppf(1.0 - 1e-5, 3) else -1
            for k, h in enumerate(one.ambiguity.hypotheses):
                if h.weight > 0.01:
                    said.append(h.weight)
                    was.append(k == right)
    assert expected_calibration_error(said, was) < 0.05


@pytest.mark.parametrize(
    "seeds", [pytest.param(range(30), id="30"), pytest.param(range(200), id="200", marks=pytest.mark.slow)]
)
def test_the_estimate_s_covariance_is_that_of_its_error(seeds: range) -> None:
    # once there is one place, up to its twin: each walk is one draw, so errors of one time in it are independent
    nees = np.array([stroll(seed, 6.0)[1][-1].nees for seed in seeds])
    found = nees < chi2.ppf(1.0 - 1e-4, 3)
    assert found.mean() > 0.96
    low, high = chi2.ppf([0.005, 0.995], 3 * found.sum()) / found.sum()
    assert low < nees[found].mean() < high


def test_the_covariance_of_the_whole_mixture_is_honest_before_there_is_one_place() -> None:
    config = Config(calibration=PLAIN.calibration, mixture=Mixture(whole_covariance=1))
    nees = []
    for seed in range(150):
        _, seen = stroll(seed, 0.6, LOPSIDED, config, decoys=2)
        one = seen[0]
        error = one.error()
        nees.append(error @ np.linalg.solve(one.estimate.covariance, error))
    # of a mixture the squared error is no chi-square: its mean is 3 all the same, the spread is taken from the sample
    assert abs(np.mean(nees) - 3.0) < 3.0 * np.std(nees) / np.sqrt(len(nees)) + 0.3


def wrong_sides(seed: int, seconds: float = 24.0) -> list[float]:
    """P(the side is wrong) after each sight from the tenth second on: a compass of 15 deg noise, and 40 deg off for ten
    seconds."""
    random = np.random.default_rng(1000 + seed)
    commands = velocities(round(10 * seconds))
    truth = walk(np.array([[-1.0, 0.5, random.uniform(-np.pi, np.pi)]]), commands, 0.1, random)[:, 0]
    disturbed = random.uniform(0.0, seconds - 10.0)
    off = np.radians(40.0) * random.choice([-1.0, 1.0])
    wider = float(inflation(np.array(0.1), ErrorCorrelation().compass_s))
    estimator = MixtureFilter(Config())
    estimator.start_in(FIELD, 0)
    out = []
    for k, velocity in enumerate(commands):
        stamp_ns = ns(0.1 * k)
        estimator.predict(Odometry(stamp_ns, velocity))
        heading = truth[k, 2] + np.radians(15.0) * random.standard_normal()
        if disturbed <= 0.1 * k < disturbed + 10.0:
            heading += off
        compass = Compass(stamp_ns, float(se2.wrap(heading)), np.radians(15.0))
        estimator.observe(heading_mixture(compass, wider if k else 1.0))
        if k % 5 == 0:
            estimator.observe(sight(stamp_ns, truth[k], random))
            ambiguity = estimator.ambiguity()
            if k >= 100 and ambiguity is not None:
                twin = se2.compose(HALF_TURN[0], truth[k])
                by_side = [
                    sum(h.weight for h in ambiguity.hypotheses if distance(h.pose, near) < 1.0)
                    for near in (truth[k], twin)
                ]
                out.append(by_side[1] / max(sum(by_side), 1e-9))
    return out


@pytest.mark.parametrize(
    "seeds", [pytest.param(range(6), id="6"), pytest.param(MANY, id="100", marks=pytest.mark.slow)]
)
def test_a_disturbed_compass_never_takes_the_wrong_side(seeds: range) -> None:
    for seed in seeds:
        assert max(wrong_sides(seed)) < 0.5


@pytest.mark.slow
def test_every_robot_that_was_carried_is_found_within_two_seconds() -> None:
    for seed in MANY:
        _, seen = stroll(seed, 12.0, config=Config(), carried_at_s=6.0)
        for one in seen:
            if one.stamp_s >= 8.0:
                error = min((one.error(), one.error(other_side=True)), key=lambda e: float(np.linalg.norm(e)))
                assert np.hypot(*error[:2]) < 0.3
                assert abs(error[2]) < np.radians(15)
