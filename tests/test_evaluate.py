import json

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Truth
from fieldloc.pose import FloatArray, rotation3, wrap
from logs.association import associate
from logs.evaluate import chi_square_quantile, evaluate, match
from logs.trajectory import Trajectory, from_estimates, from_truth

START_NS = 1248444187_156_000_000  # a stamp of today's clock: its doubles are 0.24 us apart


def stamps(seconds: FloatArray | list[float]) -> NDArray[np.int64]:
    return START_NS + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def walk(n: int, seed: int = 0, rate_hz: float = 10.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.1, n))
    x, y = np.cumsum(0.05 * np.cos(heading)), np.cumsum(0.05 * np.sin(heading))
    return Trajectory(stamps(np.arange(n) / rate_hz), np.column_stack([x, y, wrap(heading)]))


def noisy(truth: Trajectory, seed: int = 1, scale: float = 1.0) -> Trajectory:
    """Estimates of the truth whose claimed covariance is `scale` times that of the noise."""
    rng = np.random.default_rng(seed)
    n = len(truth)
    roots = rng.normal(size=(n, 3, 3)) * np.array([0.1, 0.05, 0.02])[:, None]
    error = np.einsum("nij,nj->ni", roots, rng.normal(size=(n, 3)))
    poses = truth.poses + error
    poses[:, 2] = wrap(poses[:, 2])
    return Trajectory(truth.stamps_ns, poses, scale * roots @ np.swapaxes(roots, 1, 2))


# -- trajectories ------------------------------------------------------------------------------------------------------


def test_a_trajectory_is_sorted_and_the_last_of_equal_stamps_wins() -> None:
    records = [Truth(ns, np.array([x, 0.0, 0.0])) for ns, x in ((30, 3.0), (10, 1.0), (20, 2.0), (10, 9.0))]
    trajectory = from_truth(records)
    assert trajectory.stamps_ns.tolist() == [10, 20, 30]
    assert trajectory.poses[:, 0].tolist() == [9.0, 2.0, 3.0]
    assert trajectory.covariances is None


def test_estimates_keep_each_their_own_covariance() -> None:
    estimates = [Estimate(ns, np.full(3, 0.1 * ns), ns * np.eye(3)) for ns in (3, 1, 2)]
    trajectory = from_estimates(estimates)
    assert trajectory.covariances is not None
    assert trajectory.covariances[:, 0, 0].tolist() == [1.0, 2.0, 3.0]


def test_no_estimates_are_an_empty_trajectory() -> None:
    assert len(from_estimates([])) == 0
    assert len(from_truth([])) == 0


def test_a_pose_that_is_not_finite_is_refused_with_its_stamp() -> None:
    records = [Truth(1_500_000_000, np.zeros(3)), Truth(2_500_000_000, np.array([0.0, np.nan, 0.0]))]
    with pytest.raises(FieldlocError, match=r"2\.500 s"):
        from_truth(records)


@pytest.mark.parametrize(
    ("stamps_ns", "poses", "covariances"),
    [
        ([1, 1], np.zeros((2, 3)), None),
        ([2, 1], np.zeros((2, 3)), None),
        ([1, 2], np.zeros((3, 3)), None),
        ([1, 2], np.zeros((2, 3)), np.zeros((2, 3))),
        ([1.0, 2.0], np.zeros((2, 3)), None),
    ],
)
def test_arrays_that_are_no_trajectory_are_refused(
    stamps_ns: list[int], poses: FloatArray, covariances: FloatArray | None
) -> None:
    with pytest.raises(ValueError):
        Trajectory(np.array(stamps_ns), poses, covariances)


@given(st.integers(-(2**62), 2**62))
def test_seconds_are_the_double_nearest_to_the_exact_decimal(stamp_ns: int) -> None:
    trajectory = Trajectory(np.array([stamp_ns]), np.zeros((1, 3)))
    sign, digits = ("-" if stamp_ns < 0 else ""), f"{abs(stamp_ns):010d}"
    assert trajectory.stamps_s()[0] == float(f"{sign}{digits[:-9]}.{digits[-9:]}")


# -- association -------------------------------------------------------------------------------------------------------


def line(stamps_ns: NDArray[np.int64]) -> Trajectory:
    return Trajectory(stamps_ns, np.zeros((len(stamps_ns), 3)))


def test_the_nearest_within_the_limit_is_taken_and_of_two_equally_near_the_earlier() -> None:
    tick_ns = 3_906_250  # 1/256 s, exact in binary
    truth = line(np.array([0, 100, 104, 200, 300]) * tick_ns)
    estimate = line(np.array([1, 102, 197, 302]) * tick_ns)
    of_estimate, of_truth = associate(estimate, truth)
    assert of_estimate.tolist() == [0, 1, 3]  # three ticks are more than 10 ms
    assert of_truth.tolist() == [0, 1, 4]


def test_each_pose_of_the_sparser_trajectory_finds_its_partner_whichever_it_is() -> None:
    dense, sparse = line(np.arange(0, 1000, 10) * 1_000_000), line(np.arange(3, 1000, 100) * 1_000_000)
    i, j = associate(dense, sparse)
    assert (i.tolist(), j.tolist()) == (list(range(0, 100, 10)), list(range(10)))
    j, i = associate(sparse, dense)
    assert (i.tolist(), j.tolist()) == (list(range(0, 100, 10)), list(range(10)))


def test_no_match_says_both_time_ranges() -> None:
    with pytest.raises(FieldlocError, match=r"estimates are at 0\.000 to 2\.000 s, truth is at 90\.000 to 91\.000 s"):
        evaluate(line(np.array([0, 1, 2]) * 10**9), line(np.array([90, 91]) * 10**9))


def test_nothing_to_compare_is_said() -> None:
    empty, some = line(np.array([], dtype=np.int64)), line(np.array([1, 2]))
    with pytest.raises(FieldlocError, match="no true poses"):
        evaluate(some, empty)
    with pytest.raises(FieldlocError, match="no estimates"):
        evaluate(empty, some)


def test_a_negative_limit_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="max_difference_s"):
        associate(walk(3), walk(3), -0.01)


grids = st.lists(st.integers(0, 400), min_size=1, max_size=40, unique=True).map(sorted)


@settings(max_examples=300)
@given(
    grids,
    grids,
    st.sampled_from([0.0, 0.001, 0.005, 0.01, 0.03]),
    st.sampled_from([0, START_NS]),
    st.sampled_from([1_000_000, 7_812_500]),  # the second is exact in binary: ties are ties
)
@example([1], [31], 0.03, 0, 1_000_000)  # 0.031 - 0.001 <= 0.03, but 0.001 < 0.031 - 0.03
def test_the_association_is_evos_also_on_ties_and_on_the_limit(
    a: list[int], b: list[int], limit_s: float, start_ns: int, tick_ns: int
) -> None:
    sync = pytest.importorskip("evo.core.sync")
    evo_trajectory = pytest.importorskip("evo.core.trajectory")
    estimate, truth = (line(start_ns + tick_ns * np.array(ticks, dtype=np.int64)) for ticks in (a, b))

    def as_evo(trajectory: Trajectory) -> object:
        """With its index as x, so that what evo kept can be read off."""
        xyz = np.column_stack([np.arange(len(trajectory)), np.zeros((len(trajectory), 2))])
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(trajectory), 1))
        return evo_trajectory.PoseTrajectory3D(xyz, quaternions, trajectory.stamps_s())

    try:
        true, estimated = sync.associate_trajectories(as_evo(truth), as_evo(estimate), max_diff=limit_s)
    except sync.SyncException:
        with pytest.raises(FieldlocError, match="no estimate lies within"):
            associate(estimate, truth, limit_s)
        return
    of_estimate, of_truth = associate(estimate, truth, limit_s)
    assert of_estimate.tolist() == estimated.positions_xyz[:, 0].tolist()
    assert of_truth.tolist() == true.positions_xyz[:, 0].tolist()


def test_errors_carry_the_stamps_of_the_sparser_trajectory() -> None:
    dense, sparse = walk(100, rate_hz=100.0), Trajectory(stamps([0.103, 0.504]), np.zeros((2, 3)))
    assert match(dense, sparse).stamps_ns.tolist() == sparse.stamps_ns.tolist()
    assert match(sparse, dense).stamps_ns.tolist() == sparse.stamps_ns.tolist()


# -- errors ------------------------------------------------------------------------------------------------------------


def test_known_errors_give_the_numbers_of_a_hand_calculation() -> None:
    truth = Trajectory(stamps([0, 1, 2]), np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, np.pi]]))
    estimate = Trajectory(stamps([0, 1, 2]), np.array([[3.0, 4, 0.1], [1, 0, -0.2], [2, 1, -np.pi + 0.3]]))
    metrics = evaluate(estimate, truth)
    assert metrics.ate_m.rmse == pytest.approx(np.sqrt((25 + 0 + 1) / 3))
    assert (metrics.ate_m.median, metrics.ate_m.mean, metrics.ate_m.max) == pytest.approx((1, 2, 5))
    assert metrics.heading_rad.rmse == pytest.approx(np.sqrt((0.01 + 0.04 + 0.09) / 3))
    assert (metrics.heading_rad.median, metrics.heading_rad.max) == pytest.approx((0.2, 0.3))
    assert metrics.rpe_frame is not None
    assert metrics.rpe_frame.rotation_rmse_rad == pytest.approx(np.sqrt((0.3**2 + 0.5**2) / 2))
    assert metrics.consistency is None


def test_half_turns_in_opposite_directions_are_nearly_the_same_motion() -> None:
    truth = Trajectory(stamps([0, 1]), np.array([[0.0, 0, 0], [0, 0, np.pi - 0.1]]))
    estimate = Trajectory(stamps([0, 1]), np.array([[0.0, 0, 0], [0, 0, -np.pi + 0.1]]))
    rpe = evaluate(estimate, truth).rpe_frame
    assert rpe is not None
    assert rpe.rotation_rmse_rad == pytest.approx(0.2)


def test_nothing_is_aligned_before_the_comparison() -> None:
    truth = walk(50)
    shifted = Trajectory(truth.stamps_ns, truth.poses + [0.3, 0.4, 0.0])
    metrics = evaluate(shifted, truth)
    assert metrics.ate_m.rmse == pytest.approx(0.5)
    assert metrics.rpe_frame is not None
    assert metrics.rpe_frame.translation_rmse_m == pytest.approx(0.0, abs=1e-12)


def test_one_match_has_errors_but_no_relative_errors_and_no_nan() -> None:
    truth = walk(20)
    metrics = evaluate(noisy(truth).select(slice(4, 5)), truth)
    assert (metrics.matched, metrics.rpe_frame, metrics.rpe_metre) == (1, None, None)
    text = json.dumps(metrics.to_dict(), allow_nan=False)
    assert json.loads(text)["rpe_frame_translation_rmse_m"] is None


def test_the_dictionary_has_the_same_keys_with_and_without_covariances() -> None:
    truth = walk(60)
    estimate = noisy(truth)
    bare = Trajectory(estimate.stamps_ns, estimate.poses)
    full, less = evaluate(estimate, truth).to_dict(), evaluate(bare, truth).to_dict()
    assert list(full) == list(less)
    assert None not in full.values()
    assert {key for key, value in less.items() if value is None} == {
        *("anees", "anees_low", "anees_high", "unusable_covariances"),
        *("within_3sigma", "within_3sigma_x", "within_3sigma_y", "within_3sigma_heading"),
    }


# -- consistency -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("probability", "degrees_of_freedom", "printed"), [(0.975, 3, 9.348), (0.025, 10, 3.247), (0.95, 100, 124.342)]
)
def test_chi_square_quantiles_are_those_of_the_printed_tables(
    probability: float, degrees_of_freedom: int, printed: float
) -> None:
    assert chi_square_quantile(probability, degrees_of_freedom) == pytest.approx(printed, abs=5e-4)


def test_anees_of_an_honest_estimate_lies_in_its_band_as_often_as_it_should() -> None:
    truth = walk(200)
    inside = 0
    for seed in range(200):
        c = evaluate(noisy(truth, seed), truth).consistency
        assert c is not None
        inside += c.anees_low <= c.anees <= c.anees_high
    assert 180 <= inside <= 199  # 190 expected, binomial standard deviation 3.1


def test_shares_within_three_sigma_of_an_honest_estimate_are_those_of_the_normal_distribution() -> None:
    truth = walk(20_000)
    c = evaluate(noisy(truth), truth).consistency
    assert c is not None
    sigma = np.sqrt(0.9973 * 0.0027 / 20_000)
    for share in (c.within_3sigma, *c.within_3sigma_axes):
        assert share == pytest.approx(0.9973, abs=4 * sigma)


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_a_covariance_too_small_or_too_large_shows_in_anees_by_its_factor(scale: float) -> None:
    truth = walk(2000)
    honest, other = (evaluate(noisy(truth, scale=s), truth).consistency for s in (1.0, scale))
    assert honest is not None
    assert other is not None
    assert other.anees == pytest.approx(honest.anees / scale)
    assert not other.anees_low <= other.anees <= other.anees_high


def test_nees_does_not_depend_on_the_axes_the_pose_is_given_in() -> None:
    truth = walk(30)
    estimate = noisy(truth)
    turn = rotation3(0.7)
    assert estimate.covariances is not None
    turned = Trajectory(
        estimate.stamps_ns,
        estimate.poses @ turn.T + [0, 0, 0.7],
        turn @ estimate.covariances @ turn.T,
    )
    turned_truth = Trajectory(truth.stamps_ns, truth.poses @ turn.T + [0, 0, 0.7])
    nees, nees_turned = match(estimate, truth).nees, match(turned, turned_truth).nees
    assert nees is not None
    assert nees_turned is not None
    np.testing.assert_allclose(nees_turned, nees, rtol=1e-6)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)])
def test_a_covariance_that_is_none_is_counted_and_never_inside(bad: FloatArray) -> None:
    truth = walk(10)
    estimate = noisy(truth, scale=100.0)
    assert estimate.covariances is not None
    estimate.covariances[3] = bad
    c = evaluate(estimate, truth).consistency
    assert c is not None
    assert (c.unusable, c.samples, c.within_3sigma) == (1, 9, 0.9)


def test_without_any_usable_covariance_there_is_no_consistency() -> None:
    truth = walk(10)
    estimate = Trajectory(truth.stamps_ns, truth.poses, np.zeros((10, 3, 3)))
    assert evaluate(estimate, truth).consistency is None


# -- coverage ----------------------------------------------------------------------------------------------------------


def test_the_time_before_the_first_estimate_and_in_a_gap_is_not_covered() -> None:
    truth = walk(1001)  # 100 s at 10 Hz
    kept = np.flatnonzero((np.arange(1001) >= 100) & ~((np.arange(1001) > 500) & (np.arange(1001) < 700)))
    metrics = evaluate(truth.select(kept), truth)
    assert metrics.time_to_first_estimate_s == pytest.approx(10.0)
    assert metrics.truth_covered == pytest.approx(0.7)
    assert (metrics.matched, metrics.estimates, metrics.truths) == (len(kept), len(kept), 1001)


def test_sparse_truth_with_gaps_of_its_own_counts_only_the_time_it_knows() -> None:
    seconds = np.concatenate([np.arange(0, 10.5, 0.5), np.arange(50, 60.5, 0.5)])
    truth = Trajectory(stamps(seconds), np.zeros((len(seconds), 3)))
    fast = stamps(np.arange(0, 55, 0.01))
    estimate = Trajectory(fast, np.zeros((len(fast), 3)))
    assert evaluate(estimate, truth).truth_covered == pytest.approx(0.75, abs=0.001)


def test_an_estimate_that_was_there_first_waited_for_nothing() -> None:
    truth = walk(100)
    metrics = evaluate(truth, truth.select(slice(50, None)))
    assert (metrics.time_to_first_estimate_s, metrics.truth_covered) == (0.0, 1.0)
