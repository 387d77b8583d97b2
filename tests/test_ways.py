"""A chain's motions in stages lead where they lead one by one."""

import numpy as np

from estimators.motion import CALIBRATION, STANDSTILL, Increment
from estimators.ways import Ways
from fieldloc import pose as se2


def test_stages_and_the_ways_to_and_from_stops_are_the_motions_one_after_the_other() -> None:
    random = np.random.default_rng(5)
    motions = []
    for _ in range(90):
        root = 0.1 * random.standard_normal((3, 3))
        motions.append(Increment(random.normal(0.0, 0.3, 3), root @ root.T, random.standard_normal((3, CALIBRATION))))
    ways = Ways.of(motions, np.array([3, 4, 70]))
    stops = ways.stops.tolist()
    assert {0, 3, 4, 70, 90} <= set(stops)
    assert max(np.diff(stops)) <= 32
    for stage, begin, end in zip(ways.stages, stops[:-1], stops[1:], strict=True):
        whole = STANDSTILL
        for node in range(begin, end):
            left = STANDSTILL
            for motion in motions[node:end]:
                left = left.then(motion)
            np.testing.assert_allclose(ways.moved[node], whole.before_from_after, atol=1e-9)
            np.testing.assert_allclose(ways.by_calibration[node], whole.by_calibration, atol=1e-9)
            if node > begin:
                assert ways.since[node] == stops.index(begin)
                np.testing.assert_allclose(se2.local(ways.left[node], left.before_from_after), 0.0, atol=1e-9)
                np.testing.assert_allclose(ways.left_by_calibration[node], left.by_calibration, atol=1e-9)
            whole = whole.then(motions[node])
        np.testing.assert_allclose(stage.before_from_after, whole.before_from_after, atol=1e-9)
        np.testing.assert_allclose(stage.covariance, whole.covariance, atol=1e-9)


def test_a_chain_of_one_node_has_no_stages() -> None:
    ways = Ways.of([], np.array([0]))
    assert ways.stages == ()
    assert ways.stops.tolist() == [0]
