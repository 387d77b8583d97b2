"""A chain linearised at poses and at what is the same over all of it: rows in the factors' own sigmas, as arrays.

What is minimised is 0.5 |rows @ step - towards|^2 over all rows, for the step of all that is not fixed. The formulas
are in estimators.solution. A compass' readings are not in it (estimators.compass_knots).
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Chain, velocities
from estimators.config import Config
from estimators.motion import CALIBRATION
from estimators.sensor import LEVER_BY_VELOCITY
from estimators.sensor import lever as lever_at
from estimators.solution import MOTION_FLOOR, WEAK_SIGMAS, global_means, global_sigmas
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.stacks import FactorStack, HeadingStack, LandmarkStack, LineStack, PoseStack

_FLOAT = np.dtype(np.float64)
_BATCH = 1024
_Some = TypeVar("_Some")


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
    sighted: NDArray[np.bool_]
    stack: FactorStack
    whiteners: FloatArray


class _Part(NamedTuple):
    """Some of a group; columns of what its stack is made of."""

    nodes: IntArray
    sighted: NDArray[np.bool_]
    covariances: FloatArray
    columns: list[FloatArray]


class Linearised:
    """free: (GLOBALS,) which of what is the same over all of the chain is not fixed.

    means, sigmas: (GLOBALS,) of the priors. durations_s (n - 1,), moved (n - 1, 3), by_calibration
    (n - 1, 3, CALIBRATION): of the motions; motion_roots (n - 1, 3, 3): their whiteners. compass: what is not in
    `groups`, the readings and their nodes.
    """

    def __init__(self, chain: Chain, config: Config) -> None:
        self._chain, self.count = chain, len(chain.stamps_ns)
        self.stamps_ns = np.array(chain.stamps_ns, dtype=np.int64)
        self.durations_s = np.diff(self.stamps_ns).astype(np.float64) * 1e-9
        self._cauchy = config.graph.cauchy
        self.means, self.sigmas = global_means(config), global_sigmas(config)
        self.free = self.sigmas > 0.0
        moved, by_calibration, covariances = [np.zeros((0, 3))], [np.zeros((0, 3, CALIBRATION))], [np.zeros((0, 3, 3))]
        for motions in _batches(chain.motions):
            moved.append(_gathered([motion.before_from_after for motion in motions], 3))
            by_calibration.append(_gathered([motion.by_calibration for motion in motions], 3, CALIBRATION))
            covariances.append(_gathered([motion.covariance for motion in motions], 3, 3))
        self.moved, self.by_calibration = np.concatenate(moved), np.concatenate(by_calibration)
        self.motion_roots = _whiteners(np.concatenate(covariances) + MOTION_FLOOR)
        self.compass = list[tuple[int, HeadingFactor]]()
        parts: defaultdict[type[Factor], list[_Part]] = defaultdict(list)
        for factors in _batches(chain.factors):
            by_kind = _by_kind(factors)
            headings = list(zip(*by_kind.pop(HeadingFactor, ([], [])), strict=True))
            for node, factor in headings:
                if isinstance(factor, HeadingFactor) and factor.by_compass:
                    self.compass.append((node, factor))
                else:
                    nodes, those = by_kind[HeadingFactor]
                    nodes.append(node)
                    those.append(factor)
            for kind, (nodes, those) in by_kind.items():
                parts[kind].append(_part(nodes, those))
        self.groups = [_group(kind, those_parts) for kind, those_parts in parts.items()]

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
        all_turned, by_common = self.sights(common)
        out = [self.first(poses)]
        for group in self.groups:
            turned = all_turned[group.nodes] * group.sighted[:, None]
            lever = by_common[group.nodes] * group.sighted[:, None, None]
            seen_from = se2.retract(poses[group.nodes], turned)
            error = _times(group.whiteners, _errors(group.stack, seen_from))
            weight = 1.0 / np.sqrt(1.0 + np.sum(error**2, axis=-1) / self._cauchy**2)
            jacobian = weight[:, None, None] * (group.whiteners @ _jacobians(group.stack, seen_from))
            by_globals = jacobian @ (se2.right_jacobian(turned) @ lever)
            by_pose = jacobian @ se2.adjoint(se2.inverse(se2.exp(turned)))
            out.append(FactorRows(group.nodes, by_pose, by_globals[..., self.free], -weight[:, None] * error))
        return out

    def first(self, poses: FloatArray) -> FactorRows:
        """The weak prior about the first pose."""
        weak = np.diag(1.0 / WEAK_SIGMAS)[None]
        error = se2.local(self._chain.guess[:1], poses[:1])
        rows = weak @ se2.right_jacobian_inverse(error)
        return FactorRows(np.zeros(1, dtype=np.intp), rows, np.zeros((1, 3, self.free.sum())), -_times(weak, error))

    def sights(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From each pose to the one that was seen from: the tangent (n, 3), its change with `common` (n, 3, GLOBALS).

        It changes with the odometry's calibration as delays are a matter of how fast the robot really is.
        """
        calibration, sensor = np.split(common, [CALIBRATION])
        miscalibrated = self.by_calibration @ calibration
        velocity = velocities(self.moved, miscalibrated, self.durations_s)
        levers = lever_at(velocity)
        by_common = np.concatenate([np.zeros((*velocity.shape, CALIBRATION)), levers], axis=-1)
        by_velocity = (LEVER_BY_VELOCITY @ sensor).T
        if len(self.moved) and by_velocity.any():
            moved = se2.right_jacobian_inverse(velocity[1:] * self.durations_s[:, None]) @ se2.right_jacobian(
                miscalibrated
            )
            by_common[1:, :, :CALIBRATION] = by_velocity @ moved @ self.by_calibration / self.durations_s[:, None, None]
            by_common[0, :, :CALIBRATION] = by_common[1, :, :CALIBRATION]
        return levers @ sensor, by_common

    def error(self, poses: FloatArray, common: FloatArray) -> float:
        """What is minimised, the kernel's cost and the prior of what is the same over the chain included."""
        by_calibration = self.by_calibration @ common[:CALIBRATION]
        expected = se2.retract(self.moved, by_calibration)
        error = _times(self.motion_roots, se2.local(expected, se2.between(poses[:-1], poses[1:])))
        out = np.sum(error**2) + np.sum(((common - self.means)[self.free] / self.sigmas[self.free]) ** 2)
        out += np.sum((se2.local(self._chain.guess[0], poses[0]) / WEAK_SIGMAS) ** 2)
        velocity = velocities(self.moved, by_calibration, self.durations_s)
        all_turned = lever_at(velocity) @ common[CALIBRATION:]
        for group in self.groups:
            turned = all_turned[group.nodes] * group.sighted[:, None]
            error = _times(group.whiteners, _errors(group.stack, se2.retract(poses[group.nodes], turned)))
            out += self._cauchy**2 * np.sum(np.log1p(np.sum(error**2, axis=-1) / self._cauchy**2))
        return 0.5 * float(out)


def squared_errors(
    factors: Sequence[Factor], poses: FloatArray, gates: Mapping[int, float]
) -> tuple[FloatArray, FloatArray]:
    """(k,) of each factor at its own pose (k, 3), in its sigmas; the gates by how many numbers it is of."""
    squares, limits = np.zeros(len(factors)), np.zeros(len(factors))
    kinds = [type(factor) for factor in factors]
    for kind in dict.fromkeys(kinds):
        rows = np.array([row for row, other in enumerate(kinds) if other is kind])
        group = _group(kind, [_part(rows.tolist(), [factors[row] for row in rows])])
        error = _times(group.whiteners, _errors(group.stack, poses[rows]))
        squares[rows], limits[rows] = np.sum(error**2, axis=-1), gates[error.shape[1]]
    return squares, limits


def _batches(records: Sequence[_Some]) -> Iterator[Sequence[_Some]]:
    """So many at a time that what is read of them once is at hand when they are read again."""
    return (records[start : start + _BATCH] for start in range(0, len(records), _BATCH))


def _by_kind(
    factors: Sequence[tuple[int, Factor]],
) -> defaultdict[type[Factor], tuple[list[int], list[Factor]]]:
    """Nodes and factors. There are many, so each is looked at once."""
    out: defaultdict[type[Factor], tuple[list[int], list[Factor]]] = defaultdict(lambda: ([], []))
    for node, factor in factors:
        nodes, those = out[type(factor)]
        nodes.append(node)
        those.append(factor)
    return out


def _part(nodes: list[int], factors: list[Factor]) -> _Part:
    """Of factors of one kind."""
    size = len(factors[0].covariance)
    by_sight = [False] * len(factors)
    columns: list[FloatArray]
    match factors[0]:
        case PoseFactor():
            poses = cast(list[PoseFactor], factors)
            by_sight = [f.by_sight for f in poses]
            columns = [_gathered([f.pose for f in poses], 1, 3)]
        case LandmarkFactor():
            landmarks = cast(list[LandmarkFactor], factors)
            by_sight = [f.by_sight for f in landmarks]
            columns = [_gathered([f.landmark for f in landmarks], 1, 2), _gathered([f.seen for f in landmarks], 1, 2)]
        case HeadingFactor():
            columns = [np.array([[f.heading_rad] for f in cast(list[HeadingFactor], factors)])]
        case LineFactor():
            lines = cast(list[LineFactor], factors)
            by_sight = [f.by_sight for f in lines]
            columns = list(np.array([(f.heading_rad, f.normal_rad, f.offset_m) for f in lines]).T[..., None])
        case other:
            raise TypeError(f"no way to solve for a {type(other).__name__}")
    sighted = np.frombuffer(bytes(by_sight), dtype=np.bool_)
    return _Part(np.array(nodes), sighted, _gathered([f.covariance for f in factors], size, size), columns)


def _group(kind: type[Factor], parts: list[_Part]) -> Group:
    nodes, sighted, covariances = (np.concatenate(arrays) for arrays in list(zip(*parts, strict=True))[:3])
    columns = (np.concatenate(arrays) for arrays in zip(*(part.columns for part in parts), strict=True))
    if not np.isfinite(covariances).all():
        raise ValueError("not finite: the covariance of a factor")
    stack: FactorStack
    if kind is PoseFactor:
        (poses,) = columns
        stack = PoseStack(poses, covariances)
    elif kind is LandmarkFactor:
        on_map, seen = columns
        stack = LandmarkStack(on_map, seen, covariances)
    elif kind is HeadingFactor:
        (heading_rad,) = columns
        stack = HeadingStack(heading_rad, covariances)
    else:
        heading_rad, normal_rad, offset_m = columns
        stack = LineStack(heading_rad, normal_rad, offset_m, np.zeros((len(nodes), 2)), covariances)
    return Group(nodes, sighted, stack, _whiteners(covariances))


def _gathered(parts: list[FloatArray], *shape: int) -> FloatArray:
    """(k, *shape) of k small arrays of that size: as np.array does, in less than half the time."""
    if {part.dtype for part in parts} == {_FLOAT}:
        with suppress(ValueError, TypeError):  # one that does not lie in one piece
            joined = bytearray().join(cast(list[bytes], parts))
            return np.frombuffer(joined, dtype=np.float64).reshape(-1, *shape)
    return np.array(parts, dtype=np.float64).reshape(-1, *shape)


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


def _whiteners(covariances: FloatArray) -> FloatArray:
    """(k, m, m) lower triangular, the inverses of the Cholesky factors: for many small matrices at once."""
    size = covariances.shape[-1]
    root = np.zeros(covariances.shape[::-1])
    out = np.zeros_like(root)
    for i in range(size):
        for j in range(i + 1):
            left = covariances[:, i, j] - sum(root[m, i] * root[m, j] for m in range(j))
            if i == j and (left <= 0.0).any():
                raise np.linalg.LinAlgError("a covariance is not positive definite")
            root[j, i] = np.sqrt(left) if i == j else left / root[j, j]
        out[i, i] = 1.0 / root[i, i]
        for j in range(i):
            out[j, i] = -sum(root[m, i] * out[j, m] for m in range(j, i)) * out[i, i]
    return np.ascontiguousarray(out.T)
