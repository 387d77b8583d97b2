"""What of an estimator's ambiguities is kept."""

import numpy as np
import pytest
from two_minds import COVARIANCE, ambiguity

from estimators.base import Ambiguity, Hypothesis
from logs.kept import KeptAmbiguities

MS = 10**6


def kept(ambiguities: list[Ambiguity], most: int = 10_000) -> list[Ambiguity]:
    keeping = KeptAmbiguities(most)
    for one in ambiguities:
        keeping.take(one)
    return list(keeping.all())


def test_what_does_not_change_is_kept_ten_times_a_second() -> None:
    stamps = [one.stamp_ns for one in kept([ambiguity(i * 30 * MS, {1: 0.6, 2: 0.4}, 0.4) for i in range(96)])]
    assert stamps == [*range(0, 95 * 30 * MS, 120 * MS), 95 * 30 * MS]  # the last always


@pytest.mark.parametrize(
    "change",
    [
        ambiguity(MS, {1: 0.4, 2: 0.6}, 0.4),
        ambiguity(MS, {1: 0.6, 2: 0.4}, 0.46),
        ambiguity(MS, {1: 0.54, 2: 0.4}, 0.4, lost=0.06),
        ambiguity(MS, {1: 0.53, 2: 0.47}, 0.4),
        ambiguity(MS, {1: 0.6, 2: 0.3, 3: 0.1}, 0.4),
        ambiguity(MS, {}, 0.4),
    ],
    ids=["best", "mirrored", "lost", "weights", "split", "none"],
)
def test_a_change_is_kept_at_once(change: Ambiguity) -> None:
    before, after = ambiguity(0, {1: 0.6, 2: 0.4}, 0.4), ambiguity(2 * MS, {1: 0.6, 2: 0.4}, 0.4)
    assert [one.stamp_ns for one in kept([before, change, after, ambiguity(3 * MS, {1: 0.6, 2: 0.4}, 0.4)])] == [
        0, MS, 2 * MS, 3 * MS,
    ]  # fmt: skip


def test_of_two_at_one_stamp_the_last_counts() -> None:
    (one,) = kept([ambiguity(0, {1: 0.6, 2: 0.4}), ambiguity(0, {1: 0.61, 2: 0.39})])
    assert one.hypotheses[0].weight == 0.61


def test_what_changes_little_is_not_news() -> None:
    few = [ambiguity(i * MS, {1: 0.6 - 0.001 * i, 2: 0.4 + 0.001 * i}, 0.4) for i in range(10)]
    assert [one.stamp_ns for one in kept(few)] == [0, 9 * MS]  # the last always


def test_of_many_hypotheses_the_likeliest_are_kept() -> None:
    weights = {track: 2.0 ** -(1 + track) for track in range(100)}
    (one,) = kept([ambiguity(0, weights)])
    assert [h.track for h in one.hypotheses] == list(range(9))  # 2^-10 is below 0.001
    (one,) = kept([ambiguity(0, dict.fromkeys(range(100), 0.01))])
    assert len(one.hypotheses) == 32
    (one,) = kept([ambiguity(0, {7: 1e-9}, lost=1.0)])
    assert [h.track for h in one.hypotheses] == [7]


def test_no_estimators_arrays_are_kept_alive() -> None:
    poses = np.zeros((1000, 3))
    (one,) = kept([Ambiguity(0, (Hypothesis(1.0, poses[3], COVARIANCE, 1),), 0.0, 0.0)])
    poses[:] = 9.0
    assert one.hypotheses[0].pose.base is None
    assert not one.hypotheses[0].pose.any()


def test_a_log_of_any_length_fits() -> None:
    flapping = [ambiguity(i * 33 * MS, {i % 2: 0.6, 1 - i % 2: 0.4}, 0.4) for i in range(5000)]
    some = kept(flapping, most=300)
    assert 75 <= sum(1 + len(one.hypotheses) for one in some) <= 300 + 3  # and the last
    gaps = np.diff([one.stamp_ns for one in some])
    assert gaps.max() < 0.1 * flapping[-1].stamp_ns  # from all of it
    assert some[-1].stamp_ns == flapping[-1].stamp_ns
