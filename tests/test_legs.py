"""How noisy odometry is, learned from the corrections at the ends of legs; and the poses that things are about."""

import numpy as np
import pytest
from walks import GENTLE, KNOWN_NOISE, ns

from estimators.config import Calibration, Config, MotionNoise
from estimators.legs import Legs, as_noisy
from estimators.motion import CALIBRATION, PARTS, SAID, HeldVelocity, Increment, stated_parts
from estimators.views import EXTRA, LATE, View, Views, prior
from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

KNOWN = np.diag([0.02, 0.02, 0.01]) ** 2
SURE = np.zeros((3 + CALIBRATION, 3 + CALIBRATION))
SURE[:3, :3] = KNOWN


def walked(legs: Legs, louder: FloatArray, count: int, random: np.random.Generator, wild: int = 0) -> FloatArray:
    """Scales after so many legs of a robot with `louder` (SAID,) times the variances; each wild-th is an outlier."""
    pose = np.zeros(3)
    legs.begin(pose, SURE, np.zeros(CALIBRATION))
    for leg in range(count):
        turn = random.uniform(-1.0, 1.0)
        way = np.array([2.0, 0.0, turn])
        back = se2.adjoint(se2.inverse(way))
        turned = 0.3 * back[:, 2:] * back[:, 2] + 0.7 * np.diag([0.0, 0.0, 1.0])
        parts = np.zeros((PARTS, 3, 3))
        parts[:SAID] = np.diag([0.01, 0.004, 0.0]), 0.04 * abs(turn) * turned, 0.02 * turned
        scaled = parts * legs.scales[:, None, None]
        legs.move(Increment(way, scaled.sum(axis=0), np.zeros((3, CALIBRATION)), scaled), np.zeros(CALIBRATION))
        noise = random.multivariate_normal(np.zeros(3), np.tensordot(louder, parts[: len(louder)], 1), method="eigh")
        if wild and leg % wild == 0:
            noise = noise + [3.0, -3.0, 1.0]
        # what is known at both ends is off by its own share, the start's carried along
        before, after = (np.sqrt(np.diag(KNOWN)) * random.standard_normal(3) for _ in range(2))
        pose = se2.retract(se2.compose(pose, way), noise - back @ before + after)
        legs.look(pose, SURE, np.zeros(CALIBRATION))
        legs.begin(pose, SURE, np.zeros(CALIBRATION))
    return legs.scales[:SAID]


@pytest.mark.parametrize("louder", [(4.0, 1.0, 1.0), (1.0, 6.0, 1.0), (0.4, 3.0, 3.0)])
def test_the_noises_are_told_apart(louder: tuple[float, ...]) -> None:
    logs = [np.log(walked(Legs(GENTLE), np.array(louder), 120, np.random.default_rng(seed))) for seed in range(12)]
    # of 120 legs, 2 numbers tell of the way: a sigma of 0.1 of the logarithm. 1 tells of both noises of the heading,
    # apart only in how much each leg turned: about 0.4; over 12 runs a third of that
    np.testing.assert_allclose(np.mean(logs, axis=0)[0], np.log(louder[0]), atol=0.2)
    np.testing.assert_allclose(np.mean(logs, axis=0)[1:], np.log(louder[1:]), atol=0.6)


def test_a_minute_or_two_tells_that_it_is_louder_than_thought() -> None:
    few = walked(Legs(GENTLE), np.full(SAID, 5.0), 5, np.random.default_rng(1))
    assert few[0] > 2.0
    assert few[1:].max() > 2.0


def test_no_outlier_has_more_than_a_say() -> None:
    plain = walked(Legs(GENTLE), np.ones(SAID), 60, np.random.default_rng(2))
    wild = walked(Legs(GENTLE), np.ones(SAID), 60, np.random.default_rng(2), wild=12)
    assert (wild < 3.0 * plain).all()


def test_noise_that_is_known_is_left_alone() -> None:
    np.testing.assert_array_equal(walked(Legs(KNOWN_NOISE), np.full(SAID, 9.0), 20, np.random.default_rng(3)), 1.0)


def test_where_nothing_is_known_the_noise_is_thought_to_be_what_it_is_on_the_average() -> None:
    np.testing.assert_allclose(Legs(MotionNoise(log_scale_sigma=1.0)).scales, np.exp(0.5))


@pytest.mark.parametrize("stated", [None, np.array([[0.04, 0.01, 0.02], [0.01, 0.03, -0.01], [0.02, -0.01, 0.05]])])
def test_each_part_of_the_noise_scales_by_itself(stated: FloatArray | None) -> None:
    def moved(scales: FloatArray) -> Increment:
        motion = HeldVelocity(KNOWN_NOISE)
        motion.scales = scales
        motion.advance(0)
        motion.hold(Odometry(0, np.array([0.5, 0.0, 0.2]), stated))
        step = motion.advance(ns(1.0))
        assert step is not None
        np.testing.assert_allclose(step.parts.sum(axis=0), step.covariance, atol=1e-15)
        return step

    plain = moved(np.ones(PARTS))
    assert plain.parts[0][2, 2] == 0.0  # noise of the way turns nobody
    assert plain.parts[:SAID].any() == (stated is None)
    assert plain.parts[SAID:].any() == (stated is not None)
    for which, factor in enumerate((3.0, 5.0, 7.0, 2.0, 4.0)):
        factors = np.ones(PARTS)
        factors[which] = factor
        np.testing.assert_allclose(moved(factors).parts, plain.parts * factors[:, None, None], atol=1e-15)


def test_what_an_odometry_states_comes_apart_into_covariances() -> None:
    random = np.random.default_rng(4)
    roots = random.normal(size=(20, 3, 3))
    roots[:5, 2] = 0.0  # a heading that is stated to be exact
    stated = roots @ roots.swapaxes(1, 2)
    parts = stated_parts(stated)
    np.testing.assert_allclose(parts.sum(axis=1), stated, atol=1e-12)
    assert (np.linalg.eigvalsh(parts) > -1e-12).all()
    np.testing.assert_allclose(parts[:, SAID, 2], 0.0, atol=1e-12)


def test_an_odometry_that_states_ten_times_its_variance_is_found_out() -> None:
    random = np.random.default_rng(5)
    stated, period_s = np.diag([0.04, 0.02, 0.03]), 0.1
    motion, legs = HeldVelocity(GENTLE), Legs(GENTLE)
    pose = np.zeros(3)
    legs.begin(pose, SURE, np.zeros(CALIBRATION))
    motion.advance(0)
    for leg in range(60):
        velocity = np.array([0.5, 0.0, random.uniform(-0.5, 0.5)])
        for tick in range(40):
            motion.hold(Odometry(ns(4.0 * leg + period_s * tick), velocity, stated))
            step = motion.advance(ns(4.0 * leg + period_s * (tick + 1)))
            assert step is not None
            legs.move(step, np.zeros(CALIBRATION))
            noise = period_s * random.multivariate_normal(np.zeros(3), 0.1 * stated)
            pose = se2.retract(pose, period_s * velocity + noise)
        motion.scales = legs.look(pose, SURE, np.zeros(CALIBRATION))
    # known at both ends to 2 cm: a fifth of the variances that are there
    assert (legs.scales[SAID:] > 0.05).all()
    assert (legs.scales[SAID:] < 0.25).all()
    np.testing.assert_allclose(legs.scales[:SAID], np.exp(0.5))  # of which nothing was seen


def test_the_heading_is_less_sure_the_more_the_robot_turned_and_the_farther_it_went() -> None:
    def part(velocity: list[float]) -> FloatArray:
        motion = HeldVelocity(MotionNoise(idle_rad_per_sqrt_s=0.0, idle_m_per_sqrt_s=0.0))
        motion.advance(0)
        motion.hold(Odometry(0, np.array(velocity)))
        step = motion.advance(ns(1.0))
        assert step is not None
        return step.parts[1:SAID, 2, 2]

    noise = MotionNoise()
    by_rad, by_m = noise.turn_rad_per_sqrt_rad**2, noise.turn_rad_per_sqrt_m**2
    np.testing.assert_allclose(part([0.0, 0.0, -0.5]), [0.5 * by_rad, 0.0])
    np.testing.assert_allclose(part([0.3, 0.4, 0.0]), [0.0, 0.5 * by_m])
    np.testing.assert_allclose(part([0.3, 0.4, 0.5]), [0.5 * by_rad, 0.5 * by_m])


def held() -> HeldVelocity:
    motion = HeldVelocity(KNOWN_NOISE)
    for tick, velocity in enumerate([[0.5, 0.0, 0.0], [0.1, 0.2, 1.0], [0.3, 0.0, -0.5]]):
        motion.advance(ns(0.1 * tick))
        motion.hold(Odometry(ns(0.1 * tick), np.array(velocity)))
    motion.advance(ns(0.25))
    return motion


def test_what_was_held_is_remembered_for_a_second() -> None:
    motion = held()
    np.testing.assert_allclose(motion.before(0.0), [0.3, 0.0, -0.5])
    np.testing.assert_allclose(motion.before(0.1), [0.1, 0.2, 1.0])
    np.testing.assert_allclose(motion.before(0.9), [0.5, 0.0, 0.0])
    np.testing.assert_allclose(motion.recent(0.0), [0.3, 0.0, -0.5])
    np.testing.assert_allclose(motion.recent(0.05), [0.3, 0.0, -0.5])
    np.testing.assert_allclose(motion.recent(0.1), [0.2, 0.1, 0.25])
    np.testing.assert_allclose(motion.recent(0.25), [0.3, 0.08, 0.3])


def test_a_delay_moves_the_robot_later_by_as_much() -> None:
    late, plain = HeldVelocity(KNOWN_NOISE, 0.3), HeldVelocity(KNOWN_NOISE)
    poses = [np.zeros(3), np.zeros(3)]
    for motion, shift_s, which in ((plain, 0.0, 0), (late, 0.3, 1)):
        motion.advance(0)
        for tick in range(20):
            motion.hold(Odometry(ns(0.1 * tick), np.array([0.5, 0.0, np.sin(tick)])))
            step = motion.advance(ns(0.1 * (tick + 1)))
            if step is not None:
                poses[which] = se2.compose(poses[which], step.before_from_after)
        step = motion.advance(ns(2.0 + shift_s)) if shift_s else None
        if step is not None:
            poses[which] = se2.compose(poses[which], step.before_from_after)
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-9)


@pytest.mark.parametrize("kind", ["now", "sight", "compass"])
def test_a_view_and_its_derivative_agree(kind: str) -> None:
    motion = HeldVelocity(KNOWN_NOISE)
    views = Views(Config(), motion)
    motion.advance(0)
    motion.hold(Odometry(0, np.array([0.4, 0.1, 0.8])))
    motion.advance(ns(1.5))
    assert views.heard() == pytest.approx(Calibration().odometry_delay_sigma_s ** 2)
    assert views.heard() == 0.0
    _, known = prior(Config())
    extra = np.array([0.1, -0.1, 0.05, 0.02, 0.01, 0.015, -0.02, 0.1, 0.02, -0.01, 0.03, 0.05, 0.12, 0.2])

    def view_of(beside: FloatArray) -> View:
        if kind == "sight":
            return views.sight(beside, known)
        return views.now(beside) if kind == "now" else views.compass(beside)

    view, pose = view_of(extra), np.array([1.0, 2.0, 0.5])

    def about(beside: FloatArray) -> FloatArray:
        return se2.local(view.of(pose, extra), view_of(beside).of(pose, beside))

    places = [LATE - 5, LATE - 4, LATE - 3, EXTRA - 1]
    numeric = central_difference(about, extra)[:, places]
    # first order in a twist of 0.1 rad
    np.testing.assert_allclose(view.by_state[:, 3:][:, places], numeric, atol=0.06)
    np.testing.assert_allclose(view.back(view.of(pose, extra), extra), pose, atol=1e-12)
    covariance = np.diag([0.1, 0.2, 0.05])
    np.testing.assert_allclose(
        view.covariance(view.of_state(covariance, np.eye(EXTRA) * 0.01)), covariance + 2.0 * view.chance, atol=1e-12
    )


def test_motions_made_noisier_afterwards_are_those_of_a_noisier_odometry() -> None:
    scales = np.array([2.0, 0.5, 3.0, 1.0, 1.0])
    plain, noisy = HeldVelocity(KNOWN_NOISE), HeldVelocity(KNOWN_NOISE)
    noisy.scales = scales
    motions = []
    for held in (plain, noisy):
        held.advance(0)
        held.hold(Odometry(0, np.array([0.3, 0.05, 0.4])))
        motions.append(held.advance(ns(0.5)))
    one, other = motions
    assert one is not None
    assert other is not None
    made = as_noisy([one], scales)[0]
    np.testing.assert_allclose(made.covariance, other.covariance, rtol=1e-12)
    np.testing.assert_allclose(made.parts, other.parts, rtol=1e-12)
