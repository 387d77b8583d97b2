"""Where the landmarks really are, by one log: its poses, what is wrong with the robot, and the landmarks, all at once.

The poses are a chain and all else is its border (estimators.chain_engine.blocks): calibration of the odometry and the
eyes, distortion of each sensor's scans, x and y of each landmark. What scans have in common is theirs too: the errors
of a scan that all of its landmarks share are unknowns of each scan, and are eliminated in place. Sights that fit badly
count less (Student's t), and landmarks are known beforehand as well as the map says. So nothing holds a common shift
and turn of all landmarks and poses but that: what is found of them has a covariance of all together.

How large the map is as a whole is hardly told either: that of the odometry and of ranges is what is to be found out. So
errors are those of what was measured, in the units of who measured it. In the map's own, a map that shrinks would make
all of them smaller, and the smallest would fit best.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Chain
from estimators.chain_engine import cyclic
from estimators.chain_engine.blocks import Blocks
from estimators.config import Config
from estimators.linearised import Linearised, MotionRows
from estimators.motion import OdometryCalibration
from estimators.solution import Solution
from estimators.surveyed_sights import Sights, point_by_tangent, polar_jacobian
from fieldloc import pose as se2
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.scan_distortion import ScanDistortion, log_depth

EXACT_M = 1e-4  # how well a landmark is known of which the map says that it is exact
_ROUNDS = 10
_SETTLED_M = 1e-4
_TAIL = 4.0  # degrees of freedom of a Student t: what fits badly counts less
_SCANS = 512  # at a time
_DISTORTION = len(ScanDistortion._fields)
_SCALE = OdometryCalibration._fields.index("scale")


@dataclass(frozen=True, slots=True, eq=False)
class Surveyed:
    """Of m landmarks: positions (m, 2), covariance (2m, 2m) of x and y of each in turn, the map's own word included.
    sights: (m,) how often each was seen."""

    positions: FloatArray
    covariance: FloatArray
    sights: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """poses (n, 3); common (GLOBALS,); distortions (s, 4) of the sensors; positions (m, 2)."""

    poses: FloatArray
    common: FloatArray
    distortions: FloatArray
    positions: FloatArray


def survey_covariance(field: FieldMap) -> FloatArray:
    """(2m, 2m) of the landmarks' positions by the map alone."""
    count = len(field.landmarks)
    out = np.zeros((count, 2, count, 2))
    at = np.arange(count)
    out[at, :, at] = field.positions_covariance + EXACT_M**2 * np.eye(2)
    return out.reshape(2 * count, 2 * count)


def surveyed(
    chain: Chain,
    near: Solution,
    seen: Sights,
    distortions: Sequence[ScanDistortion],
    field: FieldMap,
    config: Config,
) -> Surveyed:
    """near: the chain's solution, on the map as it was thought to be. distortions: of the sensors, where to begin.
    field: what is known of the landmarks beforehand. config: what is known of the robot beforehand."""
    problem = _Problem(chain, seen, field, config, len(distortions))
    common = np.array([*near.calibration, *near.sensor])
    state = _State(near.poses, common, np.array(distortions).reshape(-1, _DISTORTION), field.positions)
    trust = np.ones(len(seen.nodes))
    for _ in range(_ROUNDS):
        steps, border = cyclic.solve(problem.blocks(state, trust), 0.0)
        before, state = state, problem.moved(state, steps, border)
        trust = problem.trust(state)
        if np.abs(state.positions - before.positions).max(initial=0.0) < _SETTLED_M:
            break
    marginals = cyclic.marginals(problem.blocks(state, trust))
    size = 2 * len(field.landmarks)
    counts = np.bincount(seen.landmarks, minlength=len(field.landmarks))
    return Surveyed(state.positions, marginals.border[-size:, -size:], counts)


class _Problem:
    """The border: what is free of calibration and sensor, distortions of the sensors in turn, landmarks in turn."""

    def __init__(self, chain: Chain, seen: Sights, field: FieldMap, config: Config, sensors: int) -> None:
        self._motions = Linearised(Chain(chain.stamps_ns, chain.motions, (), chain.guess), config)
        self._seen, self._field, self._prior = seen, field, config.scan_distortion
        self._free = int(self._motions.free.sum())
        self._landmarks = self._free + _DISTORTION * sensors
        self._size = self._landmarks + 2 * len(field.landmarks)
        # what is not free has a column in which nothing is
        self._open = np.tile(self._prior.sigmas() > 0.0, sensors)
        self._information = np.linalg.inv(survey_covariance(field))

    def blocks(self, state: _State, trust: FloatArray) -> Blocks:
        """The normal equations about a state; trust: (k,) share that counts of each sight."""
        count, linearised = len(state.poses), self._motions
        out = Blocks.zeros(count, 3, self._size)
        rows = self._as_said(linearised.motions(state.poses, state.common), state)
        before, after, towards = rows.before, rows.after, rows.towards[..., None]
        edge = np.concatenate([rows.by_globals, np.zeros((count - 1, 3, self._size - self._free)), towards], axis=-1)
        out.diagonal[:-1] += _t(before) @ before
        out.diagonal[1:] += _t(after) @ after
        out.following[:] += _t(before) @ after
        out.border[:-1] += _t(before) @ edge
        out.border[1:] += _t(after) @ edge
        flat = edge.reshape(-1, self._size + 1)
        out.corner[:] += flat.T @ flat
        first = linearised.first(state.poses)
        out.diagonal[0] += first.by_pose[0].T @ first.by_pose[0]
        out.border[0, :, -1] += first.by_pose[0].T @ first.towards[0]
        self._add_priors(out, state)
        scans = self._seen.scans
        for start in range(0, int(scans[-1]) + 1 if len(scans) else 0, _SCANS):
            at = np.arange(*np.searchsorted(scans, [start, start + _SCANS]))
            self._add_sights(out, state, self._seen.take(at), trust[at])
        return out

    def moved(self, state: _State, steps: FloatArray, border: FloatArray) -> _State:
        common, distortions = state.common.copy(), state.distortions
        common[self._motions.free] += border[: self._free]
        return _State(
            se2.retract(state.poses, steps),
            common,
            distortions + border[self._free : self._landmarks].reshape(distortions.shape),
            state.positions + border[self._landmarks :].reshape(-1, 2),
        )

    def trust(self, state: _State) -> FloatArray:
        """(k,) by errors that are not widened: whether something is right shows in each sight anew."""
        seen = self._seen
        whole = seen.covariance + seen.shared[:, :, None] ** 2 * np.eye(2)
        error, _ = self._errors(state, seen)
        misfit = np.einsum("ki,ki->k", error, np.linalg.solve(whole, error[..., None])[..., 0])
        return np.asarray(np.minimum(1.0, (_TAIL + 2.0) / (_TAIL + misfit)))

    def _as_said(self, rows: MotionRows, state: _State) -> MotionRows:
        """Motions' errors in the odometry's metres."""
        longer = 1.0 + float(state.common[_SCALE])
        roots = self._motions.motion_roots
        back = np.linalg.inv(roots)
        shrink, slope = np.diag([1.0 / longer, 1.0 / longer, 1.0]), np.diag([-1.0, -1.0, 0.0]) / longer**2
        whole = roots @ shrink @ back
        by_globals = whole @ rows.by_globals
        if self._motions.free[_SCALE]:
            by_globals[..., 0] -= (roots @ slope @ back @ rows.towards[..., None])[..., 0]
        towards = (whole @ rows.towards[..., None])[..., 0]
        return MotionRows(whole @ rows.before, whole @ rows.after, by_globals, towards)

    def _add_priors(self, out: Blocks, state: _State) -> None:
        linearised, free = self._motions, self._motions.free
        weights = np.ones(self._size)
        off = np.zeros(self._size)
        weights[: self._free] = linearised.sigmas[free] ** -2.0
        off[: self._free] = (linearised.means - state.common)[free]
        scans = slice(self._free, self._landmarks)
        weights[scans][self._open] = np.tile(self._prior.sigmas(), len(state.distortions))[self._open] ** -2.0
        off[scans] = (self._prior.means() - state.distortions).ravel() * self._open
        information = np.diag(weights)
        information[self._landmarks :, self._landmarks :] = self._information
        off[self._landmarks :] = (self._field.positions - state.positions).ravel()
        out.corner[:-1, :-1] += information
        out.corner[:-1, -1] += information @ off

    def _add_sights(self, out: Blocks, state: _State, seen: Sights, trust: FloatArray) -> None:
        """Errors that all of a scan share are eliminated: scan by scan, of unit variance."""
        error, rows = self._errors(state, seen)
        root = np.sqrt(seen.wider)
        weight = trust[:, None, None] * np.linalg.inv(seen.covariance * root[:, :, None] * root[:, None, :])
        shared = seen.shared * np.sqrt(seen.wider_shared)
        rows = np.concatenate([rows, error[..., None]], axis=-1)
        weighted = weight @ rows
        by_pose, by_border = rows[..., :3], weighted[..., 3:]
        np.add.at(out.diagonal, seen.nodes, _t(by_pose) @ weighted[..., :3])
        np.add.at(out.border, seen.nodes, _t(by_pose) @ by_border)
        out.corner[:] += rows[..., 3:].reshape(-1, self._size + 1).T @ by_border.reshape(-1, self._size + 1)
        if not shared.any():
            return
        _, first = np.unique(seen.scans, return_index=True)
        nodes = seen.nodes[first]
        across = np.add.reduceat(_t(weighted) * shared[:, None, :], first)  # (scans, 3 + border, 2)
        alone = np.eye(2) + np.add.reduceat(shared[:, :, None] * weight * shared[:, None, :], first)
        solved = across @ np.linalg.inv(alone)
        np.subtract.at(out.diagonal, nodes, solved[:, :3] @ _t(across[:, :3]))
        np.subtract.at(out.border, nodes, solved[:, :3] @ _t(across[:, 3:]))
        left, right = (each[:, 3:].swapaxes(0, 1).reshape(self._size + 1, -1) for each in (solved, across))
        out.corner[:] -= left @ right.T

    def _errors(self, state: _State, seen: Sights) -> tuple[FloatArray, FloatArray]:
        """Of range and bearing, seen less expected (k, 2); change of the latter with pose and border (k, 2, q)."""
        turned, by_common = (each[seen.nodes] for each in self._motions.sights(state.common))
        at = se2.compose(se2.retract(state.poses[seen.nodes], turned), seen.mounts)
        there = se2.apply(se2.inverse(at), state.positions[seen.landmarks])
        true = np.stack([np.hypot(there[:, 0], there[:, 1]), np.arctan2(there[:, 1], there[:, 0])], axis=-1)
        expected, by_true = _distorted(true, state.distortions[seen.sensors])
        error = seen.range_bearing - expected
        error[:, 1] = se2.wrap(error[:, 1])
        by_point = by_true @ polar_jacobian(there)
        by_eyes = by_point @ point_by_tangent(there) @ se2.adjoint(se2.inverse(seen.mounts))
        out = np.zeros((len(error), 2, 3 + self._size))
        out[..., :3] = by_eyes @ se2.adjoint(se2.inverse(se2.exp(turned)))
        out[..., 3 : 3 + self._free] = (by_eyes @ se2.right_jacobian(turned) @ by_common)[..., self._motions.free]
        each = np.arange(len(error))
        distortions = _by_distortion(expected, true[:, 1]) * (self._prior.sigmas() > 0.0)
        place = by_point @ _t(se2.rotation(at[:, 2]))
        begins = 3 + self._free + _DISTORTION * seen.sensors
        for column in range(_DISTORTION):
            out[each, :, begins + column] = distortions[..., column]
        begins = 3 + self._landmarks + 2 * seen.landmarks
        for column in range(2):
            out[each, :, begins + column] = place[..., column]
        return error, out


def _distorted(true: FloatArray, distortions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What sensors of distortions (k, 4) have for ranges and bearings (k, 2), and its change with these (k, 2, 2)."""
    log_scale, depth, askew, bearing_scale = distortions.T
    r, b = true.T
    longer = np.exp(log_scale + depth * log_depth(b) + askew * np.sin(b))
    slope = askew * np.cos(b) - depth * np.tan(b) * (log_depth(b) > log_depth(np.array(np.pi)))
    out = np.zeros((len(r), 2, 2))
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 1] = longer, r * longer * slope, 1.0 + bearing_scale
    return np.stack([r * longer, b * (1.0 + bearing_scale)], axis=-1), out


def _by_distortion(expected: FloatArray, bearing_rad: FloatArray) -> FloatArray:
    """(k, 2, 4): change of expected ranges and bearings (k, 2), of things at the bearings (k,), with a distortion."""
    r, b = expected[:, 0], bearing_rad
    out = np.zeros((len(r), 2, _DISTORTION))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2], out[:, 1, 3] = r, r * log_depth(b), r * np.sin(b), b
    return out


def _t(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)
