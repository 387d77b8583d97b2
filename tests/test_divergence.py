import numpy as np
import pytest

from estimators.divergence import Restart
from estimators.motion import Increment, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor, PoseFactor
from fieldloc.pose import FloatArray

P3 = np.diag([0.1, 0.1, 0.05]) ** 2
PARAMETERS = len(OdometryCalibration())
THERE = np.array([3.0, -2.0, 1.0])


def at(pose: FloatArray, stamp_ns: int = 0) -> PoseFactor:
    return PoseFactor(stamp_ns, pose, P3)


def doubts(restart: Restart, pose: FloatArray, times: int = 1) -> list[bool]:
    """Whether each of some poses that disagree with the estimate restarts it."""
    return [restart.consider(at(pose), disagrees=True) is not None for _ in range(times)]


def test_the_last_of_enough_poses_that_agree_with_each_other_restarts_there() -> None:
    restart = Restart(4)
    assert doubts(restart, THERE, 3) == [False] * 3
    last = at(THERE + 0.01)
    assert restart.consider(last, disagrees=True) is last
    # and then all begins anew
    assert doubts(restart, THERE, 4) == [False] * 3 + [True]


def test_one_that_agrees_with_the_estimate_ends_the_doubt() -> None:
    restart = Restart(4)
    doubts(restart, THERE, 3)
    assert restart.consider(at(np.zeros(3)), disagrees=False) is None
    assert doubts(restart, THERE, 3) == [False] * 3


def test_poses_that_do_not_agree_with_each_other_never_restart() -> None:
    restart = Restart(2)
    for k in range(10):
        assert doubts(restart, THERE + [(-1.0) ** k, 0.0, 0.0]) == [False]


@pytest.mark.parametrize(("off_sigmas", "agree"), [(3.9, True), (4.1, False)])
def test_agreeing_is_four_sigmas_of_their_difference(off_sigmas: float, agree: bool) -> None:
    restart = Restart(2)
    doubts(restart, np.zeros(3))
    assert doubts(restart, np.array([off_sigmas * 0.1 * np.sqrt(2.0), 0.0, 0.0])) == [agree]


def test_what_is_no_whole_pose_neither_doubts_nor_confirms() -> None:
    restart = Restart(2)
    heading = HeadingFactor(0, 1.0, np.eye(1))
    assert doubts(restart, THERE) == [False]
    assert restart.consider(heading, disagrees=True) is None
    assert restart.consider(heading, disagrees=False) is None
    assert doubts(restart, THERE) == [True]


def test_the_doubted_pose_moves_and_widens_with_the_robot() -> None:
    motion = Increment(np.array([1.0, 0.2, 1.5]), np.diag([0.02, 0.02, 0.01]) ** 2, np.zeros((3, PARAMETERS)))
    restart = Restart(2)
    doubts(restart, THERE)
    restart.advance(motion)
    assert doubts(restart, se2.compose(THERE, motion.before_from_after)) == [True]
    doubts(restart, THERE)
    restart.advance(motion)
    assert doubts(restart, THERE) == [False]
    # a second of silence, and a pose a metre away agrees
    doubts(restart, np.zeros(3))
    restart.advance(Increment(np.zeros(3), np.diag([0.3, 0.3, 0.5]) ** 2, np.zeros((3, PARAMETERS))))
    assert doubts(restart, np.array([1.0, 0.0, 0.0])) == [True]


def test_forgetting_ends_the_doubt() -> None:
    restart = Restart(2)
    doubts(restart, THERE)
    restart.forget()
    assert doubts(restart, THERE, 2) == [False, True]
