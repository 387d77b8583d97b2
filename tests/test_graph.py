from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from walks import GENTLE, PLAIN, ns, velocities, walk

from estimators.chain import Chain
from estimators.config import Calibration, Config, Graph, MotionNoise
from estimators.graph import solve
from estimators.motion import CALIBRATION, STANDSTILL, HeldVelocity, Increment, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
P2 = np.array([[0.03, 0.01], [0.01, 0.02]])
LANDMARKS = np.array([[2.0, 1.0], [-1.0, 2.0], [0.5, -2.0]])
GAUSSIAN = Graph(cauchy=1e6)  # a kernel so wide that it does nothing


def motions_of(commands: FloatArray, noise: MotionNoise | None = None) -> list[Increment]:
    held = HeldVelocity(GENTLE if noise is None else noise)
    out = []
    held.advance(0)
    for k, command in enumerate(commands):
        held.hold(Odometry(ns(0.1 * k), command))
        step = held.advance(ns(0.1 * (k + 1)))
        assert step is not None
        out.append(step)
    return out


def chain_of(
    motions: Sequence[Increment], factors: Sequence[tuple[int, Factor]], guess: FloatArray, step_s: float = 0.1
) -> Chain:
    stamps = tuple(ns(step_s * k) for k in range(len(guess)))
    return Chain(stamps, tuple(motions), tuple(factors), guess)


def mixed_chain(seed: int, nodes: int = 14) -> Chain:
    """A short walk with noisy factors of all kinds, guessed roughly."""
    random = np.random.default_rng(seed)
    commands = velocities(8 * nodes)[4::8][: nodes - 1]
    motions = motions_of(commands)
    truth = walk(np.array([[0.3, -0.2, 2.8]]), commands, 0.1, random)[:, 0]
    factors: list[tuple[int, Factor]] = []
    for k, pose in enumerate(truth):
        at = ns(0.1 * k)
        seen = se2.apply(se2.inverse(pose), LANDMARKS[k % 3]) + random.multivariate_normal(np.zeros(2), P2)
        error, heading = random.multivariate_normal(np.zeros(2), P2), 0.15 * random.standard_normal()
        offset = np.cos(k) * pose[0] + np.sin(k) * pose[1] + error[1]
        factors += {
            0: [(k, PoseFactor(at, se2.retract(pose, random.multivariate_normal(np.zeros(3), P3)), P3))],
            1: [(k, LandmarkFactor(at, LANDMARKS[k % 3], seen, P2))],
            2: [(k, HeadingFactor(at, float(pose[2] + heading), np.array([[0.15**2]])))],
            3: [(k, LineFactor(at, float(pose[2] + error[0]), float(k), float(offset), P2))],
        }[k % 4]
    return chain_of(motions, factors, se2.retract(truth, 0.1 * random.standard_normal(truth.shape)))


def dense_solution(chain: Chain, config: Config) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses, their marginal covariances and the calibration by Gauss-Newton on dense matrices."""
    n, sigmas = len(chain.guess), config.calibration.sigmas()
    free = np.flatnonzero(sigmas)
    poses, calibration = chain.guess.copy(), np.zeros(len(sigmas))

    def terms() -> Iterator[tuple[list[int], Callable[[FloatArray], FloatArray], FloatArray, bool]]:
        """(which variables, their step to an error, its covariance, robust) of all there is."""
        weak = np.diag([100.0, 100.0, 10.0]) ** 2
        yield [0, 1, 2], lambda d: se2.local(chain.guess[0], se2.retract(poses[0], d)), weak, False
        last = list(range(3 * n, 3 * n + len(free)))
        for k, motion in enumerate(chain.motions):

            def error(d: FloatArray, k: int = k, motion: Increment = motion) -> FloatArray:
                moved_by = calibration.copy()
                moved_by[free] += d[6:]
                expected = se2.retract(motion.before_from_after, motion.by_calibration @ moved_by)
                ends = se2.retract(poses[k], d[:3]), se2.retract(poses[k + 1], d[3:6])
                return se2.local(expected, se2.between(*ends))

            yield [*range(3 * k, 3 * k + 6), *last], error, motion.covariance + 1e-8 * np.eye(3), False
        for k, factor in chain.factors:
            columns = [3 * k, 3 * k + 1, 3 * k + 2]
            yield columns, lambda d, k=k, f=factor: f.error(se2.retract(poses[k], d)), factor.covariance, True
        if last:
            yield last, lambda d: calibration[free] + d, np.diag(sigmas[free] ** 2), False

    for _ in range(100):
        information, gradient = np.zeros((3 * n + len(free),) * 2), np.zeros(3 * n + len(free))
        for columns, error, covariance, robust in terms():
            residual = error(np.zeros(len(columns)))
            jacobian = central_difference(error, np.zeros(len(columns)), 1e-5)
            weight = np.linalg.inv(covariance)
            if robust:  # Cauchy: iteratively reweighted least squares
                weight = weight / (1.0 + residual @ weight @ residual / config.graph.cauchy**2)
            information[np.ix_(columns, columns)] += jacobian.T @ weight @ jacobian
            gradient[columns] += jacobian.T @ weight @ residual
        step = -np.linalg.solve(information, gradient)
        poses = se2.retract(poses, step[: 3 * n].reshape(n, 3))
        calibration[free] += step[3 * n :]
        if np.abs(step).max() < 1e-9:
            break
    inverse = np.linalg.inv(information)
    blocks = np.array([inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    return poses, blocks, calibration


def assert_solves(
    chain: Chain, config: Config, atol: float, covariance_atol: float, calibration_atol: float = 0.0
) -> None:
    """Poses in metres and radians, covariances in the dense ones' own units."""
    poses, covariances, calibration = dense_solution(chain, config)
    solution = solve(chain, config)
    np.testing.assert_allclose(solution.poses[:, :2], poses[:, :2], rtol=0, atol=atol)
    np.testing.assert_allclose(se2.wrap(solution.poses[:, 2] - poses[:, 2]), 0.0, atol=atol)
    whitener = np.linalg.inv(np.linalg.cholesky(covariances))
    relative = whitener @ solution.covariances @ np.swapaxes(whitener, -1, -2)
    np.testing.assert_allclose(relative, np.broadcast_to(np.eye(3), relative.shape), rtol=0, atol=covariance_atol)
    np.testing.assert_allclose(solution.calibration, calibration, rtol=0, atol=calibration_atol)


@pytest.mark.parametrize("seed", range(3))
def test_the_solution_is_that_of_dense_matrices(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimators.graph._CONVERGED", 1e-12)
    config = Config(graph=GAUSSIAN)
    assert_solves(mixed_chain(seed), config, 1e-6, 1e-6, 1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_solution_with_the_odometry_at_its_word_is_that_of_dense_matrices(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("estimators.graph._CONVERGED", 1e-12)
    assert_solves(mixed_chain(seed), replace(PLAIN, graph=GAUSSIAN), 1e-6, 1e-6)


@pytest.mark.parametrize("config", [Config(), PLAIN], ids=["calibrated", "plain"])
def test_the_robust_solution_as_shipped_is_within_a_hundredth_of_a_sigma_of_the_dense_one(config: Config) -> None:
    # the kernel's steps converge linearly, and stop at a relative change of 1e-5
    chain = mixed_chain(5)
    wrong = PoseFactor(0, np.array([3.0, 3.0, 0.0]), P3)
    assert_solves(replace(chain, factors=(*chain.factors, (6, wrong))), config, 1e-3, 1e-2, 1e-3)


@pytest.mark.parametrize("kind", [PoseFactor, LandmarkFactor, HeadingFactor, LineFactor])
def test_each_kind_of_factor_is_solved_as_itself(kind: type[Factor], monkeypatch: pytest.MonkeyPatch) -> None:
    """One pose to begin with, then factors of one kind only, some of them far from the guess."""
    monkeypatch.setattr("estimators.graph._CONVERGED", 1e-12)
    random = np.random.default_rng(3)
    commands = np.tile([2.0, 0.3, 2.0], (9, 1))
    truth = walk(np.array([[1.0, 0.0, 2.5]]), commands, 0.1, random)[:, 0]
    made: list[tuple[int, Factor]] = [(0, PoseFactor(0, truth[0], P3))]
    for k, pose in enumerate(truth):
        landmark, normal = LANDMARKS[k % 3], 1.3 * k
        heading, offset = pose[2] + 0.1, np.cos(normal) * pose[0] + np.sin(normal) * pose[1] + 0.1
        factors: dict[type, Factor] = {
            PoseFactor: PoseFactor(0, se2.retract(pose, np.array([0.1, 0.2, -0.1])), P3),
            LandmarkFactor: LandmarkFactor(0, landmark, se2.apply(se2.inverse(pose), landmark) + 0.1, P2),
            HeadingFactor: HeadingFactor(0, float(se2.wrap(heading)), P2[:1, :1]),
            LineFactor: LineFactor(0, float(se2.wrap(heading)), normal, float(offset), P2),
        }
        made.append((k, factors[kind]))
    guess = se2.retract(truth, 0.3 * random.standard_normal(truth.shape))
    chain = chain_of(motions_of(commands), made, guess)
    assert_solves(chain, Config(graph=GAUSSIAN), 1e-6, 1e-6, 1e-6)
    # here all but the lines is left to the optimiser, which stops at a relative change of 1e-5
    assert_solves(chain, replace(PLAIN, graph=GAUSSIAN), 5e-6, 5e-6)


def test_a_line_far_along_its_free_direction_is_as_good_as_near() -> None:
    # what is free must stay free: the guess is 5 m off along the line, the other line brings it back
    truth = np.array([1.0, -2.0, 0.4])
    lines = [
        (0, LineFactor(0, 0.4, 0.0, 1.0, np.diag([0.01, 0.01]) ** 2)),
        (0, LineFactor(0, 0.4, np.pi / 2, -2.0, np.diag([0.01, 0.01]) ** 2)),
    ]
    chain = chain_of([], lines, np.array([[4.0, 2.0, 0.7]]))
    solution = solve(chain, Config(graph=GAUSSIAN))
    np.testing.assert_allclose(solution.poses[0], truth, atol=1e-5)
    np.testing.assert_allclose(np.sqrt(np.diag(solution.covariances[0])), [0.01, 0.01, 0.01 / np.sqrt(2)], rtol=1e-3)


def simulated(
    calibration: OdometryCalibration, seed: int, commands: FloatArray, noise: MotionNoise
) -> tuple[Chain, FloatArray]:
    """A walk of miscalibrated odometry with a good pose every second, and the truth (n, 3) at its nodes."""
    random = np.random.default_rng(seed)
    truth = walk(np.zeros((1, 3)), commands, 0.1, random, noise, calibration)[:, 0]
    sigmas = np.array([0.03, 0.03, 0.02])
    motions = motions_of(commands, noise)
    joined, factors = [], []
    for k in range(0, len(commands) + 1, 10):
        seen = se2.retract(truth[k], sigmas * random.standard_normal(3))
        factors.append((k // 10, PoseFactor(ns(0.1 * k), seen, np.diag(sigmas**2))))
        if k:
            total = STANDSTILL
            for motion in motions[k - 10 : k]:
                total = total.then(motion)
            joined.append(total)
    guess = np.array([factor.pose for _, factor in factors])
    return chain_of(joined, factors, guess, 1.0), truth[::10]


def test_the_odometrys_calibration_is_found() -> None:
    real = OdometryCalibration(0.08, -0.1, 0.12, -0.06, 0.02, -0.01, 0.015, 0.2)
    commands = velocities(1200)
    chain, truth = simulated(real, 4, commands, GENTLE)
    config = replace(Config(graph=GAUSSIAN), calibration=Calibration(0.2, 0.2, 0.2, 0.2, 0.05, 0.05, 0.05))
    solution = solve(chain, config)
    error = np.subtract(solution.calibration, real)
    # each is known to a fraction of its prior by now, and off by no more than three of its own sigmas
    marginal = calibration_covariance(chain, config, solution.poses)
    assert np.all(np.sqrt(np.diag(marginal)) < 0.5 * config.calibration.sigmas())
    assert error @ np.linalg.solve(marginal, error) < 22.5  # chi-square, 6 degrees of freedom, once in a thousand
    plain = solve(chain, replace(config, calibration=PLAIN.calibration))
    assert np.hypot(*(solution.poses - truth)[:, :2].T).mean() < 0.95 * np.hypot(*(plain.poses - truth)[:, :2].T).mean()


def calibration_covariance(chain: Chain, config: Config, poses: FloatArray) -> FloatArray:
    """first order, from motions and whole poses alone."""
    information = np.diag(config.calibration.sigmas() ** -2.0)
    size = 3 * len(poses)
    whole = np.zeros((size + CALIBRATION, size + CALIBRATION))
    whole[size:, size:] = information
    for k, motion in enumerate(chain.motions):
        after = se2.adjoint(se2.inverse(motion.before_from_after))
        jacobian = np.hstack([-after, np.eye(3), -motion.by_calibration])
        columns = [*range(3 * k, 3 * k + 6), *range(size, size + CALIBRATION)]
        whole[np.ix_(columns, columns)] += jacobian.T @ np.linalg.solve(motion.covariance, jacobian)
    for k, factor in chain.factors:
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += np.linalg.inv(factor.covariance)
    return np.asarray(np.linalg.inv(whole)[size:, size:])


def test_the_calibrations_doubt_widens_the_poses_covariances() -> None:
    chain, _ = simulated(OdometryCalibration(), 1, velocities(60), GENTLE)
    few = replace(chain, factors=chain.factors[:1])  # after the first pose, odometry alone
    plain, calibrating = solve(few, PLAIN), solve(few, Config())
    total = STANDSTILL
    for motion in chain.motions:
        total = total.then(motion)
    last = total.by_calibration
    np.testing.assert_allclose(
        calibrating.covariances[-1] - plain.covariances[-1],
        last @ np.diag(Calibration().sigmas() ** 2) @ last.T,
        rtol=1e-3,
        atol=1e-5,
    )


NAN = np.array([0.0, np.nan, 0.0])


@pytest.mark.parametrize(
    "factor",
    [
        PoseFactor(0, NAN, P3),
        PoseFactor(0, np.zeros(3), P3 * np.nan),
        LandmarkFactor(0, NAN[:2], np.zeros(2), P2),
        LandmarkFactor(0, np.zeros(2), NAN[:2], P2),
        HeadingFactor(0, np.nan, P2[:1, :1]),
        HeadingFactor(0, 0.0, P2[:1, :1] * np.nan),
        LineFactor(0, np.nan, 0.0, 0.0, P2),
        LineFactor(0, 0.0, 0.0, np.nan, P2),
        LineFactor(0, 0.0, np.nan, 0.0, P2),
    ],
    ids=lambda factor: type(factor).__name__,
)
@pytest.mark.parametrize("config", [Config(), PLAIN], ids=["calibrated", "plain"])
def test_a_factor_that_is_not_finite_is_an_error_and_no_nonsense(factor: Factor, config: Config) -> None:
    chain = mixed_chain(0)
    with pytest.raises(ValueError, match="not finite"):
        solve(replace(chain, factors=(*chain.factors, (3, factor))), config)


@pytest.mark.parametrize("name", ["before_from_after", "covariance"])
def test_a_motion_that_is_not_finite_is_an_error_and_no_nonsense(name: str) -> None:
    chain = mixed_chain(0)
    motions = list(chain.motions)
    motions[2] = replace(motions[2], **{name: getattr(motions[2], name) * np.nan})
    with pytest.raises(ValueError, match="not finite"):
        solve(replace(chain, motions=tuple(motions)), Config())


def test_a_factor_of_an_unknown_kind_is_refused_by_name() -> None:
    class Tide:
        stamp_ns, covariance = 0, np.eye(1)

        def error(self, poses: FloatArray) -> FloatArray:
            return poses[..., :1]

        def jacobian(self, pose: FloatArray) -> FloatArray:
            return np.zeros((1, 3))

    with pytest.raises(TypeError, match="Tide"):
        solve(chain_of([], [(0, Tide())], np.zeros((1, 3))), Config())


def test_a_chain_of_one_pose_is_that_pose() -> None:
    pose = np.array([1.0, 2.0, 3.0])
    for config in (PLAIN, Config()):
        solution = solve(chain_of([], [(0, PoseFactor(0, pose, P3))], pose[None] + 0.1), config)
        np.testing.assert_allclose(solution.poses, [pose], atol=1e-5)
        np.testing.assert_allclose(solution.covariances, [P3], rtol=1e-3)


def test_standing_still_without_any_noise_is_solved() -> None:
    still = [STANDSTILL] * 20
    chain = chain_of(
        still, [(0, PoseFactor(0, np.zeros(3), P3)), (20, PoseFactor(0, np.zeros(3), P3))], np.zeros((21, 3))
    )
    solution = solve(chain, Config(graph=GAUSSIAN))
    np.testing.assert_allclose(solution.poses, 0.0, atol=1e-6)
    np.testing.assert_allclose(solution.covariances, np.broadcast_to(P3 / 2, (21, 3, 3)), rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_a_hundred_thousand_poses_are_solved() -> None:
    # elimination recurses along the chain: on the usual stack this dies
    count = 100_000
    random = np.random.default_rng(0)
    step = motions_of(np.array([[0.5, 0.0, 0.3]]))[0]
    truth = [np.zeros(3)]
    for _ in range(count - 1):
        truth.append(se2.compose(truth[-1], step.before_from_after))
    every = [(k, PoseFactor(0, truth[k], P3)) for k in range(0, count, 100)]
    guess = se2.retract(np.array(truth), np.array([0.1, 0.1, 0.05]) * random.standard_normal((count, 3)))
    solution = solve(chain_of([step] * (count - 1), every, guess), Config())
    np.testing.assert_allclose(solution.poses[:, :2], np.array(truth)[:, :2], atol=0.01)


def compass_chain(offset_rad: float, seed: int, nodes: int = 400) -> tuple[Chain, FloatArray]:
    """Whole poses now and then, a compass all the time that is off by an offset."""
    random = np.random.default_rng(seed)
    commands = velocities(nodes - 1)
    motions = motions_of(commands)
    truth = walk(np.array([[0.3, -0.2, 2.8]]), commands, 0.1, random)[:, 0]
    factors: list[tuple[int, Factor]] = []
    for k, pose in enumerate(truth):
        if k % 20 == 0:
            factors.append((k, PoseFactor(ns(0.1 * k), se2.retract(pose, 0.05 * random.standard_normal(3)), P3 / 16)))
        if k % 2 == 0:
            heading = float(se2.wrap(pose[2] + offset_rad + 0.1 * random.standard_normal()))
            factors.append((k, HeadingFactor(ns(0.1 * k), heading, np.array([[0.01]]), by_compass=True)))
    return chain_of(motions, factors, truth), truth


@pytest.mark.parametrize("config", [PLAIN, Config()], ids=["plain", "calibrated"])
@pytest.mark.parametrize("offset_rad", [0.0, 0.3, -0.3])
def test_the_compass_offset_is_found_and_does_not_turn_the_way(offset_rad: float, config: Config) -> None:
    chain, truth = compass_chain(offset_rad, 3)
    solution = solve(chain, config)
    off = solution.compass_rad - offset_rad
    # one each second, from five readings of 0.1 rad and its neighbours
    assert np.abs(off.mean()) < 0.04
    assert np.sqrt(np.mean(off**2)) < 0.08
    assert (off**2 / solution.compass_variance_rad2).mean() < 2.0
    turned = se2.wrap(solution.poses[:, 2] - truth[:, 2])
    assert np.abs(turned.mean()) < 0.03


def test_what_is_known_of_the_compass_makes_the_heading_surer() -> None:
    chain, _ = compass_chain(0.1, 5)
    without = replace(chain, factors=tuple(one for one in chain.factors if isinstance(one[1], PoseFactor)))
    config = replace(PLAIN, graph=GAUSSIAN)
    with_it, alone = solve(chain, config), solve(without, config)
    assert len(alone.compass_rad) == 0
    assert (with_it.covariances[:, 2, 2] < alone.covariances[:, 2, 2] * (1 + 1e-9)).all()


def test_a_solution_nearby_saves_the_search_and_is_the_same() -> None:
    chain = mixed_chain(4)
    config = Config(graph=GAUSSIAN)
    first = solve(chain, config)
    again = solve(replace(chain, guess=first.poses), config, first)
    np.testing.assert_allclose(again.poses, first.poses, atol=1e-4)
    np.testing.assert_allclose(again.log_determinant, first.log_determinant, atol=1e-2)


def test_the_log_determinant_is_that_of_the_dense_information() -> None:
    chain = mixed_chain(2)
    solution = solve(chain, replace(PLAIN, graph=GAUSSIAN))
    n = len(chain.guess)
    information = np.zeros((3 * n, 3 * n))
    information[:3, :3] += np.diag([1e-4, 1e-4, 1e-2])
    for k, motion in enumerate(chain.motions):
        error = se2.local(motion.before_from_after, se2.between(solution.poses[k], solution.poses[k + 1]))
        after = se2.right_jacobian_inverse(error)
        before = -after @ se2.adjoint(se2.inverse(se2.between(solution.poses[k], solution.poses[k + 1])))
        row = np.zeros((3, 3 * n))
        row[:, 3 * k : 3 * k + 3], row[:, 3 * k + 3 : 3 * k + 6] = before, after
        information += row.T @ np.linalg.solve(motion.covariance + 1e-8 * np.eye(3), row)
    for k, factor in chain.factors:
        jacobian = factor.jacobian(solution.poses[k])
        at = slice(3 * k, 3 * k + 3)
        information[at, at] += jacobian.T @ np.linalg.solve(factor.covariance, jacobian)
    np.testing.assert_allclose(solution.log_determinant, np.linalg.slogdet(information)[1], atol=1e-3)
