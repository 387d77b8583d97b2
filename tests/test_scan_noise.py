"""How noisy a sensor's scans are, learned from them: what was simulated comes out, whatever was stated."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_noise import AS_STATED, UNLEARNED, NoisePrior, ScanNoise
from fieldloc.scan_noise_learning import NoiseLearner, ScanErrors
from fieldloc.scan_noises import LearnedNoise

POSITIONS = np.array([[4.0, 1.0], [3.0, -2.5], [-2.5, 3.0], [0.5, -4.0], [3.5, 3.2], [-3.0, -3.0]])
FIELD = FieldMap(
    "six",
    np.zeros((0, 2, 2)),
    np.zeros((0, 3)),
    tuple(Landmark(str(i), place, 0.1, np.zeros((2, 2))) for i, place in enumerate(POSITIONS)),
)
NEWS = ErrorCorrelation(0.0, 0.0, 0.0, 0.0)
MOUNT = np.array([0.1, 0.0, 0.4])


def scan_of(
    stamp_ns: int,
    pose: FloatArray,
    noise: ScanNoise,
    random: np.random.Generator,
    count: int = 4,
    labelled: bool = True,
) -> LandmarkScan:
    which = random.permutation(len(POSITIONS))[:count]
    at = se2.apply(se2.inverse(se2.compose(pose, MOUNT)), POSITIONS[which])
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    sigmas = np.stack([0.05 * seen[:, 0], np.full(count, 0.02)], axis=-1)
    own = np.sqrt([noise.own_range, noise.own_bearing]) * random.standard_normal((count, 2))
    shared = np.sqrt([noise.shared_range, noise.shared_bearing]) * random.standard_normal(2)
    labels = tuple(str(i) if labelled else None for i in which)
    return LandmarkScan(stamp_ns, labels, seen + sigmas * (own + shared), sigmas[:, :, None] ** 2 * np.eye(2), MOUNT)


def learned(
    noise: ScanNoise,
    prior: NoisePrior,
    seed: int = 1,
    scans: int = 400,
    count: int = 4,
    wrong: float = 0.0,
    labelled: bool = True,
) -> LearnedNoise:
    """From scans half a second apart, told the pose to a few centimetres."""
    random = np.random.default_rng(seed)
    builder = MixtureBuilder(FIELD, correlation=NEWS, noise=prior)
    for k in range(scans):
        pose = np.array([*random.uniform(-1.5, 1.5, 2), random.uniform(-3, 3)])
        scan = scan_of(k * 500_000_000, pose, noise, random, count, labelled)
        if random.random() < wrong:
            seen = scan.range_bearing.copy()
            seen[0] *= [1.15, 1.0]
            scan = replace(scan, range_bearing=seen)
        mixture = builder.build(scan)
        assert mixture is not None
        builder.remember(scan, mixture, se2.retract(pose, 0.03 * random.standard_normal(3)))
    (one,) = builder.scan_noises()
    return one


SIMULATED = [ScanNoise(1.0, 1.0, 0.0, 0.0), ScanNoise(0.4, 0.35, 0.4, 0.65), ScanNoise(3.0, 2.0, 0.0, 0.0)]


@pytest.mark.parametrize("noise", SIMULATED)
def test_what_was_simulated_is_learned_and_how_sure_that_is(noise: ScanNoise) -> None:
    one = learned(noise, NoisePrior())
    found, true = np.array(astuple(one.noise)), np.array(astuple(noise))
    off = np.log(found[:2] / true[:2]) / one.log_sigmas[:2]
    assert (np.abs(off) < 3.5).all()
    assert (one.log_sigmas[:2] < 0.15).all()
    if noise.shared_range > 0.0:
        assert abs(np.log(found[2] / true[2])) < 3.0 * one.log_sigmas[2]
    else:
        assert found[2] < 0.1
    np.testing.assert_array_equal(one.robot_from_sensor, MOUNT)


def test_over_many_seeds_the_shares_are_as_far_off_as_they_say() -> None:
    noise = ScanNoise(0.6, 0.5, 0.2, 0.5)
    off = []
    for seed in range(40):
        one = learned(noise, NoisePrior(), seed, scans=150)
        found = np.array(astuple(one.noise))
        off.append(np.log(found[:2] / [noise.own_range, noise.own_bearing]) / one.log_sigmas[:2])
    # mean of 40 standard normals: 0 +- 0.16; their spread: 1 +- 0.11; four of these, and the first scans' rough steps
    assert (np.abs(np.mean(off, axis=0)) < 0.8).all()
    assert (np.std(off, axis=0) < 1.5).all()


def test_wrong_ones_among_them_are_not_taken_for_noise() -> None:
    noise = ScanNoise(0.3, 0.3, 0.0, 0.0)
    one = learned(noise, NoisePrior(), wrong=0.05)
    assert one.noise.own_range < 0.6


def test_scans_without_labels_teach_the_same() -> None:
    noise = ScanNoise(0.4, 0.4, 0.0, 0.0)
    one, other = (learned(noise, NoisePrior(), labelled=labelled) for labelled in (True, False))
    np.testing.assert_allclose(astuple(one.noise)[:2], astuple(other.noise)[:2], rtol=0.1)


def test_the_sides_of_one_landmark_teach_nothing() -> None:
    one = learned(ScanNoise(0.1, 0.1), NoisePrior(), count=1)
    assert one.scans == 0
    assert one.noise.own_range == pytest.approx(1.0)


def test_a_bearing_is_as_uncertain_as_stated_even_where_landmarks_agree() -> None:
    """Within a scan nothing shows by how much all of it is turned."""
    one = learned(ScanNoise(1.0, 0.4, 0.0, 0.6), NoisePrior())
    assert one.noise.own_bearing + one.noise.shared_bearing == pytest.approx(1.0, abs=0.05)


def test_ranges_are_as_uncertain_as_stated_where_neighbours_agree_and_more_is_not_seen() -> None:
    """Two landmarks side by side show their own errors, not what both of them share."""
    random = np.random.default_rng(4)
    learner = NoiseLearner(NoisePrior())
    bearings, range_m, sigmas = np.array([0.0, 0.06]), 3.0, np.array([0.15, 0.02])
    c, s, none = np.cos(bearings), np.sin(bearings), np.zeros(2)
    jacobian = np.stack(
        [np.stack([-c, -s, none], axis=-1), np.stack([s / range_m, -c / range_m, none - 1.0], axis=-1)], axis=1
    )
    for _ in range(100):
        error = 0.5 * sigmas * (random.standard_normal((2, 2)) + 3**0.5 * random.standard_normal(2))
        learner.learn(ScanErrors(error, jacobian, np.tile(np.diag(sigmas**2), (2, 1, 1)), np.zeros((4, 4))), 1.0)
    assert learner.noise.own_range < 0.5
    assert 0.9 < learner.noise.own_range + learner.noise.shared_range < 1.3


def test_nobody_is_believed_to_be_far_better_than_he_says() -> None:
    one = learned(ScanNoise(0.002, 0.002, 0.0, 0.0), NoisePrior())
    assert one.noise.own_range == one.noise.own_bearing == pytest.approx(0.05)


def test_who_takes_the_log_at_its_word_learns_nothing() -> None:
    random = np.random.default_rng(2)
    builder = MixtureBuilder(FIELD, correlation=NEWS, noise=UNLEARNED)
    scan = scan_of(0, np.zeros(3), AS_STATED, random)
    mixture = builder.build(scan)
    assert mixture is not None
    builder.remember(scan, mixture, np.zeros(3))
    assert builder.scan_noises() == ()


def test_a_scan_says_what_its_sensor_was_found_to_be() -> None:
    """Its fix is as uncertain as the noise that was simulated makes it, not as stated."""
    random = np.random.default_rng(3)
    noise = ScanNoise(0.3, 0.3, 0.0, 0.0)
    builder, fresh = (
        MixtureBuilder(FIELD, correlation=NEWS, noise=NoisePrior()),
        MixtureBuilder(FIELD, correlation=NEWS),
    )
    for k in range(200):
        pose = np.array([*random.uniform(-1.5, 1.5, 2), random.uniform(-3, 3)])
        scan = scan_of(k * 500_000_000, pose, noise, random)
        mixture = builder.build(scan)
        assert mixture is not None
        builder.remember(scan, mixture, pose)
    scan = scan_of(10**12, np.zeros(3), noise, random)
    sure, unsure = builder.build(scan), fresh.build(scan)
    assert sure is not None
    assert unsure is not None
    ratio = sure.solutions().covariances[0][:2, :2] / unsure.solutions().covariances[0][:2, :2]
    assert np.diagonal(ratio) == pytest.approx([0.35, 0.35], abs=0.12)
