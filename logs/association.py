"""Which estimate belongs to which true pose: by time alone, in evo's convention, so that the numbers compare.

Each pose of the trajectory with fewer poses (the estimate, when both have as many) takes the nearest in time of the
other; the earlier of two equally near; none when the nearest is further than the limit. A pose may be taken twice.
Times are compared as double seconds, as they come out of an exported file, because with stamps of today's clock their
rounding (0.24 us) decides ties and the limit's border.
"""

import numpy as np
from numpy.typing import NDArray

from fieldloc.errors import FieldlocError
from logs.trajectory import Trajectory

DEFAULT_MAX_DIFFERENCE_S = 0.01  # evo's


def associate(
    estimate: Trajectory, truth: Trajectory, max_difference_s: float = DEFAULT_MAX_DIFFERENCE_S
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices (m,) into the estimate and (m,) into the truth, m >= 1, both in order of time.

    FieldlocError when one of them is empty or no pair is close enough in time.
    """
    if not max_difference_s >= 0:
        raise ValueError(f"max_difference_s is {max_difference_s}, needs to be zero or more")
    if len(truth) == 0:
        raise FieldlocError("no true poses to compare with: name a log that has a truth topic")
    if len(estimate) == 0:
        raise FieldlocError(
            "no estimates to compare: the estimator never knew where it was; try --start X,Y,HEADING_DEG"
        )
    if len(estimate) > len(truth):
        of_truth, of_estimate = _nearest(truth, estimate, max_difference_s)
    else:
        of_estimate, of_truth = _nearest(estimate, truth, max_difference_s)
    if len(of_estimate) == 0:
        raise FieldlocError(
            f"no estimate lies within {max_difference_s:g} s of a true pose: estimates are at {_span(estimate)}, "
            f"truth is at {_span(truth)}; compare files of the same recording"
        )
    return of_estimate, of_truth


def _nearest(few: Trajectory, many: Trajectory, limit_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the poses of `few` that found a partner, and of their partners in `many`."""
    t, others = few.stamps_s(), many.stamps_s()
    after = np.minimum(np.searchsorted(others, t, side="right"), len(others) - 1)
    before = np.maximum(after - 1, 0)
    gap_after = others[after] - t  # negative beyond the last
    gap_before = np.where(after > 0, t - others[before], np.inf)
    later_is_nearer = gap_after < gap_before
    gap = np.where(later_is_nearer, gap_after, gap_before)
    # the ends are tested as sums because differences round differently on the border
    near = (gap <= limit_s) & (t >= others[0] - limit_s) & (t <= others[-1] + limit_s)
    partner = np.where(later_is_nearer, after, before)
    return np.flatnonzero(near), partner[near]


def _span(trajectory: Trajectory) -> str:
    return f"{trajectory.stamps_ns[0] / 1e9:.3f} to {trajectory.stamps_ns[-1] / 1e9:.3f} s"
