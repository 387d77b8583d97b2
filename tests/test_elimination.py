"""The order in which gtsam eliminates a chain that shares a few numbers."""

import gtsam
import numpy as np
import pytest

from estimators.graph.elimination import elimination_order


def _keys(order: gtsam.Ordering) -> list[int]:
    return [order.at(k) for k in range(order.size())]


@pytest.mark.parametrize("count", [1, 2, 3, 8, 37])
def test_every_pose_is_eliminated_once(count: int) -> None:
    assert sorted(_keys(elimination_order(np.arange(count), 0, count))) == list(range(count))


def test_every_second_pose_that_is_left_goes_next() -> None:
    assert _keys(elimination_order(np.zeros(7, dtype=np.intp), 0, 7)) == [0, 2, 4, 6, 1, 5, 3]


def test_poses_of_a_knot_go_before_it_and_knots_that_no_pose_knows_are_there_too() -> None:
    knots = np.array([0, 0, 0, 1, 1, 4])
    keys = _keys(elimination_order(knots, 5, 6))
    assert sorted(keys) == [*range(6), *range(7, 12)]
    # the inner poses of a knot first; the last one goes with its knot
    assert keys[:3] == [0, 1, 3]
    assert [key for key in keys if key in (7, 8, 9, 10, 11)] == [7, 9, 11, 8, 10]
    assert keys.index(2) < keys.index(7) < keys.index(4)
