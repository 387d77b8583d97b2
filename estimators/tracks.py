"""Robots followed through a whole log, forwards and backwards, each from one place where it may have been.

A track is one extended Kalman filter that takes of each mixture the solution that fits it best, or none. All tracks
move and see at once (stacked arrays). Its states are pose, compass offset, the odometry's calibration and the sensor's.

Poses are those of symmetric mixtures. What tells sides apart is asked at the track's copy under the map's symmetries:
steps and covariances, being in the robot frame, are the same for both.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Recorded, levers
from estimators.config import Config
from estimators.motion import CALIBRATION, Increment
from estimators.sensor import SENSOR
from estimators.solution import global_means, global_sigmas
from estimators.ways import Ways
from fieldloc import pose as se2
from fieldloc.mixture import Expansion, IntArray, MixtureFactor
from fieldloc.pose import FloatArray

NO_HINT = -2
_OFFSET = 3
_CALIBRATION = slice(4, 4 + CALIBRATION)
_SENSOR = slice(4 + CALIBRATION, 4 + CALIBRATION + SENSOR)
_STATES = _SENSOR.stop
_ODOMETRY, _EYES = slice(1, 1 + CALIBRATION), slice(1 + CALIBRATION, None)  # in what is kept beside the pose
LEARNT_FROM = 60  # sights after a seed
_ROUGHLY = np.diag([0.3, 0.3, 0.15]) ** 2
_HINT_WORTH = 10.0  # a hint is followed while it is at most so much (log) less likely than the best


@dataclass(frozen=True, slots=True, eq=False)
class Seed:
    """Where a track begins: a whole pose (3,) with covariance (3, 3), robot frame, from the mixture of index `at`.

    copy: (3,) the symmetry that takes it to where the robot is, zero for none. log_weight: log of the integral over
    poses of that mixture's solution. hints: (t,) solutions to prefer, of each mixture, -1 for none of them, NO_HINT
    where the track decides.
    """

    at: int
    node: int
    choice: int
    pose: FloatArray
    covariance: FloatArray
    copy: FloatArray
    log_weight: float
    hints: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """k tracks through t mixtures and n nodes.

    log_evidence: (k, t) of each mixture in the light of what lies between it and the seed, all of its solutions and the
    outlier together. choices: (k, t) solutions taken, -1 for none; margins: by how much (log)
    each was better than the next. poses: (k, n, 3). covariances: (k, t, 3, 3), robot frame, of the poses once each
    mixture was seen; start_covariances: (k, 3, 3) of those at the first node.
    """

    log_evidence: FloatArray
    choices: IntArray
    margins: FloatArray
    poses: FloatArray
    covariances: FloatArray
    start_covariances: FloatArray

    def __getitem__(self, rows: IntArray) -> "Tracks":
        return Tracks(*(getattr(self, column.name)[rows] for column in fields(self)))

    def beside(self, others: "Tracks") -> "Tracks":
        """These tracks, then the others."""
        columns = [column.name for column in fields(self)]
        return Tracks(*(np.concatenate([getattr(self, name), getattr(others, name)]) for name in columns))


def follow(recorded: Recorded, seeds: tuple[Seed, ...], config: Config) -> Tracks:
    sweep = _Sweep(recorded, seeds, config)
    sweep.run_forwards()
    sweep.begin_again()
    sweep.run_backwards()
    return Tracks(
        sweep.log_evidence,
        sweep.choices,
        sweep.margins,
        sweep.poses,
        sweep.covariances,
        sweep.covariance[:, :3, :3],
    )


class _Sweep:
    def __init__(self, recorded: Recorded, seeds: tuple[Seed, ...], config: Config) -> None:
        self._recorded, self._seeds, self._compass = recorded, seeds, config.compass
        tracks, nodes, mixtures = len(seeds), len(recorded.stamps_ns), len(recorded.mixtures)
        self._hints = np.array([seed.hints for seed in seeds]).reshape(tracks, mixtures)
        self._forwards = True
        self._seed_nodes = np.array([seed.node for seed in seeds])
        self._seed_indices = np.array([seed.at for seed in seeds])
        self._from = self._seed_indices.copy()
        self._copies = np.array([seed.copy for seed in seeds])
        self._at_node: dict[int, list[int]] = {}
        for index, (node, _) in enumerate(recorded.mixtures):
            self._at_node.setdefault(node, []).append(index)
        self._begins: dict[int, list[int]] = {}
        for track, seed in enumerate(seeds):
            self._begins.setdefault(seed.node, []).append(track)
        self.log_evidence = np.zeros((tracks, mixtures))
        self.margins = np.zeros((tracks, mixtures))
        self.choices = np.full((tracks, mixtures), -1, dtype=np.intp)
        self.poses = np.zeros((tracks, nodes, 3))
        self.covariances = np.tile(np.eye(3), (tracks, mixtures, 1, 1))
        self._pose = np.zeros((tracks, 3))
        # offset, calibration, sensor
        self._rest = np.tile(np.concatenate([np.zeros(1), global_means(config)]), (tracks, 1))
        self._levers = levers(recorded.stamps_ns, recorded.motions)
        self._ways = Ways.of(recorded.motions, np.array(sorted(self._at_node), dtype=np.intp))
        self._alive = np.zeros(tracks, dtype=bool)
        prior = np.concatenate([np.ones(3), [config.compass.offset_sigma_rad], global_sigmas(config)]) ** 2
        self.covariance = np.tile(np.diag(prior), (tracks, 1, 1))

    def begin_again(self) -> None:
        """A while after the seeds, so that it is known well where they are; with what has been learnt of the odometry.

        The compass' offset is another one by then. What is seen again up to the seed is read as it was before.
        """
        self._alive[:] = False
        self._rest[:, 0] = 0.0
        self.covariance[:, _OFFSET] = self.covariance[:, :, _OFFSET] = 0.0
        self.covariance[:, _OFFSET, _OFFSET] = self._compass.offset_sigma_rad**2
        self._forwards = False
        self._begins = {}
        places = np.array([not mixture.by_compass for _, mixture in self._recorded.mixtures])
        for track, seed in enumerate(self._seeds):
            known = places & (self.choices[track] >= 0) & (self._hints[track] != NO_HINT)
            sights = seed.at + 1 + np.flatnonzero(known[seed.at + 1 :])[:LEARNT_FROM]
            self._from[track] = sights[-1] if len(sights) else seed.at - 1
            node = self._recorded.mixtures[sights[-1]][0] if len(sights) else seed.node
            self._begins.setdefault(node, []).append(track)
            self._hints[track, seed.at :] = self.choices[track, seed.at :]

    def run_forwards(self) -> None:
        """Moves from stop to stop; in between, the odometry is as it was thought to be at the stop before."""
        ways, stamps_ns = self._ways, self._recorded.stamps_ns
        alive, poses, calibrations = self._stories()
        for stop, node in enumerate(ways.stops.tolist()):
            if self._alive.any():
                elapsed_s = (stamps_ns[node] - stamps_ns[ways.stops[stop - 1]]) * 1e-9
                self._move(ways.stages[stop - 1], elapsed_s, True)
            self._look(node)
            alive[stop], poses[stop], calibrations[stop] = self._alive, self._pose, self._rest[:, _ODOMETRY]
        at = ways.since
        changed = (ways.by_calibration[:, None] @ calibrations[at][..., None])[..., 0]
        out = se2.compose(poses[at], se2.retract(ways.moved[:, None], changed))
        self.poses[:] = np.where(alive[at][..., None], out, 0.0).swapaxes(0, 1)

    def run_backwards(self) -> None:
        """As forwards; in between, as at the stop after."""
        ways, stamps_ns = self._ways, self._recorded.stamps_ns
        alive, poses, calibrations = self._stories()
        last = int(np.searchsorted(ways.stops, max(self._begins)))
        for stop in range(last, -1, -1):
            node = int(ways.stops[stop])
            if self._alive.any():
                elapsed_s = (stamps_ns[ways.stops[stop + 1]] - stamps_ns[node]) * 1e-9
                self._move(ways.stages[stop], elapsed_s, False)
            self._look(node)
            alive[stop], poses[stop], calibrations[stop] = self._alive, self._pose, self._rest[:, _ODOMETRY]
        nodes = np.arange(len(stamps_ns))
        at = np.minimum(ways.since + (nodes != ways.stops[ways.since]), len(ways.stops) - 1)
        changed = (ways.left_by_calibration[:, None] @ calibrations[at][..., None])[..., 0]
        out = se2.compose(poses[at], se2.inverse(se2.retract(ways.left[:, None], changed)))
        new = alive[at] & (nodes[:, None] < self._seed_nodes)
        self.poses[:] = np.where(new[..., None], out, self.poses.swapaxes(0, 1)).swapaxes(0, 1)

    def _stories(self) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Room for which tracks are alive at each stop, (s, k), their poses and the odometry's calibration."""
        shape = len(self._ways.stops), len(self._seeds)
        return np.zeros(shape, dtype=bool), np.zeros((*shape, 3)), np.zeros((*shape, CALIBRATION))

    def _look(self, node: int) -> None:
        """At all that was seen at a node, by the tracks that have begun."""
        begin = self._begins.get(node, [])
        for track in begin:
            self._begin(track, node)
        at = self._at_node.get(node, [])
        for index in at if self._forwards else reversed(at):
            late = [t for t in begin if (index <= self._from[t] if self._forwards else index > self._from[t])]
            self._see(index, node, np.setdiff1d(np.flatnonzero(self._alive), late))

    def _begin(self, track: int, node: int) -> None:
        seed = self._seeds[track]
        self._alive[track] = True
        self.covariance[track, :3] = 0.0
        self.covariance[track, :, :3] = 0.0
        if self._forwards or node == seed.node:
            self._pose[track], self.covariance[track, :3, :3] = seed.pose, seed.covariance
        else:
            self._pose[track], self.covariance[track, :3, :3] = self.poses[track, node], _ROUGHLY
        self.log_evidence[track, seed.at], self.covariances[track, seed.at] = seed.log_weight, seed.covariance
        self.choices[track, seed.at] = seed.choice

    def _move(self, motion: Increment, elapsed_s: float, forwards: bool) -> None:
        moved = se2.retract(motion.before_from_after, self._rest[:, _ODOMETRY] @ motion.by_calibration.T)
        carry = np.tile(np.eye(_STATES), (len(moved), 1, 1))
        back = se2.inverse(moved)
        if forwards:
            self._pose = se2.compose(self._pose, moved)
            carry[:, :3, :3] = se2.adjoint(back)
            carry[:, :3, _CALIBRATION] = motion.by_calibration
            noise = np.broadcast_to(motion.covariance, (len(moved), 3, 3))
        else:  # before = after exp(-error) moved^-1
            self._pose = se2.compose(self._pose, back)
            there = se2.adjoint(moved)
            carry[:, :3, :3] = there
            carry[:, :3, _CALIBRATION] = -there @ motion.by_calibration
            noise = there @ motion.covariance @ np.swapaxes(there, -1, -2)
        keep, gained = self._compass.wander(elapsed_s)
        carry[:, _OFFSET, _OFFSET] = keep
        self._rest[:, 0] *= keep
        self.covariance = carry @ self.covariance @ np.swapaxes(carry, -1, -2)
        self.covariance[:, :3, :3] += noise
        self.covariance[:, _OFFSET, _OFFSET] += gained

    def _see(self, index: int, node: int, tracks: IntArray) -> None:
        if not len(tracks):
            return
        mixture: MixtureFactor = self._recorded.mixtures[index][1]
        to_seen = np.tile(np.eye(3, _STATES), (len(tracks), 1, 1))
        poses = self._pose[tracks]
        if not mixture.symmetric:
            poses = se2.compose(self._copies[tracks], poses)
        if mixture.by_compass:
            to_seen[:, 2, _OFFSET] = 1.0
            poses[:, 2] = se2.wrap(poses[:, 2] + self._rest[tracks, 0])
        if mixture.by_sight:
            turned = self._rest[tracks, _EYES] @ self._levers[node].T
            poses = se2.retract(poses, turned)
            to_seen[:, :, :3] = se2.adjoint(se2.inverse(se2.exp(turned)))
            to_seen[:, :, _SENSOR] = self._levers[node]
        whole = self.covariance[tracks]
        across = whole @ np.swapaxes(to_seen, -1, -2)
        seen = to_seen @ across
        near = mixture.expand(poses, seen)
        rows, margins, log_evidence = picked(near, near.log_blind(mixture, len(tracks)), self._hints[tracks, index])
        new = np.ones(len(tracks), dtype=bool) if self._forwards else index < self._seed_indices[tracks]
        self.margins[tracks[new], index] = margins[new]
        self.log_evidence[tracks[new], index] = log_evidence[new]
        self.choices[tracks[new], index] = np.where(rows >= 0, near.ids[rows] if len(near.ids) else -1, -1)[new]
        hit = np.flatnonzero(rows >= 0)
        if len(hit):
            self._update(tracks[hit], near, rows[hit], across[hit], seen[hit])
        self.covariances[tracks[new], index] = self.covariance[tracks[new], :3, :3]

    def _update(self, tracks: IntArray, near: Expansion, rows: IntArray, across: FloatArray, seen: FloatArray) -> None:
        """rows: of the solutions that the tracks take. across: (h, _STATES, 3) of states and sights."""
        whole = self.covariance[tracks]
        gain = np.swapaxes(np.linalg.solve(seen, np.swapaxes(across, -1, -2)), -1, -2)
        step = (gain @ near.step[rows][:, :, None])[..., 0]
        left = whole - gain @ (seen - near.updated[rows]) @ np.swapaxes(gain, -1, -2)
        turn = se2.right_jacobian(step[:, :3])
        left[:, :3] = turn @ left[:, :3]
        left[:, :, :3] = left[:, :, :3] @ np.swapaxes(turn, -1, -2)
        self._pose[tracks] = se2.retract(self._pose[tracks], step[:, :3])
        self._rest[tracks] += step[:, 3:]
        self.covariance[tracks] = 0.5 * (left + np.swapaxes(left, -1, -2))


def picked(near: Expansion, log_blind: FloatArray, hints: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Row of the best solution per parent (h,), -1 where none is better than the outlier; by how much (log) it beats
    the next best; the evidence of all together.

    log_blind: (h,) evidence of the outlier. hints: (h,) ids that are taken rather than a slightly better one.
    """
    rows = np.full(len(log_blind), -1, dtype=np.intp)
    best, total = log_blind.copy(), log_blind.copy()
    next_best = np.full(len(log_blind), -np.inf)
    if len(near.ids):
        evidence = near.evidence
        np.logaddexp.at(total, near.parent, evidence)
        worth = evidence + np.where(near.ids == hints[near.parent], _HINT_WORTH, 0.0)
        best[hints == -1] += _HINT_WORTH
        for row in np.argsort(worth, kind="stable"):
            parent = near.parent[row]
            if worth[row] > best[parent]:
                rows[parent], next_best[parent], best[parent] = row, best[parent], worth[row]
            else:
                next_best[parent] = max(next_best[parent], worth[row])
    return rows, best - next_best - np.where(hints != NO_HINT, _HINT_WORTH, 0.0), total
