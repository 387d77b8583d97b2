"""Motions of a whole odometry at once."""

import numpy as np
import pytest
from walks import ns

from estimators.config import MotionNoise
from estimators.motion import HeldVelocity, Increment
from estimators.said import Said
from fieldloc.measurements import Odometry

NOISE = MotionNoise(max_hold_s=0.5)


def _one_by_one(said: list[Odometry], stamps_ns: list[int], delay_s: float) -> list[Increment]:
    """Between the stamps, by the online way: messages and stamps in order."""
    held, out, pending = HeldVelocity(NOISE, delay_s), [], None
    events = [(one.stamp_ns, 0, one) for one in said] + [(stamp, 1, None) for stamp in stamps_ns]
    events.sort(key=lambda event: event[:2])
    for stamp_ns, _, message in events:
        motion = held.advance(stamp_ns)
        if motion is not None:
            pending = motion if pending is None else pending.then(motion)
        if message is not None:
            held.hold(message)
        elif pending is not None:
            out.append(pending)
            pending = None
    return out[1:]  # the first leads to the first stamp


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("delay_s", [0.0, 0.07])
def test_they_are_those_that_come_one_by_one(stated: bool, delay_s: float) -> None:
    random = np.random.default_rng(3)
    covariance = np.diag([0.1, 0.2, 0.3]) if stated else None
    # bursts, gaps longer than a velocity is believed, and stamps that come twice
    times = np.sort(np.concatenate([random.uniform(0.0, 3.0, 40), random.uniform(5.0, 6.0, 30), [2.0, 2.0]]))
    said = [Odometry(ns(float(t)), random.normal(0.0, 0.5, 3), covariance) for t in times]
    # of the first message nobody knows how long it was to hold, so how it is cut into parts makes a difference
    stamps_ns = sorted({ns(float(t)) for t in random.uniform(times[4] + delay_s, 7.0, 25)})
    online = _one_by_one(said, stamps_ns, delay_s)
    whole = Said(NOISE, delay_s)
    for one in said:
        whole.advance(one.stamp_ns)
        whole.hold(one)
    at_once = whole.motions(stamps_ns)
    assert len(online) == len(at_once) == len(stamps_ns) - 1
    for ours, theirs in zip(at_once, online, strict=True):
        np.testing.assert_allclose(ours.before_from_after, theirs.before_from_after, atol=1e-12)
        # one by one, what is late is cut at the stamps of messages too: a third order of each part's turn
        rtol, atol = (0.02, 2e-5) if delay_s > 0.0 else (1e-9, 1e-12)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=rtol, atol=atol)
        np.testing.assert_allclose(ours.by_calibration, theirs.by_calibration, atol=1e-12)
        np.testing.assert_allclose(ours.parts, theirs.parts, rtol=rtol, atol=atol)


def test_a_stamp_that_runs_backwards_is_not_reached_and_an_older_message_is_not_believed() -> None:
    whole = Said(NOISE, 0.0)
    assert whole.advance(ns(1.0)) == ns(1.0)
    whole.hold(Odometry(ns(1.0), np.array([1.0, 0.0, 0.0])))
    assert whole.advance(ns(0.5)) == ns(1.0)
    whole.hold(Odometry(ns(0.5), np.array([-1.0, 0.0, 0.0])))
    (motion,) = whole.motions([ns(1.0), ns(1.1)])
    np.testing.assert_allclose(motion.before_from_after, [0.1, 0.0, 0.0], atol=1e-9)
