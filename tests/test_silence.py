"""Images that cease to come: the robot may have fallen, and no filter claims to know better."""

from collections.abc import Callable

import numpy as np
import pytest
from walks import ns

from estimators.base import Estimate, Estimator, Watching
from estimators.config import Calibration, Config
from estimators.ekf import Ekf
from estimators.mixture import MixtureFilter
from estimators.particles import ParticleFilter
from estimators.silence import FALLEN
from estimators.smoother import Smoother
from fieldloc.measurements import Odometry

FILTERS: tuple[Callable[[Config], Estimator], ...] = (Ekf, MixtureFilter, ParticleFilter, Smoother)
IMAGES_S = 1.0 / 15.0
STANDS = Config(calibration=Calibration(drift_sigma_mps=0.0, side_drift_sigma_mps=0.0))


def sigmas_m(made: Callable[[Config], Estimator], images_s: list[float], until_s: float) -> dict[float, float]:
    """By the tenth of a second, of a robot that stands, is told where and looks at those times."""
    estimator = made(STANDS)
    assert isinstance(estimator, Watching)
    estimator.start(Estimate(0, np.zeros(3), np.diag([0.02, 0.02, 0.02]) ** 2))
    out = {}
    for at_s in sorted([*images_s, *(0.1 * np.arange(1, round(10 * until_s) + 1)).round(1).tolist()]):
        if at_s in images_s:
            estimator.advance(ns(at_s))
            estimator.looked()
            continue
        estimator.predict(Odometry(ns(at_s), np.zeros(3)))
        now = estimator.estimate()
        assert now is not None
        out[at_s] = float(np.sqrt(0.5 * np.trace(now.covariance[:2, :2])))
    return out


@pytest.mark.parametrize("made", FILTERS)
def test_who_sees_no_image_for_a_second_may_have_fallen(made: Callable[[Config], Estimator]) -> None:
    found = sigmas_m(made, [k * IMAGES_S for k in range(60)], 9.0)  # the last one after 3.93 s
    assert found[4.8] < 0.1
    assert found[5.1] == pytest.approx(np.sqrt(FALLEN[0, 0]), rel=0.2)
    assert found[9.0] < 1.3 * found[5.1]  # it falls once


@pytest.mark.parametrize("made", FILTERS)
def test_who_waits_for_images_now_and_then_has_not_fallen(made: Callable[[Config], Estimator]) -> None:
    pauses = [k * IMAGES_S + 1.2 * (k // 20) for k in range(60)]
    assert sigmas_m(made, pauses, 9.0)[9.0] < 0.15


@pytest.mark.parametrize("made", FILTERS)
def test_who_has_seen_a_few_images_only_is_not_missing_them(made: Callable[[Config], Estimator]) -> None:
    assert sigmas_m(made, [k * IMAGES_S for k in range(10)], 5.0)[5.0] < 0.15
