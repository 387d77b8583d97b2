"""What a sensor's scans get wrong in the same way all the time: what was simulated is learned, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_distortion import KNOWN, PERFECT, DistortionPrior, ScanDistortion
from fieldloc.scan_mixture import ScanMixture
from fieldloc.scan_noise import NoisePrior
from fieldloc.scan_noises import LearnedNoise

POSITIONS = np.array([[4.0, 1.0], [3.0, -2.5], [-2.5, 3.0], [0.5, -4.0], [3.5, 3.2], [-3.0, -3.0], [0.4, 3.6]])
FIELD = FieldMap(
    "seven",
    np.zeros((0, 2, 2)),
    np.zeros((0, 3)),
    tuple(Landmark(str(i), place, 0.1, np.zeros((2, 2))) for i, place in enumerate(POSITIONS)),
)
NEWS = ErrorCorrelation(0.0, 0.0, 0.0, 0.0)
MOUNT = np.array([0.1, 0.0, 0.4])
CAMERA = ScanDistortion(0.03, 1.0, -0.03, 0.02)


def scan_of(
    stamp_ns: int, pose: FloatArray, distortion: ScanDistortion, random: np.random.Generator, widest_rad: float
) -> LandmarkScan:
    """What is in view, with the errors that it states beside the distortion."""
    at = se2.apply(se2.inverse(se2.compose(pose, MOUNT)), POSITIONS)
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    rows = np.flatnonzero(np.abs(seen[:, 1]) < widest_rad)
    seen = seen[rows]
    seen = distortion.added(seen)
    sigmas = np.stack([0.03 * seen[:, 0], np.full(len(rows), 0.01)], axis=-1)
    seen = seen + sigmas * random.standard_normal(seen.shape)
    return LandmarkScan(stamp_ns, tuple(map(str, rows)), seen, sigmas[:, :, None] ** 2 * np.eye(2), MOUNT)


def walked(
    distortion: ScanDistortion,
    prior: DistortionPrior,
    seed: int = 1,
    scans: int = 150,
    widest_rad: float = 0.6,
    labelled: bool = True,
) -> tuple[LearnedNoise, MixtureBuilder, list[ScanMixture]]:
    """Scans half a second apart of who is told the pose to a few centimetres."""
    random = np.random.default_rng(seed)
    builder = MixtureBuilder(FIELD, correlation=NEWS, noise=NoisePrior(), distortion=prior)
    mixtures = []
    for k in range(scans):
        pose = np.array([*random.uniform(-1.5, 1.5, 2), random.uniform(-3, 3)])
        scan = scan_of(k * 500_000_000, pose, distortion, random, widest_rad)
        if not labelled:
            scan = replace(scan, labels=(None,) * len(scan.labels))
        mixture = builder.build(scan)
        if mixture is not None:
            assert isinstance(mixture, ScanMixture)
            mixtures.append(mixture)
            builder.remember(scan, mixture, se2.retract(pose, 0.03 * random.standard_normal(3)))
    (one,) = builder.scan_noises()
    return one, builder, mixtures


def test_a_camera_s_depths_scale_and_slant_are_learned() -> None:
    one, _, _ = walked(CAMERA, DistortionPrior())
    off = np.array(one.distortion) - CAMERA
    assert (np.abs(off) < 3.5 * one.distortion_sigmas).all()
    assert (one.distortion_sigmas < [0.03, 0.3, 0.05, 0.05]).all()


def test_a_laser_is_not_taken_for_a_camera() -> None:
    one, _, _ = walked(PERFECT, DistortionPrior(), widest_rad=np.pi)
    assert (np.abs(one.distortion) < 3.5 * one.distortion_sigmas).all()
    assert one.distortion_sigmas[1] < 0.02


def test_scans_without_labels_teach_the_same() -> None:
    one, other = (walked(CAMERA, DistortionPrior(), labelled=labelled)[0] for labelled in (True, False))
    np.testing.assert_allclose(one.distortion, other.distortion, atol=float(one.distortion_sigmas.max()))


def test_of_sensors_drawn_from_the_prior_the_distortion_is_as_far_off_as_it_says() -> None:
    off, prior = [], DistortionPrior()
    for seed in range(24):
        true = ScanDistortion(*np.random.default_rng(seed).normal(prior.means(), prior.sigmas()).tolist())
        one, _, _ = walked(true, prior, seed, scans=60)
        off.append((np.array(one.distortion) - true) / one.distortion_sigmas)
    # of 96 numbers 92 are within two sigmas, give or take two; scans far from linear may cost as many again
    assert (np.abs(off) < 2.0).sum() >= 84
    assert (np.abs(np.mean(off, axis=0)) < 0.7).all()  # 24 standard normals: 0 +- 0.2


def test_what_is_known_is_not_learned() -> None:
    known = replace(KNOWN, log_scale=0.03, depth=1.0)
    one, _, _ = walked(CAMERA, known, scans=40)
    assert one.distortion == (0.03, 1.0, 0.0, 0.0)


def test_removing_a_distortion_gives_back_what_was_there() -> None:
    seen = np.array([[2.0, 0.4], [3.0, -0.7], [1.0, 0.0]])
    bent = seen.copy()
    bent[:, 0] *= np.exp(0.05 + np.log(np.cos(seen[:, 1])) + 0.02 * np.sin(seen[:, 1]))
    bent[:, 1] *= 1.04
    distortion = ScanDistortion(0.05, 1.0, 0.02, 0.04)
    np.testing.assert_allclose(distortion.removed(bent), seen, rtol=1e-12)
    np.testing.assert_allclose(distortion.added(seen), bent, rtol=1e-12)
    assert PERFECT.removed(seen) is seen


def test_a_bearing_to_the_back_has_no_depth_but_stays_finite() -> None:
    removed = ScanDistortion(depth=1.0).removed(np.array([[2.0, 1.5], [2.0, 3.0], [2.0, -np.pi / 2]]))
    assert np.isfinite(removed).all()
    assert removed[:, 0] == pytest.approx(2.0 / np.cos(np.deg2rad(75.0)))


def test_an_early_scan_is_read_anew_with_what_was_learned_later() -> None:
    """Its solutions keep their ids, so that a choice among them stays the same."""
    _, builder, mixtures = walked(CAMERA, DistortionPrior())
    early = next(one for one in mixtures if len(one.solutions().ids))
    again = builder.relearned(early)
    assert isinstance(again, ScanMixture)
    truth = early.measured[:, 0] / np.exp(CAMERA.log_scale + np.log(np.cos(early.measured[:, 1])))
    late_off, early_off = (np.abs(one.scan.range_bearing[:, 0] - truth).max() for one in (again, early))
    assert late_off < 0.3 * early_off
    np.testing.assert_array_equal(again.measured, early.measured)
    for k in range(len(early.solutions().ids)):
        np.testing.assert_array_equal(again.matches(k), early.matches(k))
