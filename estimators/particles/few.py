"""A dozen samples, each with a Gaussian of its own: between a particle filter and a bank of Kalman filters.

As B-Human's self-locator does it (Laue, de Haas, Burchardt, Graf, Röfer, Härtl & Rieskamp 2009).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Estimate, Event, Hypothesis, Innovation
from estimators.config import Config
from estimators.motion import STANDSTILL, HeldVelocity, Increment
from estimators.particles.resampling import systematic
from estimators.particles.sides import Copies
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.regions import Region


@dataclass(frozen=True, slots=True)
class Few:
    """Lengths in metres, angles in radians. sigma_process, odometry: per frame, and as a share of the frame's motion,
    into each sample's covariance. translation_noise: how far each sample is thrown, as a share of a frame's motion to
    either side; turn noises likewise. stability: how much more valid another sample has to be to take over."""

    samples: int
    frames_per_s: float
    sigma_process: tuple[float, float, float]
    odometry: tuple[float, float, float]
    translation_noise: float
    turn_noise_per_rad: float
    turn_noise_per_m: float
    sigma_reset: tuple[float, float, float]
    base_validity: float
    validity_frames: int
    observations_for_reset: int
    reset_m: float
    reset_rad: float
    stability: float


class FewSamples:
    """Starts at the first whole pose, or at the solutions of the first observation that has any."""

    def __init__(self, config: Config, settings: Few) -> None:
        self._settings = settings
        self._motion = HeldVelocity(config.motion)
        self._random = np.random.default_rng(config.particles.seed)
        self._region: Region | None = None
        self._mirror = Copies(np.zeros((0, 3)))
        self._pending: Increment = STANDSTILL
        self._pending_s = 0.0
        self._poses = np.zeros((0, 3))
        self._covariances = np.zeros((0, 3, 3))  # robot frame of each
        self._validities = np.zeros(0)
        self._tracks = np.zeros(0, dtype=np.intp)
        self._next_track = 0
        self._best = 0
        self._other: FloatArray | None = None
        self._others = 0
        self._events: list[Event] = []

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, estimate.robot_covariance)

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self.advance(stamp_ns)
        self._region, self._mirror = region, Copies(region.symmetries)
        self._poses = np.zeros((0, 3))

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        before_ns = self._motion.stamp_ns
        motion = self._motion.advance(stamp_ns)
        if motion is None or before_ns is None or not len(self._poses):
            return
        self._pending = self._pending.then(motion)
        self._pending_s += (stamp_ns - before_ns) * 1e-9
        if self._other is not None:
            self._other = se2.compose(self._other, motion.before_from_after)

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if not len(self._poses):
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance)
            return None
        self._move()
        best = self._best
        residual = factor.error(self._poses[best])
        _, expected = innovation_covariance(factor, self._poses[best], self._covariances[best])
        nis = float(squared_mahalanobis(residual, expected))
        for i, pose in enumerate(self._poses):
            jacobian, spread = innovation_covariance(factor, pose, self._covariances[i])
            gain = np.linalg.solve(spread, jacobian @ self._covariances[i]).T
            left = np.eye(3) - gain @ jacobian
            self._covariances[i] = left @ self._covariances[i] @ left.T + gain @ factor.covariance @ gain.T
            self._poses[i] = se2.retract(pose, -gain @ factor.error(pose))
        return Innovation(factor.stamp_ns, residual, expected, nis, 1.0)

    def observe(self, mixture: MixtureFactor) -> None:
        self.advance(mixture.stamp_ns)
        if not len(self._poses):
            self._begin(mixture)
            return
        self._move()
        matched = self._correct(mixture)
        if mixture.by_compass:
            return
        self._validities += (matched - self._validities) / self._settings.validity_frames
        self._resample()
        self._choose()
        self._reset(mixture)

    def estimate(self) -> Estimate | None:
        if not len(self._poses) or self._motion.stamp_ns is None:
            return None
        pose, covariance = self._now(self._best)
        return Estimate(self._motion.stamp_ns, pose, covariance)

    def ambiguity(self) -> Ambiguity | None:
        """The samples, each with its share of the validity."""
        if not len(self._poses) or self._motion.stamp_ns is None:
            return None
        weights = self._validities / self._validities.sum()
        order = [self._best, *(i for i in np.argsort(-weights, kind="stable").tolist() if i != self._best)]
        found = tuple(Hypothesis(float(weights[i]), *self._now(i), int(self._tracks[i])) for i in order)
        copies = self._mirror.of(self._poses[self._best])[1:]
        near = [self._alike(copy, self._poses) for copy in copies]
        mirrored = float(weights[np.any(near, axis=0)].sum()) if near else 0.0
        return Ambiguity(self._motion.stamp_ns, found, mirrored, 0.0)

    @property
    def events(self) -> Sequence[Event]:
        return self._events

    def _now(self, sample: int) -> tuple[FloatArray, FloatArray]:
        pose = se2.compose(self._poses[sample], self._pending.before_from_after)
        robot = Increment.carry(self._covariances[sample], self._pending.before_from_after) + self._pending.covariance
        return pose, se2.rotate_covariance(robot, pose[2])

    def _believe(self, pose: FloatArray, covariance: FloatArray) -> None:
        count = self._settings.samples
        self._fill(np.tile(pose, (count, 1)), np.tile(covariance, (count, 1, 1)))

    def _begin(self, mixture: MixtureFactor) -> None:
        found = mixture.solutions()
        if not len(found.poses):
            return
        prior = 0.0 if self._region is None else self._region.log_density(found.poses)
        weights = np.exp(found.log_weights + prior - np.max(found.log_weights + prior))
        rows = systematic(weights, self._settings.samples, self._random)
        self._fill(found.poses[rows], np.tile(np.diag(np.square(self._settings.sigma_reset)), (len(rows), 1, 1)))
        self._correct(mixture)

    def _fill(self, poses: FloatArray, covariances: FloatArray) -> None:
        self._poses, self._covariances = poses.copy(), covariances.copy()
        self._validities = np.full(len(poses), 0.5)
        self._tracks = self._next_track + np.arange(len(poses))
        self._next_track += len(poses)
        self._pending, self._pending_s, self._best = STANDSTILL, 0.0, 0
        self._other, self._others = None, 0
        self._events.append(Event(self._motion.stamp_ns or 0, "start", f"{len(poses)} samples"))

    def _move(self) -> None:
        motion, settings, count = self._pending.before_from_after, self._settings, len(self._poses)
        frames = max(1.0, self._pending_s * settings.frames_per_s)
        moved = self._pending_s > 0.0
        self._pending, self._pending_s = STANDSTILL, 0.0
        if not moved:
            return
        # uniform noise of each frame, drawn once for all of them
        forward, left, turn = np.abs(motion)
        along = max(settings.translation_noise * forward, 0.5 * settings.translation_noise * left)
        across = max(settings.translation_noise * left, 0.5 * settings.translation_noise * forward)
        around = max(settings.turn_noise_per_m * np.hypot(forward, left), settings.turn_noise_per_rad * turn)
        sigma = np.array([along, across, around]) / np.sqrt(3.0 * frames)
        noise = sigma * self._random.standard_normal((count, 3))
        back = se2.adjoint(se2.inverse(motion))
        own = frames * np.square(settings.sigma_process) + np.square(settings.odometry * np.abs(motion)) / frames
        self._covariances = back @ self._covariances @ back.T + np.diag(own)
        self._poses = se2.compose(self._poses, se2.compose(motion, noise))

    def _correct(self, mixture: MixtureFactor) -> FloatArray:
        """Each sample by the likeliest solution near it; (n,) whether there is one."""
        out = mixture.expand(self._poses, self._covariances)
        matched = np.zeros(len(self._poses))
        order = np.lexsort((-out.evidence, out.parent))
        parents, first = np.unique(out.parent[order], return_index=True)
        rows = order[first]
        good = out.evidence[rows] > out.log_blind(mixture, len(self._poses))[parents]
        parents, rows = parents[good], rows[good]
        self._poses[parents] = se2.retract(self._poses[parents], out.step[rows])
        self._covariances[parents] = out.updated[rows]
        matched[parents] = 1.0
        return matched

    def _resample(self) -> None:
        base = self._settings.base_validity
        rows = np.sort(systematic(base + (1.0 - base) * self._validities, len(self._poses), self._random))
        anew = np.append(False, rows[1:] == rows[:-1])
        best = int(np.searchsorted(rows, self._best))
        self._best = best if best < len(rows) and rows[best] == self._best else -1
        self._poses, self._covariances = self._poses[rows], self._covariances[rows]
        self._validities, self._tracks = self._validities[rows], self._tracks[rows]
        self._tracks[anew] = self._next_track + np.arange(int(anew.sum()))
        self._next_track += int(anew.sum())

    def _choose(self) -> None:
        most = np.flatnonzero(self._validities == self._validities.max())
        best = int(most[np.argmin(np.trace(self._covariances[most], axis1=1, axis2=2))])
        if self._best < 0 or self._validities[best] > self._settings.stability * self._validities[self._best]:
            self._best = best

    def _reset(self, mixture: MixtureFactor) -> None:
        """The worst sample to what was seen often enough and is nowhere near the estimate and its mirror images."""
        found = mixture.solutions()
        if not len(found.poses):
            return
        now = self._poses[self._best]
        seen = found.poses[0]
        if self._other is not None and any(self._alike(self._other, copy[None])[0] for copy in self._mirror.of(seen)):
            self._others += 1
        else:
            self._others = 1
        self._other = seen
        if self._others < self._settings.observations_for_reset:
            return
        copies = self._mirror.of(seen)
        if any(self._alike(now, copy[None])[0] for copy in copies):
            return
        worst = int(np.argmin(self._validities))
        self._poses[worst] = copies[int(self._mirror.nearest(seen[None], now)[0])]
        self._covariances[worst] = np.diag(np.square(self._settings.sigma_reset))
        self._validities[worst] = max(0.5, float(self._validities.mean()))
        self._tracks[worst], self._next_track = self._next_track, self._next_track + 1
        self._events.append(Event(mixture.stamp_ns, "recovery", "a sample put to what is seen"))

    def _alike(self, pose: FloatArray, others: FloatArray) -> FloatArray:
        """(n,) bool."""
        apart = se2.between(pose, others)
        near = np.abs(apart[:, :2]).max(axis=1) < self._settings.reset_m
        return np.asarray(near & (np.abs(apart[:, 2]) < self._settings.reset_rad))
