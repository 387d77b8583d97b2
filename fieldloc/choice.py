"""One of an image's several solutions, where what is known already leaves no doubt which: else none."""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from fieldloc.association import Belief
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, LineFactor, PoseFactor, innovation_covariance
from fieldloc.fixes.base import Fix
from fieldloc.fixes.line_poses import LineConstraint
from fieldloc.pose import rotation

_SURE = 0.99
# chi-square by degrees of freedom: a right solution fails once in a thousand
_GATES = {2: 13.82, 3: 16.27}
_REACH_SIGMAS = 4.0
_AnyFix = TypeVar("_AnyFix", bound=Fix)


def choose_fix(stamp_ns: int, fixes: Sequence[_AnyFix], belief: Belief | None) -> _AnyFix | None:
    """The fix that is right with 99 %, by how well it explains the image and, with a belief, by how near it is."""
    factors = [PoseFactor.from_fix(stamp_ns, fix) for fix in fixes]
    chosen = _choose(factors, [fix.log_weight for fix in fixes], belief)
    return None if chosen is None else fixes[chosen]


def choose_constraint(stamp_ns: int, found: Sequence[LineConstraint], belief: Belief) -> LineFactor | None:
    """The same for lines of one direction, which without a belief determine nothing."""
    found = [constraint for constraint in found if _could_see(constraint, belief)]
    factors = [_line_factor(stamp_ns, constraint) for constraint in found]
    chosen = _choose(factors, [constraint.log_weight for constraint in found], belief)
    return None if chosen is None else factors[chosen]


def _choose(factors: Sequence[Factor], log_weights: Sequence[float], belief: Belief | None) -> int | None:
    scores = np.array(log_weights, dtype=np.float64)
    if belief is not None:
        scores += [_log_agreement(factor, belief) for factor in factors]
    if not np.isfinite(scores).any():
        return None
    best = int(np.argmax(scores))
    return best if 1.0 / float(np.exp(scores - scores[best]).sum()) >= _SURE else None


def _log_agreement(factor: Factor, belief: Belief) -> float:
    """Log density of the factor under the belief; minus infinity outside the gate."""
    residual = factor.error(belief.pose)
    _, expected = innovation_covariance(factor, belief.pose, belief.covariance)
    distance = float(squared_mahalanobis(residual, expected))
    if distance > _GATES[len(residual)]:
        return -math.inf
    return -0.5 * (distance + float(np.linalg.slogdet(expected)[1]))


def _could_see(constraint: LineConstraint, belief: Belief) -> bool:
    """Whether the line is long enough to be seen from where the robot is thought to be."""
    along = rotation(0.5 * math.pi) @ constraint.normal
    at = float(along @ belief.pose[:2])
    in_robot = rotation(-belief.pose[2]) @ along
    reach = _REACH_SIGMAS * math.sqrt(float(in_robot @ belief.covariance[:2, :2] @ in_robot))
    return bool(constraint.along_m[0] - reach < at < constraint.along_m[1] + reach)


def _line_factor(stamp_ns: int, constraint: LineConstraint) -> LineFactor:
    normal_rad = math.atan2(constraint.normal[1], constraint.normal[0])
    by_heading_first = constraint.covariance[::-1, ::-1]
    return LineFactor(stamp_ns, constraint.heading_rad, normal_rad, constraint.offset_m, by_heading_first)
