"""An observation splits each hypothesis into one child per solution that it allows, and one that explains nothing."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.base import Innovation
from estimators.mixture.bank import Bank
from estimators.mixture.log_sums import either, of_each, total
from estimators.mixture.sides import Sides
from estimators.views import View
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor
from fieldloc.mixture import Expansion, IntArray, MixtureFactor
from fieldloc.one_pose import retracted
from fieldloc.pose import FloatArray

_ALIVE = 40.0  # nats beside the likeliest
_NOBODY = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the hypotheses see: each once, or once from each copy that is alive.

    rows, copies: (v,) which; the copy is 0 where all of them see the same. poses: (v, 3), covariances: (v, 3, 3) of
    what they see it from.
    log_weights: (v, c) of what sees it.
    """

    rows: IntArray
    copies: IntArray
    poses: FloatArray
    covariances: FloatArray
    log_weights: FloatArray

    @staticmethod
    def of(bank: Bank, sides: Sides, symmetric: bool, view: View) -> "Sight":
        covariances = view.covariance(bank.covariances)
        if len(bank) == 1:
            poses = retracted(bank.poses[0], view.beside(bank.extra[0]))[None]
        else:
            poses = view.of(bank.poses, bank.extra)
        if symmetric or len(sides) == 1:
            rows, log_weights = np.arange(len(bank)), bank.log_weights
            copy = np.zeros_like(rows)
        else:
            rows, copy = np.nonzero(bank.log_weights > bank.log_weights.max() - _ALIVE)
            poses, covariances = sides.of_copy(copy, poses[rows]), covariances[rows]
            log_weights = np.full((len(rows), len(sides)), -np.inf)
            log_weights[np.arange(len(rows)), copy] = bank.log_weights[rows, copy]
        return Sight(rows, copy, poses, covariances, log_weights)


@dataclass(frozen=True, eq=False)
class Children:
    """Not made yet: seen is what each takes in, parents (k,) rows, log_weights (k, c). The last ones take nothing."""

    seen: Expansion
    parents: IntArray
    log_weights: FloatArray
    blind_rows: IntArray
    blind_weights: FloatArray
    before: FloatArray

    @staticmethod
    def of(bank: Bank, sides: Sides, mixture: MixtureFactor, view: View) -> "Children":
        if not len(bank):
            none = np.zeros((0, len(sides)))
            return Children(_nothing(), _NOBODY, none, _NOBODY, none, np.zeros(0))
        sight = Sight.of(bank, sides, mixture.symmetric, view)
        seen = mixture.expand(sight.poses, sight.covariances)
        log_weights = sight.log_weights[seen.parent] + seen.evidence[:, None]
        blind = sight.log_weights + seen.log_blind(mixture, len(sight.poses))[:, None]
        return Children(seen, sight.rows[seen.parent], log_weights, sight.rows, blind, of_each(sight.log_weights))

    def tempered(self, share: float) -> "Children":
        """What the observation says of hypotheses against each other counts only that share of a full observation, what
        it says of the children of one in full."""
        if share == 1.0 or len(self.before) < 2:
            return self
        evidence, best = self._evidence
        back = ((share - 1.0) * (evidence - evidence[best]))[:, None]
        return replace(
            self, log_weights=self.log_weights + back[self.seen.parent], blind_weights=self.blind_weights + back
        )

    @property
    def of_likeliest(self) -> float:
        """What the observation says of the hypothesis that is the likeliest with it, all its children together: log
        evidence; nan without any."""
        if len(self.before) == 1:
            alone = self.total - float(self.before[0])
            return alone if math.isfinite(alone) else 0.0
        evidence, best = self._evidence
        return float(evidence[best]) if len(evidence) else math.nan

    @property
    def _evidence(self) -> tuple[FloatArray, int]:
        """(v,) of all, 0 where there is none; and which is the likeliest after it."""
        after = np.full(len(self.before), -np.inf)
        np.logaddexp.at(after, self.seen.parent, of_each(self.log_weights))
        after = np.logaddexp(after, of_each(self.blind_weights))
        evidence = after - self.before
        best = int(np.argmax(after)) if len(after) else 0
        return np.where(np.isfinite(evidence), evidence, 0.0), best

    @property
    def margin(self) -> float:
        """By how much (log) the only solution is better than to take nothing for right, 0 if there are others."""
        if len(self.seen.parent) != 1 or len(self.before) != 1:
            return 0.0
        return self._sighted - self.blind

    @property
    def total(self) -> float:
        return either(self._sighted, self.blind)

    @cached_property
    def _sighted(self) -> float:
        """Log-weight of those that explain something."""
        return total(self.log_weights)

    @cached_property
    def blind(self) -> float:
        """Log-weight of those that explain nothing."""
        return total(self.blind_weights)

    def born(self, bank: Bank, least: float, view: View) -> Bank:
        """Those whose log-weight is at least that."""
        keep = np.flatnonzero(of_each(self.log_weights) >= least)
        out = bank.corrected(self.parents[keep], self.seen.take(keep), self.log_weights[keep], view)
        keep = np.flatnonzero(of_each(self.blind_weights) >= least)
        if not len(keep):
            return out
        rows = self.blind_rows[keep]
        blind = bank.take(rows)
        return out.joined(
            replace(blind, log_weights=self.blind_weights[keep], parents=rows, choices=np.full(len(rows), -1))
        )


def met(
    bank: Bank, sides: Sides, factor: Factor, view: View, nis_per_dof: float, first: tuple[int, int]
) -> tuple[Children, Innovation, float]:
    """A plain factor: one child each, the factor widened where it disagrees, so that none is ever ignored for good.

    Beside the children: how it met the `first` (row, copy), and its log-density for a robot that is at none of the
    hypotheses, which is that of an innovation just not widened.
    """
    sight = Sight.of(bank, sides, symmetric=False, view=view)
    residual = factor.error(sight.poses)
    jacobian = np.array([factor.jacobian(pose) for pose in sight.poses])
    back = np.swapaxes(jacobian, -1, -2)
    expected = jacobian @ sight.covariances @ back + factor.covariance
    nis = squared_mahalanobis(residual, expected)
    edge = nis_per_dof * residual.shape[1]
    weight = np.minimum(1.0, edge / np.maximum(nis, 1e-300))
    precision = np.linalg.inv(factor.covariance) * weight[:, None, None]
    weighted = precision @ residual[:, :, None]
    log_det = np.linalg.slogdet(precision / (2.0 * np.pi))[1]
    each = np.arange(len(residual))
    seen = Expansion(
        each,
        np.zeros_like(each),
        0.5 * (log_det - np.sum(residual * weighted[:, :, 0], axis=1)),
        -(back @ weighted)[:, :, 0],
        back @ precision @ jacobian,
        sight.covariances,
    )
    log_weights = sight.log_weights + seen.evidence[:, None]
    children = Children(seen, sight.rows, log_weights, _NOBODY, np.zeros((0, len(sides))), np.zeros(0))
    at = int(np.flatnonzero((sight.rows == first[0]) & (sight.copies == first[1]))[0])
    innovation = Innovation(factor.stamp_ns, residual[at], expected[at], float(nis[at]), float(weight[at]))
    log_unknown = -0.5 * (edge + np.linalg.slogdet(2.0 * np.pi * expected[at])[1])
    return children, innovation, float(log_unknown)


def _nothing() -> Expansion:
    return Expansion(_NOBODY, _NOBODY, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
