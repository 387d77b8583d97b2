"""A mixture whose solutions have all been found: stacks of factors with weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.covariance import log_peaks, squared_mahalanobis
from fieldloc.factors import Factor, sighted
from fieldloc.mixture import Expansion, IntArray, PoseSolutions
from fieldloc.pose import FloatArray
from fieldloc.stacks import FactorStack, LineStack, PoseStack

# chi-square by degrees of freedom: a right solution fails once in ten thousand
GATES = {1: 15.14, 2: 18.42, 3: 21.11}
_REACH_SIGMAS = 4.0
_STRAIGHT_RAD = 0.02  # a step that turns less needs no second linearisation
_STRAIGHT_M = 0.02


@dataclass(frozen=True)
class SolutionMixture:
    """stacks: (stack, log_weights (k,)) each; p(observation, solution | pose) is exp(log_weight) times the normal
    density of the stack's error. Ids count through all stacks in their order. area_m2: where the robot can be.
    """

    stamp_ns: int
    stacks: tuple[tuple[FactorStack, FloatArray], ...]
    log_outlier: float
    symmetric: bool
    area_m2: float
    by_compass: bool = False
    by_sight: bool = False

    @property
    def log_integral(self) -> float:
        terms = [weights + stack.log_room(self.area_m2) for stack, weights in self.stacks]
        return float(np.logaddexp.reduce(np.concatenate([*terms, [-np.inf]])))

    def solutions(self) -> PoseSolutions:
        """Of the stacks of whole poses."""
        found, first = [PoseSolutions.none()], 0
        for stack, weights in self.stacks:
            if isinstance(stack, PoseStack):
                ids = first + np.arange(len(weights))
                found.append(PoseSolutions(stack.poses, stack.covariances, weights, ids))
            first += len(weights)
        weights = np.concatenate([one.log_weights for one in found])
        order = np.argsort(-weights, kind="stable")
        poses = np.concatenate([one.poses for one in found])
        covariances = np.concatenate([one.covariances for one in found])
        return PoseSolutions(
            poses[order], covariances[order], weights[order], np.concatenate([one.ids for one in found])[order]
        )

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        parts, first = [], 0
        for stack, weights in self.stacks:
            if len(weights):
                parts.append(expand_stack(stack, weights, poses, covariances, first))
            first += len(weights)
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return _nothing()
        return Expansion(
            np.concatenate([part.parent for part in parts]),
            np.concatenate([part.ids for part in parts]),
            np.concatenate([part.constant for part in parts]),
            np.concatenate([part.gradient for part in parts]),
            np.concatenate([part.information for part in parts]),
            np.concatenate([part.covariance for part in parts]),
        )

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        out = np.full(poses.shape[:-1], self.log_outlier)
        for stack, weights in self.stacks:
            if len(weights):
                precision, log_norm = _normal(stack.covariances)
                error = stack.errors(poses)
                misfit = np.einsum("...ki,kij,...kj->...k", error, precision, error)
                terms = weights + log_norm - 0.5 * misfit
                if isinstance(stack, LineStack):
                    terms = np.where(_in_reach(stack, poses, np.zeros((3, 3))), terms, -np.inf)
                out = np.logaddexp(out, np.logaddexp.reduce(terms, axis=-1))
        return np.asarray(out)

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        for stack, weights in self.stacks:
            if solution < len(weights):
                factor = stack.factor(self.stamp_ns, solution)
                return (sighted(factor) if self.by_sight else factor,)
            solution -= len(weights)
        raise IndexError(f"no solution {solution}")


def expand_stack(
    stack: FactorStack, log_weights: FloatArray, poses: FloatArray, covariances: FloatArray, first_id: int = 0
) -> Expansion:
    """As MixtureFactor.expand, with a stack's rows counted from `first_id` as ids."""
    error, jacobian = stack.errors(poses), stack.jacobians(poses)
    size = error.shape[-1]
    expected = jacobian @ covariances[:, None] @ np.swapaxes(jacobian, -1, -2) + stack.covariances
    # what is too far in one number is so in all
    near = np.asarray((error * error < GATES[size] * expected.diagonal(axis1=-2, axis2=-1)).all(axis=-1))
    near[near] = squared_mahalanobis(error[near], expected[near]) < GATES[size]
    if isinstance(stack, LineStack):
        near &= _in_reach(stack, poses, covariances)
    parent, row = np.nonzero(near)
    precision, log_norm = _normal(stack.covariances[row])
    out = _quadratic(
        parent, row + first_id, log_weights[row] + log_norm, error[near], jacobian[near], precision, covariances[parent]
    )
    step = out.step
    if stack.curved and len(row) and (np.abs(step) > [_STRAIGHT_M, _STRAIGHT_M, _STRAIGHT_RAD]).any():
        # once more where the update leads, in terms of the tangent at the parent's pose
        at, picked = se2.retract(poses[parent], step), stack.take(row[:, None])  # one for each pose
        jacobian_at = picked.jacobians(at)[:, 0] @ se2.right_jacobian(step)
        error_at = picked.errors(at)[:, 0] - (jacobian_at @ step[:, :, None])[..., 0]
        constant = log_weights[row] + log_norm
        out = _quadratic(parent, row + first_id, constant, error_at, jacobian_at, precision, covariances[parent])
    return out


def _quadratic(
    parent: IntArray,
    ids: IntArray,
    constant: FloatArray,
    error: FloatArray,
    jacobian: FloatArray,
    precision: FloatArray,
    covariance: FloatArray,
) -> Expansion:
    """Of normal densities of (c, m) errors that grow by jacobians (c, m, 3)."""
    weighted = (precision @ error[:, :, None])[..., 0]
    back = np.swapaxes(jacobian, -1, -2)
    return Expansion(
        parent,
        ids,
        constant - 0.5 * np.sum(error * weighted, axis=1),
        -(back @ weighted[:, :, None])[..., 0],
        back @ precision @ jacobian,
        covariance,
    )


def _normal(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Precisions (k, m, m) and log densities at zero (k,)."""
    return np.asarray(np.linalg.inv(covariances)), log_peaks(covariances)


def _in_reach(lines: LineStack, poses: FloatArray, covariances: FloatArray) -> NDArray[np.bool_]:
    """(..., k): whether the line is long enough to be seen from where the robot is thought to be."""
    along = lines.normal_rad + 0.5 * np.pi
    at = np.cos(along) * poses[..., None, 0] + np.sin(along) * poses[..., None, 1]
    turned = along - poses[..., None, 2]
    direction = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    variance = np.einsum("...ki,...ij,...kj->...k", direction, covariances[..., :2, :2], direction)
    reach = _REACH_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return np.asarray((lines.along_m[:, 0] - reach < at) & (at < lines.along_m[:, 1] + reach))


def _nothing() -> Expansion:
    none = np.zeros(0, dtype=np.intp)
    return Expansion(none, none, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
