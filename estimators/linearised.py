"""A chain linearised at poses and at what is the same over all of it: rows in the factors' own sigmas, as arrays.

What is minimised is 0.5 |rows @ step - towards|^2 over all rows, for the step of all that is not fixed. The formulas
are in estimators.solution. A compass' readings are not in it (estimators.compass_knots).
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from estimators.chain import Chain, velocities
from estimators.config import Config
from estimators.sensor import lever as lever_at
from estimators.solution import CALIBRATION, MOTION_FLOOR, WEAK_SIGMAS, global_sigmas
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.stacks import FactorStack, HeadingStack, LandmarkStack, LineStack, PoseStack

_Some = TypeVar("_Some", bound=Factor)


class MotionRows(NamedTuple):
    """before, after (n - 1, 3, 3); by_globals (n - 1, 3, free); towards (n - 1, 3)."""

    before: FloatArray
    after: FloatArray
    by_globals: FloatArray
    towards: FloatArray


class FactorRows(NamedTuple):
    """k factors of m numbers at their nodes (k,): by_pose (k, m, 3); by_globals (k, m, free); towards (k, m)."""

    nodes: IntArray
    by_pose: FloatArray
    by_globals: FloatArray
    towards: FloatArray


class Group(NamedTuple):
    """k factors of one kind, each as a stack of its own: arrays (k, 1, ...). whiteners: (k, m, m)."""

    nodes: IntArray
    sighted: IntArray
    stack: FactorStack
    whiteners: FloatArray


class Linearised:
    """free: (GLOBALS,) which of what is the same over all of the chain is not fixed.

    moved (n - 1, 3), by_calibration (n - 1, 3, 6): of the motions; motion_roots (n - 1, 3, 3): their whiteners.
    """

    def __init__(self, chain: Chain, config: Config) -> None:
        self._chain, self._stamps_ns = chain, np.array(chain.stamps_ns)
        self._cauchy = config.graph.cauchy
        self.sigmas = global_sigmas(config)
        self.free = self.sigmas > 0.0
        self.moved = np.array([m.before_from_after for m in chain.motions]).reshape(-1, 3)
        self.by_calibration = np.array([m.by_calibration for m in chain.motions]).reshape(-1, 3, CALIBRATION)
        covariances = np.array([m.covariance for m in chain.motions]).reshape(-1, 3, 3) + MOTION_FLOOR
        self.motion_roots = np.linalg.inv(np.linalg.cholesky(covariances))
        self.groups = _grouped(chain.factors)

    def motions(self, poses: FloatArray, common: FloatArray) -> MotionRows:
        """common: (GLOBALS,)."""
        by_calibration = self.by_calibration @ common[:CALIBRATION]
        expected = se2.retract(self.moved, by_calibration)
        walked = se2.between(poses[:-1], poses[1:])
        error = se2.local(expected, walked)
        after = self.motion_roots @ se2.right_jacobian_inverse(error)
        before = -after @ se2.adjoint(se2.inverse(walked))
        # the expected motion is on the error's left side
        moved = se2.right_jacobian(by_calibration) @ self.by_calibration
        by_globals = np.zeros((len(error), 3, len(self.free)))
        by_globals[:, :, :CALIBRATION] = -self.motion_roots @ se2.right_jacobian_inverse(-error) @ moved
        return MotionRows(before, after, by_globals[:, :, self.free], -_times(self.motion_roots, error))

    def factors(self, poses: FloatArray, common: FloatArray) -> list[FactorRows]:
        """Under the kernel, a group for each kind of factor; the weak prior about the first pose is another."""
        levers = self.levers(common)
        weak = np.diag(1.0 / WEAK_SIGMAS)[None]
        error = se2.local(self._chain.guess[:1], poses[:1])
        rows = weak @ se2.right_jacobian_inverse(error)
        out = [FactorRows(np.zeros(1, dtype=np.intp), rows, np.zeros((1, 3, self.free.sum())), -_times(weak, error))]
        for group in self.groups:
            lever = levers[group.nodes] * group.sighted[:, None, None]
            turned = lever @ common[CALIBRATION:]
            seen_from = se2.retract(poses[group.nodes], turned)
            error = _times(group.whiteners, _errors(group.stack, seen_from))
            weight = 1.0 / np.sqrt(1.0 + np.sum(error**2, axis=-1) / self._cauchy**2)
            jacobian = weight[:, None, None] * (group.whiteners @ _jacobians(group.stack, seen_from))
            by_globals = np.zeros((*error.shape, len(self.free)))
            by_globals[..., CALIBRATION:] = jacobian @ (se2.right_jacobian(turned) @ lever)
            by_pose = jacobian @ se2.adjoint(se2.inverse(se2.exp(turned)))
            out.append(FactorRows(group.nodes, by_pose, by_globals[..., self.free], -weight[:, None] * error))
        return out

    def levers(self, common: FloatArray) -> FloatArray:
        """As of the chain, (n, 3, 2), of which the arrays are at hand here."""
        if not len(self.moved):
            return lever_at(np.zeros((1, 3)))
        miscalibrated = self.by_calibration @ common[:CALIBRATION]
        return lever_at(velocities(self.moved, miscalibrated, self._stamps_ns))

    def error(self, poses: FloatArray, common: FloatArray) -> float:
        """What is minimised, the kernel's cost and the prior of what is the same over the chain included."""
        by_calibration = self.by_calibration @ common[:CALIBRATION]
        expected = se2.retract(self.moved, by_calibration)
        error = _times(self.motion_roots, se2.local(expected, se2.between(poses[:-1], poses[1:])))
        out = np.sum(error**2) + np.sum((common[self.free] / self.sigmas[self.free]) ** 2)
        out += np.sum((se2.local(self._chain.guess[0], poses[0]) / WEAK_SIGMAS) ** 2)
        levers = self.levers(common)
        for group in self.groups:
            turned = levers[group.nodes] @ common[CALIBRATION:] * group.sighted[:, None]
            error = _times(group.whiteners, _errors(group.stack, se2.retract(poses[group.nodes], turned)))
            out += self._cauchy**2 * np.sum(np.log1p(np.sum(error**2, axis=-1) / self._cauchy**2))
        return 0.5 * float(out)


def _grouped(factors: Sequence[tuple[int, Factor]]) -> list[Group]:
    kinds: dict[type, list[tuple[int, Factor]]] = {}
    for node, factor in factors:
        if not (isinstance(factor, HeadingFactor) and factor.by_compass):
            kinds.setdefault(type(factor), []).append((node, factor))
    out = []
    for those in kinds.values():
        nodes = np.array([node for node, _ in those])
        some = [factor for _, factor in those]
        sighted = np.array([isinstance(f, (PoseFactor, LandmarkFactor, LineFactor)) and f.by_sight for f in some])
        covariances = np.array([factor.covariance for factor in some])
        stack = _stacked(some, covariances)
        if not np.isfinite(covariances).all():
            raise ValueError("not finite: the covariance of a factor")
        out.append(Group(nodes, sighted, stack, np.linalg.inv(np.linalg.cholesky(covariances))))
    return out


def _stacked(factors: Sequence[Factor], covariances: FloatArray) -> FactorStack:
    """All of the kind of the first."""
    match factors[0]:
        case PoseFactor():
            return PoseStack(np.array([f.pose for f in _of(PoseFactor, factors)])[:, None], covariances)
        case LandmarkFactor():
            landmarks = _of(LandmarkFactor, factors)
            on_map, seen = np.array([f.landmark for f in landmarks]), np.array([f.seen for f in landmarks])
            return LandmarkStack(on_map[:, None], seen[:, None], covariances)
        case HeadingFactor():
            return HeadingStack(np.array([[f.heading_rad] for f in _of(HeadingFactor, factors)]), covariances)
        case LineFactor():
            lines = [(f.heading_rad, f.normal_rad, f.offset_m) for f in _of(LineFactor, factors)]
            heading_rad, normal_rad, offset_m = np.array(lines).T[..., None]
            return LineStack(heading_rad, normal_rad, offset_m, np.zeros((len(lines), 2)), covariances)
        case other:
            raise TypeError(f"no way to solve for a {type(other).__name__}")


def _of(kind: type[_Some], factors: Sequence[Factor]) -> list[_Some]:
    return [factor for factor in factors if isinstance(factor, kind)]


def _errors(stack: FactorStack, poses: FloatArray) -> FloatArray:
    """(k, m) of each at its own pose (k, 3)."""
    return stack.errors(poses)[:, 0]


def _jacobians(stack: FactorStack, poses: FloatArray) -> FloatArray:
    """(k, m, 3) of each at its own pose (k, 3)."""
    if isinstance(stack, HeadingStack):
        return np.tile([0.0, 0.0, 1.0], (len(poses), 1, 1))
    return stack.jacobians(poses)[:, 0]


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
