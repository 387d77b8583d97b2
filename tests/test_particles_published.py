"""The published filters run, start, follow, and have the particles that they are published with."""

import numpy as np
import pytest
from walks import FIELD, ns, scan, velocities, walk

from estimators.base import Ambiguous, MixtureEstimator
from estimators.config import Config
from estimators.particles.presets import amcl_style, bhuman_style
from estimators.registry import ONLINE
from fieldloc.measurements import Odometry
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.regions import anywhere

PUBLISHED = ("amcl-style", "bhuman-style")


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_published_filter_finds_the_robot_and_follows_it(name: str) -> None:
    off = []
    for seed in range(3):
        random = np.random.default_rng(seed)
        commands = velocities(300)
        truth = walk(np.array([[0.5, -0.5, 1.0]]), commands, 0.1, random)[:, 0]
        estimator, builder = ONLINE[name](Config()), MixtureBuilder(FIELD)
        assert isinstance(estimator, MixtureEstimator)
        assert isinstance(estimator, Ambiguous)
        estimator.start_in(anywhere(FIELD), 0)
        for k, command in enumerate(commands):
            estimator.predict(Odometry(ns(0.1 * k), command))
            if k % 4 == 1:
                measured = scan(ns(0.1 * k), truth[k], random)
                seen = builder.build(measured)
                assert seen is not None
                estimator.observe(seen)
                builder.remember(measured, seen, None)
        estimator.advance(ns(30.0))
        estimate, said = estimator.estimate(), estimator.ambiguity()
        assert estimate is not None
        assert said is not None
        assert sum(one.weight for one in said.hypotheses) + said.lost == pytest.approx(1.0)
        off.append(float(np.hypot(*(estimate.pose - truth[-1])[:2])))
    assert np.median(off) < 0.4  # labelled posts of 5 cm: who is further off is lost


def test_amcl_has_as_many_particles_as_nav2_gives_it() -> None:
    estimator = amcl_style(Config())
    estimator.start_in(anywhere(FIELD), 0)
    assert estimator._cloud is not None
    assert len(estimator._cloud) == 2000


def test_bhuman_has_a_dozen() -> None:
    estimator = bhuman_style(Config())
    estimator.start_in(anywhere(FIELD), 0)
    builder, random = MixtureBuilder(FIELD), np.random.default_rng(0)
    for k in range(20):
        seen = builder.build(scan(ns(0.1 * k), np.array([0.5, -0.5, 1.0]), random))
        assert seen is not None
        estimator.observe(seen)
    assert len(estimator._poses) == 12
