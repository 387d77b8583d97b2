"""One of a mixture's solutions, where what is known already leaves no doubt which: else none."""

from collections.abc import Callable

import numpy as np

from fieldloc.association import Belief
from fieldloc.factors import Factor
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray

_SURE = 0.99


def sure(
    mixture: MixtureFactor, belief: Belief | None, log_prior: Callable[[FloatArray], FloatArray] | None = None
) -> tuple[Factor, ...]:
    """The factors of the solution that is right with 99 %, for an estimator that knows one place only.

    belief: where the robot is; without one, the only whole pose that explains what was seen. log_prior: of poses
    (k, 3), where it may be then.
    """
    if belief is None:
        found = mixture.solutions()
        ids, weights = found.ids, found.log_weights
        if log_prior is not None:
            weights = weights + log_prior(found.poses)
        doubts = [weights]
    else:
        near = mixture.expand(belief.pose[None], belief.covariance[None])
        ids, weights = near.ids, near.evidence
        doubts = [weights, np.array([mixture.log_outlier])]
    if not np.isfinite(weights).any():
        return ()
    best = int(np.argmax(weights))
    share = float(weights[best] - np.logaddexp.reduce(np.concatenate(doubts)))
    return mixture.chosen(int(ids[best])) if share >= np.log(_SURE) else ()
