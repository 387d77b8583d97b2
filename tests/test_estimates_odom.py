import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.config import MotionNoise
from estimators.motion import HeldVelocity
from fieldloc import pose as se2
from fieldloc.measurements import Compass, Odometry
from logs.odom import odom_from_robot

SECOND = 10**9


def one_by_one(measurements, stamps_ns):
    """What `estimators.motion` makes of the same odometry, asked stamp by stamp."""
    held, pose, out = HeldVelocity(MotionNoise()), np.zeros(3), []

    def advance(stamp_ns):
        motion = held.advance(stamp_ns)
        return pose if motion is None else se2.compose(pose, motion.before_from_after)

    events = sorted(
        [(one.stamp_ns, 0, one) for one in measurements] + [(ns, 1, None) for ns in stamps_ns], key=lambda e: e[:2]
    )
    for stamp_ns, _, odometry in events:
        pose = advance(stamp_ns)
        if odometry is None:
            out.append(pose)
        else:
            held.hold(odometry)
    return np.array(out)


@given(
    stamps_ms=st.lists(st.integers(0, 20_000), min_size=1, max_size=30),
    asked_ms=st.lists(st.integers(0, 25_000), min_size=1, max_size=30),
    data=st.data(),
)
@settings(deadline=None, max_examples=150)
def test_all_at_once_is_as_held_velocities_one_by_one(stamps_ms, asked_ms, data):
    velocities = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3)
    measurements = [Odometry(ms * 10**6, np.array(data.draw(velocities))) for ms in sorted(stamps_ms)]
    stamps_ns = np.array(sorted(asked_ms), dtype=np.int64) * 10**6
    difference = odom_from_robot(measurements, stamps_ns) - one_by_one(measurements, stamps_ns.tolist())
    difference[:, 2] = se2.wrap(difference[:, 2])
    assert difference == pytest.approx(0.0, abs=1e-9)


def test_a_velocity_is_held_for_two_seconds():
    odometry = [Odometry(SECOND, np.array([0.5, 0.0, 0.0]))]
    stamps_ns = np.array([0, SECOND, 2 * SECOND, 3 * SECOND, 9 * SECOND])
    assert odom_from_robot(odometry, stamps_ns)[:, 0] == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])


def test_without_odometry_the_robot_stays_at_the_origin():
    assert np.array_equal(odom_from_robot([Compass(5, 1.0, 0.1)], np.array([1, 2, 3])), np.zeros((3, 3)))


def test_nobody_asks_is_no_pose():
    assert odom_from_robot([Odometry(5, np.ones(3))], np.zeros(0, dtype=np.int64)).shape == (0, 3)
