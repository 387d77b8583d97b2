"""What a bank of hypotheses says of the robot: one pose, its covariance, and what else may be."""

import numpy as np

from estimators.base import Ambiguity, Hypothesis
from estimators.mixture.bank import Bank
from estimators.mixture.sides import Sides, distance
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_TIE = 1e-6  # of log-weights
_MINOR = 5.0  # nats: a less likely one adds nothing to a place
_PLACE_M = 0.5
_SHOWN = 1e-6


def best(bank: Bank, sides: Sides, last: FloatArray | None) -> tuple[int, int]:
    """Row and copy of the likeliest at the likeliest place, as several may be at one place; of those that are equally
    likely, the nearest to the last estimate (3,)."""
    weights = bank.log_weights
    if len(bank) == 1:
        if len(sides) == 1:
            return 0, 0
        alike = np.flatnonzero(weights[0] >= weights[0].max() - _TIE)
        if len(alike) == 1 or last is None:
            return 0, int(alike[0])
        return 0, int(alike[np.argmin(distance(sides.unfold(bank.poses)[0, alike], last))])
    rows, copies = np.nonzero(weights >= weights.max() - _MINOR)
    poses = sides.of_copy(copies, bank.poses[rows])
    there = distance(poses[:, None], poses) < _PLACE_M
    likely = weights[rows, copies]
    places = np.log(there @ np.exp(likely - likely.max()))
    # all at the likeliest place share in it, so that the single one decides among them
    first = np.flatnonzero(places >= places.max() - _TIE)
    here = np.flatnonzero(there[first].any(axis=0))
    here = here[likely[here] >= likely[here].max() - _TIE]
    nearest = here[np.argmin(distance(poses[here], last))] if len(here) > 1 and last is not None else here[0]
    return int(rows[nearest]), int(copies[nearest])


def place(bank: Bank, sides: Sides, row: int) -> float:
    """Probability of being near one of the hypotheses or near one of its copies."""
    near = (distance(sides.unfold(bank.poses), bank.poses[row]) < _PLACE_M).any(axis=1)
    return float(np.exp(bank.totals[near]).sum())


def covariance_about(pose: FloatArray, bank: Bank, sides: Sides) -> FloatArray:
    """(3, 3) in field axes of all hypotheses on all copies, about one pose (3,)."""
    weights = np.exp(bank.log_weights - bank.log_weights.max())
    weights /= weights.sum()
    poses = sides.unfold(bank.poses)
    apart = poses - pose
    apart[..., 2] = se2.wrap(apart[..., 2])
    each = se2.rotate_covariance(bank.covariances[:, None, :3, :3], poses[..., 2])
    each = each + apart[..., :, None] * apart[..., None, :]
    return np.asarray(np.einsum("hc,hcij->ij", weights, each))


def mirrored(pose: FloatArray, bank: Bank, sides: Sides, lost: float) -> float:
    """Probability that the robot is nearer to one of the pose's (3,) copies than to itself. A lost one is nearest to
    any of them alike."""
    if len(sides) == 1:
        return 0.0
    elsewhere = sides.nearest(sides.unfold(bank.poses), pose) > 0
    share = (len(sides) - 1) / len(sides)
    return float(np.exp(bank.log_weights[elsewhere]).sum() + share * lost)


def ambiguity(
    stamp_ns: int, bank: Bank, sides: Sides, first: tuple[int, int], tracks: IntArray, lost: float
) -> Ambiguity:
    """first: row and copy of the estimate."""
    weights = np.exp(bank.log_weights - bank.log_weights.max())  # a robot that is surely lost leaves nothing else
    weights /= weights.sum()
    pose = sides.of_one(first[1], bank.poses[first[0]])
    ranked = weights.copy()
    ranked[first] = np.inf
    order = np.argsort(-ranked, axis=None, kind="stable")
    order = order[ranked.ravel()[order] >= _SHOWN]
    shown = weights.ravel()[order]
    shown *= (1.0 - lost) / shown.sum()
    rows, copies = np.unravel_index(order, weights.shape)
    poses = sides.of_copy(copies, bank.poses[rows])
    covariances = se2.rotate_covariance(bank.covariances[rows, :3, :3], poses[:, 2])
    numbers = tracks[rows, copies].tolist()
    hypotheses = tuple(
        Hypothesis(weight, one, covariance, track)
        for weight, one, covariance, track in zip(shown.tolist(), poses, covariances, numbers, strict=True)
    )
    return Ambiguity(stamp_ns, hypotheses, mirrored(pose, bank, sides, lost), lost)
