"""The chain engine against gtsam, against dense matrices and against itself without numba."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_graph import (
    GAUSSIAN,
    LANDMARKS,
    P2,
    P3,
    assert_solves,
    chain_of,
    compass_chain,
    mixed_chain,
    motions_of,
)
from walks import PLAIN, ns, velocities, walk

from estimators import graph
from estimators.chain import ANYWHERE, Chain
from estimators.chain_engine import in_arrays, prepare, solve
from estimators.chain_engine.descent import solved
from estimators.chain_engine.equations import Arithmetic
from estimators.config import Calibration, Compass, Config, Sensor
from estimators.linearised import Linearised
from estimators.motion import CALIBRATION, STANDSTILL, OdometryCalibration
from estimators.solution import Solution
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor, sighted
from fieldloc.pose import FloatArray

Make = Callable[[Linearised, float], Arithmetic]
SEEING = replace(Config(graph=GAUSSIAN), sensor=Sensor(0.03, 0.03, 0.05, 0.1))


def in_numba(linearised: Linearised, cauchy: float) -> Arithmetic:
    pytest.importorskip("numba")
    from estimators.chain_engine.in_numba import InNumba

    return InNumba(linearised, cauchy)


BOTH: list[Make] = [in_numba, in_arrays.InArrays]
both = pytest.mark.parametrize("arithmetic", BOTH, ids=["numba", "arrays"])


def as_seen(chain: Chain, offset_rad: float = 0.0, delay_s: float = 0.0) -> Chain:
    """What is seen is seen through a sensor that is off."""
    factors: list[tuple[int, Factor]] = []
    levers = chain.levers(np.zeros(CALIBRATION))
    for node, factor in chain.factors:
        off = se2.exp(levers[node] @ [0.0, 0.0, offset_rad, delay_s])
        match factor:
            case LandmarkFactor():
                moved = replace(factor, seen=se2.apply(se2.inverse(off), factor.seen))
            case PoseFactor():
                moved = replace(factor, pose=se2.compose(factor.pose, off))
            case _:
                moved = factor
        factors.append((node, sighted(moved)))
    return replace(chain, factors=tuple(factors))


def with_gaps(chain: Chain, keep: Sequence[int], gap_s: float = 0.0) -> Chain:
    """Some of its nodes only, in order; gap_s: so much later in the middle."""
    motions, to = [], {node: k for k, node in enumerate(keep)}
    for before, after in pairwise(keep):
        total = STANDSTILL
        for motion in chain.motions[before:after]:
            total = total.then(motion)
        motions.append(total)
    late = [ns(gap_s) if k >= len(keep) // 2 else 0 for k in range(len(keep))]
    stamps = tuple(chain.stamps_ns[node] + by for node, by in zip(keep, late, strict=True))
    factors = tuple((to[node], factor) for node, factor in chain.factors if node in to)
    return Chain(stamps, tuple(motions), factors, chain.guess[list(keep)])


def assert_same(one: Solution, other: Solution, close: float = 1e-4, covariances: float = 0.01) -> None:
    """close: metres and radians."""
    np.testing.assert_allclose(one.poses[:, :2], other.poses[:, :2], rtol=0, atol=close)
    np.testing.assert_allclose(se2.wrap(one.poses[:, 2] - other.poses[:, 2]), 0.0, atol=close)
    whitener = np.linalg.inv(np.linalg.cholesky(other.covariances))
    relative = whitener @ one.covariances @ np.swapaxes(whitener, -1, -2)
    np.testing.assert_allclose(relative, np.broadcast_to(np.eye(3), relative.shape), rtol=0, atol=covariances)
    np.testing.assert_allclose(one.calibration, other.calibration, rtol=0, atol=close)
    np.testing.assert_allclose(one.sensor, other.sensor, rtol=0, atol=close)
    scale = np.sqrt(np.outer(*2 * (np.diag(other.global_covariance),))) + 1e-300
    np.testing.assert_allclose(one.global_covariance / scale, other.global_covariance / scale, rtol=0, atol=covariances)
    assert one.compass_rad.shape == other.compass_rad.shape
    np.testing.assert_allclose(one.compass_rad, other.compass_rad, rtol=0, atol=close)
    np.testing.assert_allclose(one.compass_variance_rad2, other.compass_variance_rad2, rtol=covariances)
    np.testing.assert_allclose(one.log_determinant, other.log_determinant, rtol=0, atol=max(2.0 * covariances, 1e-3))


def drawn(seed: int) -> Chain:
    """All kinds of factors, a compass, a sensor that is off, nodes at any time, a robot that was carried once."""
    random = np.random.default_rng(seed)
    whole = as_seen(mixed_chain(seed, 60), 0.02, 0.03)
    compass = compass_chain(0.2, seed, 60)[0].factors[1::2]
    readings = tuple((k, f) for k, f in compass if isinstance(f, HeadingFactor))
    headings = tuple(
        (k, replace(f, heading_rad=float(whole.guess[k, 2] + 0.2 + 0.1 * random.standard_normal())))
        for k, f in readings
    )
    keep = np.flatnonzero(random.random(60) < 0.7).tolist()
    chain = with_gaps(replace(whole, factors=whole.factors + headings), keep, 7.3)
    motions = list(chain.motions)
    motions[len(keep) // 2 - 1] = replace(motions[len(keep) // 2 - 1], covariance=ANYWHERE)
    return replace(chain, motions=tuple(motions))


CONFIGS = {
    "shipped": Config(),
    "gaussian": SEEING,
    "plain": replace(PLAIN, sensor=Sensor(0.0, 0.0, 0.0, 0.0)),
    "some": Config(calibration=Calibration(0.1, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0), sensor=Sensor(0.0, 0.03, 0.0, 0.05)),
    "no offset": Config(compass=Compass(offset_sigma_rad=0.0)),
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
@pytest.mark.parametrize("seed", range(3))
def test_the_solution_is_gtsams(seed: int, config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    # as shipped, gtsam's steps end earlier: under the kernel up to a hundredth of a sigma from where they lead to
    monkeypatch.setattr("estimators.graph._CONVERGED", 1e-13)
    monkeypatch.setattr("estimators.graph._MAX_STEPS", 100)
    chain = drawn(seed)
    assert_same(solve(chain, config), graph.solve(chain, config), 5e-5, 1e-3)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
def test_without_numba_it_is_the_same_to_rounding(config: Config) -> None:
    chain = drawn(3)
    assert_same(solved(chain, config, None, in_numba), solved(chain, config, None, in_arrays.InArrays), 1e-8, 1e-6)


@both
@pytest.mark.parametrize("calibrated", [True, False])
def test_the_solution_is_that_of_dense_matrices(
    arithmetic: Make, calibrated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("test_graph.solve", lambda chain, config: solved(chain, config, None, arithmetic))
    config = Config(graph=GAUSSIAN) if calibrated else replace(PLAIN, graph=GAUSSIAN)
    # the covariances are those of a step before
    assert_solves(mixed_chain(1), config, 1e-6, 1e-5, 1e-6)


@both
def test_far_outliers_are_let_go_of(arithmetic: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("test_graph.solve", lambda chain, config: solved(chain, config, None, arithmetic))
    chain = mixed_chain(5)
    wrong = [(k, PoseFactor(0, np.array([3.0, 3.0, 0.0]), P3)) for k in (2, 6, 7)]
    # linear convergence at the end: the steps stop at 5e-6, of which a few are left
    assert_solves(replace(chain, factors=(*chain.factors, *wrong)), Config(), 2e-5, 1e-3, 2e-5)


@both
def test_a_solution_nearby_saves_the_search_and_is_the_same(arithmetic: Make) -> None:
    chain = drawn(4)
    first = solved(chain, Config(), None, arithmetic)
    again = solved(replace(chain, guess=first.poses), Config(), first, arithmetic)
    # the weak prior is about the guess
    assert_same(again, first, 2e-5, 1e-3)


@both
def test_where_the_guess_is_far_off_it_is_found_all_the_same(arithmetic: Make) -> None:
    chain = mixed_chain(2)
    random = np.random.default_rng(0)
    far = se2.retract(chain.guess, random.standard_normal(chain.guess.shape) * [2.0, 2.0, 0.8])
    config = Config(graph=GAUSSIAN)
    assert_same(
        solved(replace(chain, guess=far), config, None, arithmetic), solved(chain, config, None, arithmetic), 1e-3, 1e-2
    )


@both
def test_standing_still_without_any_noise_is_solved(arithmetic: Make) -> None:
    still = [STANDSTILL] * 2000
    ends = [(0, PoseFactor(0, np.zeros(3), P3)), (2000, PoseFactor(0, np.zeros(3), P3))]
    solution = solved(chain_of(still, ends, np.zeros((2001, 3))), replace(PLAIN, graph=GAUSSIAN), None, arithmetic)
    np.testing.assert_allclose(solution.poses, 0.0, atol=1e-6)
    # a tenth of a millimetre a step (MOTION_FLOOR) adds up to 4 mm, beside 10 cm
    np.testing.assert_allclose(solution.covariances, np.broadcast_to(P3 / 2, (2001, 3, 3)), rtol=0.01, atol=1e-4)


@both
def test_a_robot_that_was_carried_is_found_on_the_other_side(arithmetic: Make) -> None:
    motions = motions_of(velocities(9))
    motions[4] = replace(motions[4], covariance=ANYWHERE)
    places = [np.array([0.0, 0.0, 1.0]), np.array([5.0, -3.0, -2.0])]
    ends = [(0, PoseFactor(0, places[0], P3)), (9, PoseFactor(0, places[1], P3))]
    guess = np.array([places[k > 4] for k in range(10)])
    chain = chain_of(motions, ends, guess)
    solution = solved(chain, PLAIN, None, arithmetic)
    np.testing.assert_allclose(solution.poses[[0, 9]], places, atol=1e-3)
    assert_same(solution, graph.solve(chain, PLAIN))


@both
def test_a_chain_of_one_pose_is_that_pose(arithmetic: Make) -> None:
    pose = np.array([1.0, 2.0, 3.0])
    for config in (PLAIN, Config()):
        solution = solved(chain_of([], [(0, PoseFactor(0, pose, P3))], pose[None] + 0.1), config, None, arithmetic)
        np.testing.assert_allclose(solution.poses, [pose], atol=1e-5)
        np.testing.assert_allclose(solution.covariances, [P3], rtol=1e-3)
        np.testing.assert_allclose(
            np.diag(solution.global_covariance)[:CALIBRATION], config.calibration.sigmas() ** 2, rtol=1e-9
        )


@both
def test_a_chain_without_factors_is_its_guess(arithmetic: Make) -> None:
    motions = motions_of(velocities(5))
    guess = [np.array([1.0, 2.0, 3.0])]
    for motion in motions:
        guess.append(se2.compose(guess[-1], motion.before_from_after))
    solution = solved(chain_of(motions, [], np.array(guess)), PLAIN, None, arithmetic)
    np.testing.assert_allclose(solution.poses[:, :2], np.array(guess)[:, :2], atol=1e-5)


def test_a_chain_without_poses_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="without poses"):
        solve(Chain((), (), (), np.zeros((0, 3))), Config())


NAN = np.array([0.0, np.nan, 0.0])


@both
@pytest.mark.parametrize(
    "factor",
    [
        PoseFactor(0, NAN, P3),
        PoseFactor(0, np.zeros(3), P3 * np.nan),
        LandmarkFactor(0, NAN[:2], np.zeros(2), P2),
        LandmarkFactor(0, np.zeros(2), NAN[:2], P2, by_sight=True),
        HeadingFactor(0, np.nan, P2[:1, :1]),
        HeadingFactor(0, np.nan, P2[:1, :1], by_compass=True),
        HeadingFactor(0, 0.0, P2[:1, :1] * np.nan, by_compass=True),
        LineFactor(0, 0.0, np.nan, 0.0, P2),
        LineFactor(0, 0.0, 0.0, np.inf, P2),
    ],
    ids=lambda factor: type(factor).__name__,
)
def test_a_factor_that_is_not_finite_is_an_error_and_no_nonsense(factor: Factor, arithmetic: Make) -> None:
    chain = mixed_chain(0)
    with pytest.raises(ValueError, match="not finite"), np.errstate(invalid="ignore"):
        solved(replace(chain, factors=(*chain.factors, (3, factor))), Config(), None, arithmetic)


@both
@pytest.mark.parametrize("name", ["before_from_after", "covariance", "by_calibration"])
def test_a_motion_that_is_not_finite_is_an_error_and_no_nonsense(name: str, arithmetic: Make) -> None:
    chain = mixed_chain(0)
    motions = list(chain.motions)
    motions[2] = replace(motions[2], **{name: getattr(motions[2], name) * np.nan})
    with pytest.raises(ValueError, match="not finite"):
        solved(replace(chain, motions=tuple(motions)), Config(), None, arithmetic)


def test_a_factor_of_an_unknown_kind_is_refused_by_name() -> None:
    class Tide:
        stamp_ns, covariance = 0, np.eye(1)

        def error(self, poses: FloatArray) -> FloatArray:
            return poses[..., :1]

        def jacobian(self, pose: FloatArray) -> FloatArray:
            return np.zeros((1, 3))

    with pytest.raises(TypeError, match="Tide"):
        solve(chain_of([], [(0, Tide())], np.zeros((1, 3))), Config())


def calibrated_walk(config: Config, random: np.random.Generator) -> tuple[FloatArray, Chain]:
    """The truth and what was seen of it, of a robot whose calibration is drawn from what is believed of it."""
    commands = velocities(300)
    real = OdometryCalibration(*(config.calibration.sigmas() * random.standard_normal(CALIBRATION)).tolist())
    truth = walk(np.zeros((1, 3)), commands, 0.1, random, calibration=real)[:, 0]
    factors: list[tuple[int, Factor]] = []
    for k in range(0, 301, 10):
        mark = LANDMARKS[k // 10 % 3]
        seen = se2.apply(se2.inverse(truth[k]), mark) + random.multivariate_normal(np.zeros(2), P2)
        factors.append((k, LandmarkFactor(ns(0.1 * k), mark, seen, P2)))
        if k % 50 == 0:
            told = se2.retract(truth[k], random.multivariate_normal(np.zeros(3), P3))
            factors.append((k, PoseFactor(ns(0.1 * k), told, P3)))
    return truth, chain_of(motions_of(commands), factors, truth)


@both
def test_the_covariances_are_those_of_the_errors(arithmetic: Make) -> None:
    config = Config(graph=GAUSSIAN)
    nees = []
    for seed in range(20):
        truth, chain = calibrated_walk(config, np.random.default_rng(seed))
        solution = solved(chain, config, None, arithmetic)
        error = se2.local(solution.poses, truth)[::100]
        squares = error * np.linalg.solve(solution.covariances[::100], error[..., None])[..., 0]
        nees.append(np.mean(np.sum(squares, axis=-1)))
    # 3 each if all was as believed; 4 poses of each of 20 walks, nearly independent: 0.27 is the mean's sigma
    assert 2.2 < np.mean(nees) < 3.8


def test_what_takes_a_while_the_first_time_can_be_done_before() -> None:
    pytest.importorskip("numba")
    from estimators.chain_engine import fused, sweep

    prepare()
    for config in CONFIGS.values():
        solve(drawn(5), config)
    kernels = [fused.add_all, sweep._eliminate, sweep._substitute, sweep._covariances]
    # poses alone, with what is the same over the chain, and with a compass' offset
    assert [len(kernel.signatures) for kernel in kernels] == [2, 3, 3, 2]
