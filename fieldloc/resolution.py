"""One of a mixture's solutions, where what is known already leaves no doubt which: else none."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fieldloc.factors import Factor
from fieldloc.mixture import IntArray, MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.repeated_mixture import RepeatedMixture

_SURE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where the robot is thought to be: pose (3,), covariance (3, 3) of it in the robot frame."""

    pose: FloatArray
    covariance: FloatArray


def sure(
    mixture: MixtureFactor, belief: Belief | None, log_prior: Callable[[FloatArray], FloatArray] | None = None
) -> tuple[Factor, ...]:
    """The factors of the solution that is right with 99 %, for an estimator that knows one place only.

    belief: where the robot is; without one, the only whole pose that explains what was seen. That is given too where
    nothing near the belief explains it: a wrong belief must hear of it. log_prior: of poses (k, 3), where it may be.
    Which solution it is, a repeated observation tells as well as a new one; that it is little news is in the factors.
    """
    once = mixture.once if isinstance(mixture, RepeatedMixture) else mixture
    if belief is not None:
        near = once.expand(belief.pose[None], belief.covariance[None])
        if len(near.ids) and float(near.evidence.max()) > once.log_outlier:
            return _surest(mixture, near.ids, near.evidence)
    found = once.solutions()
    prior = 0.0 if log_prior is None else log_prior(found.poses)
    return _surest(mixture, found.ids, found.log_weights + prior)


def _surest(mixture: MixtureFactor, ids: IntArray, log_weights: FloatArray) -> tuple[Factor, ...]:
    if not np.isfinite(log_weights).any():
        return ()
    best = int(np.argmax(log_weights))
    share = float(log_weights[best] - np.logaddexp.reduce(log_weights))
    return mixture.chosen(int(ids[best])) if share >= np.log(_SURE) else ()
