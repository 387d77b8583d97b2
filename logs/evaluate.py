"""How good a trajectory is and whether its covariances are honest. `docs/metrics.md` defines every number.

Nothing is aligned first: a known field is an absolute frame, and a shift or a turn of the whole trajectory is an error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fieldloc.covariance import squared_mahalanobis
from fieldloc.pose import FloatArray, between, wrap
from logs.association import DEFAULT_MAX_DIFFERENCE_S, associate
from logs.metrics import Consistency, ErrorStatistics, Metrics, RelativeError
from logs.trajectory import IntArray, Trajectory

THREE_SIGMA_SHARE = 0.9973  # of a normal distribution within three standard deviations
ANEES_BAND = (0.025, 0.975)
RPE_PATH_M = 1.0
_MAX_GAP_NS = 1_000_000_000  # poses further apart than this do not cover the time between them


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """A trajectory's errors at the m pairs of an estimated and a true pose.

    stamps_ns: (m,) rising, of the sparser of the two trajectories. estimated, true: (m, 3) poses.
    error: (m, 3) estimate minus truth, metres and radians in field axes, heading wrapped.
    covariances: (m, 3, 3) as claimed by the estimate, nees: (m,) error^T P^-1 error, infinite where P is not positive
    definite; both None where the estimate claims nothing.
    """

    stamps_ns: IntArray
    estimated: FloatArray
    true: FloatArray
    error: FloatArray
    covariances: FloatArray | None
    nees: FloatArray | None


def match(estimate: Trajectory, truth: Trajectory, max_difference_s: float = DEFAULT_MAX_DIFFERENCE_S) -> Errors:
    """Errors at the pairs that `associate` finds, at least one. FieldlocError when there is none."""
    of_estimate, of_truth = associate(estimate, truth, max_difference_s)
    sparser_is_truth = len(estimate) > len(truth)
    stamps_ns = truth.stamps_ns[of_truth] if sparser_is_truth else estimate.stamps_ns[of_estimate]
    estimated, true = estimate.poses[of_estimate], truth.poses[of_truth]
    error = estimated - true
    error[:, 2] = wrap(error[:, 2])
    if estimate.covariances is None:
        return Errors(stamps_ns, estimated, true, error, None, None)
    covariances = estimate.covariances[of_estimate]
    return Errors(stamps_ns, estimated, true, error, covariances, _nees(error, covariances))


def evaluate(estimate: Trajectory, truth: Trajectory, max_difference_s: float = DEFAULT_MAX_DIFFERENCE_S) -> Metrics:
    """All metrics of an estimate. FieldlocError when no estimate lies within max_difference_s of a true pose."""
    return evaluate_errors(match(estimate, truth, max_difference_s), estimate, truth)


def evaluate_errors(errors: Errors, estimate: Trajectory, truth: Trajectory) -> Metrics:
    """As `evaluate`, from the errors that `match` found between the two."""
    return Metrics(
        ate_m=_statistics(np.hypot(errors.error[:, 0], errors.error[:, 1])),
        heading_rad=_statistics(np.abs(errors.error[:, 2])),
        rpe_frame=_relative_error(errors, np.arange(len(errors.error))),
        rpe_metre=_relative_error(errors, _every(RPE_PATH_M, errors.estimated)),
        consistency=_consistency(errors),
        matched=len(errors.error),
        estimates=len(estimate),
        truths=len(truth),
        truth_covered=_covered_share(estimate.stamps_ns, truth.stamps_ns),
        time_to_first_estimate_s=max(0, int(estimate.stamps_ns[0]) - int(truth.stamps_ns[0])) / 1e9,
    )


def chi_square_quantile(probability: float, degrees_of_freedom: int) -> float:
    """Of the chi-square distribution; scipy.stats has it too but takes half a second to import."""
    return 2.0 * float(gammaincinv(0.5 * degrees_of_freedom, probability))


def _statistics(sizes: FloatArray) -> ErrorStatistics:
    rmse = np.sqrt(np.mean(sizes**2))
    return ErrorStatistics(float(rmse), float(np.median(sizes)), float(np.mean(sizes)), float(np.max(sizes)))


def _relative_error(errors: Errors, ends: NDArray[np.intp]) -> RelativeError | None:
    """Of the motions between consecutive `ends` (k,), indices of pairs; None when there are less than two."""
    if len(ends) < 2:
        return None
    moved = between(errors.estimated[ends[:-1]], errors.estimated[ends[1:]])
    truly_moved = between(errors.true[ends[:-1]], errors.true[ends[1:]])
    difference = moved - truly_moved  # of the positions: as long as that of truly_moved^-1 * moved, which evo takes
    translation = np.sqrt(np.mean(np.sum(difference[:, :2] ** 2, axis=1)))
    rotation = np.sqrt(np.mean(wrap(difference[:, 2]) ** 2))
    return RelativeError(float(translation), float(rotation), len(ends) - 1)


def _every(path_m: float, poses: FloatArray) -> NDArray[np.intp]:
    """Indices (k,) of the first pose and of each at which at least path_m was travelled since the one before."""
    steps = np.diff(poses[:, :2], axis=0)
    # Summed one by one, and squared as a dot product, as evo does: rounding decides where steps divide path_m evenly.
    ends, travelled = [0], 0.0
    for index, step_m in enumerate(np.sqrt(np.vecdot(steps, steps)).tolist(), start=1):
        travelled += step_m
        if travelled >= path_m:
            ends.append(index)
            travelled = 0.0
    return np.array(ends, dtype=np.intp)


def _nees(error: FloatArray, covariances: FloatArray) -> FloatArray:
    """(m,) normalised estimation error squared, infinite where the covariance is not positive definite."""
    finite = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)))
    usable = finite[np.linalg.eigvalsh(covariances[finite])[:, 0] > 0]
    nees = np.full(len(error), np.inf)
    nees[usable] = squared_mahalanobis(error[usable], covariances[usable])
    return nees


def _consistency(errors: Errors) -> Consistency | None:
    if errors.nees is None or errors.covariances is None:
        return None
    samples = errors.nees[np.isfinite(errors.nees)]
    if len(samples) == 0:
        return None
    low, high = (chi_square_quantile(p, 3 * len(samples)) / (3 * len(samples)) for p in ANEES_BAND)
    variances = np.diagonal(errors.covariances, axis1=1, axis2=2)
    in_x, in_y, in_heading = np.mean(errors.error**2 <= 9.0 * variances, axis=0).tolist()
    return Consistency(
        anees=float(np.mean(samples)) / 3.0,
        anees_low=low,
        anees_high=high,
        samples=len(samples),
        within_3sigma=float(np.mean(errors.nees <= chi_square_quantile(THREE_SIGMA_SHARE, 3))),
        within_3sigma_axes=(in_x, in_y, in_heading),
        unusable=len(errors.nees) - len(samples),
    )


def _covered_share(estimate_ns: IntArray, truth_ns: IntArray) -> float:
    """Share of the truth's time that the estimate covers; each covers the time between poses at most _MAX_GAP_NS apart.

    1 where the truth covers no time, as a single pose does.
    """
    gaps = np.diff(estimate_ns)
    covered_until = np.concatenate([[0], np.cumsum(np.where(gaps <= _MAX_GAP_NS, gaps, 0))])
    origin_ns = truth_ns[0]  # taken off, whole nanoseconds stay exact as doubles for a hundred days
    covered = np.diff(np.interp(truth_ns - origin_ns, estimate_ns - origin_ns, covered_until))
    known = np.diff(truth_ns)
    whole = known <= _MAX_GAP_NS
    return float(np.sum(covered[whole]) / np.sum(known[whole])) if whole.any() else 1.0
