"""The least error that there can be, and who comes near it."""

import numpy as np
import pytest

from benchmarks import bounds
from benchmarks.__main__ import main
from benchmarks.bounds import ESTIMATORS, KNOWN, SETTINGS, ratio, walk
from fieldloc import pose as se2


def test_online_and_batch_bounds_agree_where_there_is_nothing_to_come() -> None:
    one = walk(0, 4.0)
    np.testing.assert_allclose(one.online[-1], one.batch[-1], rtol=1e-9)
    later = np.diagonal(one.online - one.batch, axis1=1, axis2=2)[5:-5]
    assert (later > 0.0).all()


def test_a_scan_alone_knows_as_much_as_its_derivatives_say() -> None:
    pose, step = np.array([0.3, -0.2, 1.0]), 1e-6
    jacobian = np.stack(
        [
            (bounds.range_bearing(se2.retract(pose, step * axis)) - bounds.range_bearing(pose)) / step
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    weight = np.linalg.inv(bounds.SEEN)
    expected = sum(one.T @ weight @ one for one in jacobian)
    np.testing.assert_allclose(bounds.information(pose), expected, rtol=1e-4)
    assert walk(0, 1.0).online[0] == pytest.approx(np.linalg.inv(bounds.information(walk(0, 1.0).poses[0])))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_who_knows_the_model_is_at_the_bound(estimator: str) -> None:
    # 300 scans, of which some 100 are independent: a ratio of 1 to about 6 %
    position, heading = ratio([walk(seed, 15.0) for seed in range(4)], estimator, KNOWN)
    assert 0.8 < position < 1.2
    assert 0.8 < heading < 1.2


def test_who_believes_less_than_there_is_is_above_it() -> None:
    walks = [walk(seed, 15.0) for seed in range(2)]
    assert ratio(walks, "mixture", SETTINGS["all as shipped"])[0] > 1.05 * ratio(walks, "mixture", KNOWN)[0]


def test_it_prints_its_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bounds", "--seeds", "1", "--duration", "3", "--settings", "as known"]) == 0
    text = capsys.readouterr().out
    assert [word for word in (*ESTIMATORS, "as known") if word not in text] == []


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "most"), [("ekf", 1.1), ("mixture", 1.1), ("smooth", 1.05)])
def test_over_many_walks_hardly_anything_is_lost(estimator: str, most: float) -> None:
    assert max(ratio([walk(seed, 40.0) for seed in range(20)], estimator, KNOWN)) < most
