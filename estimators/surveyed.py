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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Chain
from estimators.chain_engine import cyclic
from estimators.chain_engine.blocks import Blocks
from estimators.config import Config
from estimators.linearised import Linearised, MotionRows
from estimators.motion import OdometryCalibration
from estimators.surveyed_sights import Sights, point_by_tangent, polar_jacobian
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
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
class State:
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


class Survey:
    """One log. The border: what is free of calibration and sensor, distortions of the sensors in turn, landmarks in
    turn.

    poses (n, 3), common (GLOBALS,), distortions of the sensors, positions (m, 2) of the landmarks: where to begin, as
    of a solution of the chain on a map. field, config: what is known of the landmarks and of the robot beforehand.
    """

    def __init__(
        self,
        chain: Chain,
        poses: FloatArray,
        common: FloatArray,
        seen: Sights,
        distortions: Sequence[ScanDistortion],
        positions: FloatArray,
        field: FieldMap,
        config: Config,
    ) -> None:
        self._motions = Linearised(replace(chain, factors=()), config)
        self._seen, self._prior = seen, config.scan_distortion
        self._state = State(poses, common, np.array(distortions).reshape(-1, _DISTORTION), positions)
        self._trust = np.ones(len(seen.nodes))
        free, sigmas = self._motions.free, np.tile(self._prior.sigmas(), len(distortions))
        self._landmarks = int(free.sum()) + len(sigmas)
        # what is not free has a column in which nothing is
        of_robot = np.concatenate([self._motions.sigmas[free], np.where(sigmas > 0.0, sigmas, 1.0)])
        self._mean = np.concatenate(
            [self._motions.means[free], np.tile(self._prior.means(), len(distortions)), field.positions.ravel()]
        )
        self._size, self._free = len(self._mean), int(free.sum())
        self._information = np.diag(np.append(of_robot**-2.0, np.full(field.positions.size, EXACT_M**-2.0)))
        self._of_map = np.linalg.inv(survey_covariance(field))

    @property
    def positions(self) -> FloatArray:
        """(m, 2) of the landmarks."""
        return self._state.positions

    def seen(self) -> NDArray[np.bool_]:
        """(m,) whether it saw a landmark."""
        return np.bincount(self._seen.landmarks, minlength=len(self.positions)) > 0

    def settle(self, positions: FloatArray) -> None:
        """All but the landmarks as they are likeliest with these at positions (m, 2)."""
        self._state = replace(self._state, positions=positions)
        for _ in range(_ROUNDS):
            steps, border = cyclic.solve(self._blocks(self._information, positions), 0.0)
            self._state = replace(self._moved(steps, border), positions=positions)
            self._trust = self._trusted()
            if np.abs(steps[:, :2]).max() < _SETTLED_M:
                break

    def says(self, before: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the landmarks: mean (2m,) and covariance (2m, 2m) by this log and by the map, which has them at `before`
        (m, 2)."""
        information = self._information.copy()
        information[self._landmarks :, self._landmarks :] = self._of_map
        marginals = cyclic.marginals(self._blocks(information, before))
        own = slice(self._landmarks, None)
        return self.positions.ravel() + marginals.border_step[own], marginals.border[own, own]

    def _blocks(self, information: FloatArray, positions: FloatArray) -> Blocks:
        """The normal equations about the state, for a border that is known beforehand with that information, the
        landmarks at positions (m, 2)."""
        state, linearised, count = self._state, self._motions, len(self._state.poses)
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
        mean = np.append(self._mean[: self._landmarks], positions)
        common = state.common[linearised.free]
        at = np.concatenate([common, state.distortions.ravel(), state.positions.ravel()])
        out.corner[:-1, :-1] += information
        out.corner[:-1, -1] += information @ (mean - at)
        scans = self._seen.scans
        for start in range(0, int(scans[-1]) + 1 if len(scans) else 0, _SCANS):
            those = np.arange(*np.searchsorted(scans, [start, start + _SCANS]))
            self._add_sights(out, state, self._seen.take(those), self._trust[those])
        return out

    def _moved(self, steps: FloatArray, border: FloatArray) -> State:
        state = self._state
        common, distortions = state.common.copy(), state.distortions
        common[self._motions.free] += border[: self._free]
        return State(
            se2.retract(state.poses, steps),
            common,
            distortions + border[self._free : self._landmarks].reshape(distortions.shape),
            state.positions + border[self._landmarks :].reshape(-1, 2),
        )

    def _trusted(self) -> FloatArray:
        """(k,) share that counts of each sight, by errors that are not widened: whether something is right shows in
        each sight anew."""
        seen = self._seen
        whole = seen.covariance + seen.shared[:, :, None] ** 2 * np.eye(2)
        error, _ = self._errors(self._state, seen)
        misfit = squared_mahalanobis(error, whole)
        return np.asarray(np.minimum(1.0, (_TAIL + 2.0) / (_TAIL + misfit)))

    def _as_said(self, rows: MotionRows, state: State) -> MotionRows:
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

    def _add_sights(self, out: Blocks, state: State, seen: Sights, trust: FloatArray) -> None:
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

    def _errors(self, state: State, seen: Sights) -> tuple[FloatArray, FloatArray]:
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
