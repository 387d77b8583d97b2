"""Adaptive Monte Carlo localization as it is commonly built (Thrun, Burgard & Fox 2005, tables 5.6, 8.2, 8.3, 8.4).

What `ParticleFilter` does beyond it is left out on purpose: proposals, regularisation, calibration, folding.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Estimate, Event, Innovation
from estimators.config import Config
from estimators.motion import STANDSTILL, HeldVelocity, Increment
from estimators.particles.answer import Tracks, best_of, hypotheses
from estimators.particles.cloud import Cloud, Moments, moments, regroup
from estimators.particles.clusters import occupied
from estimators.particles.resampling import kld_size, systematic
from estimators.particles.sides import Copies
from estimators.particles.weighing import scattered
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.regions import Region, draw

_ALONE = Copies(np.zeros((0, 3)))
_FLOOR = 8.0  # a factor four sigmas off is as good as a random one


@dataclass(frozen=True, slots=True)
class Classic:
    """alphas: of the odometry's motion model. hit, random_share: of an observation, how much is taken for right and for
    anything. recovery: the slow and the fast average's rates, which decide how many particles start anew anywhere.
    min_move_m, min_turn_rad: nothing is weighed before the robot has moved so far."""

    min_count: int
    max_count: int
    kld_error: float
    kld_quantile: float
    bin_m: float
    bin_rad: float
    alphas: tuple[float, float, float, float]
    hit: float
    random_share: float
    recovery: tuple[float, float]
    min_move_m: float
    min_turn_rad: float
    resample_every: int


class ClassicMcl:
    """Starts anywhere in its region with as many particles as there may be."""

    def __init__(self, config: Config, settings: Classic) -> None:
        self._settings = settings
        self._nothing_right = config.detection.nothing_right
        self._motion = HeldVelocity(config.motion)
        self._random = np.random.default_rng(config.particles.seed)
        self._tracks = Tracks()
        self._region: Region | None = None
        self._mirror = _ALONE
        self._pending: Increment = STANDSTILL
        self._cloud: Cloud | None = None
        self._moments = Moments(np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)))
        self._slow = self._fast = 0.0
        self._updates = 0

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, estimate.robot_covariance)

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self.advance(stamp_ns)
        self._region, self._mirror = region, Copies(region.symmetries)
        self._take(self._anywhere(self._settings.max_count))

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        motion = self._motion.advance(stamp_ns)
        if motion is not None and self._cloud is not None:
            self._pending = self._pending.then(motion)

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if self._cloud is None:
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance)
            return None
        self._move()
        mean, covariance, _ = best_of(self._cloud, self._moments, _ALONE)
        residual = factor.error(mean)
        _, expected = innovation_covariance(factor, mean, covariance)
        nis = float(squared_mahalanobis(residual, expected))
        error = factor.error(self._cloud.poses)
        misfit = np.einsum("ni,ij,nj->n", error, np.linalg.inv(factor.covariance), error)
        self._weigh(
            np.logaddexp(math.log(self._settings.hit) - 0.5 * misfit, math.log(self._settings.random_share) - _FLOOR)
        )
        return Innovation(factor.stamp_ns, residual, expected, nis, 1.0)

    def observe(self, mixture: MixtureFactor) -> None:
        self.advance(mixture.stamp_ns)
        if self._cloud is None:
            if self._region is None:
                return
            self._take(self._anywhere(self._settings.max_count))
        moved = self._pending.before_from_after
        if np.hypot(moved[0], moved[1]) < self._settings.min_move_m and abs(moved[2]) < self._settings.min_turn_rad:
            return
        self._move()
        assert self._cloud is not None
        right = math.log(self._settings.hit) + mixture.log_likelihood(self._cloud.poses)
        wrong = math.log(self._settings.random_share / self._nothing_right) + mixture.log_outlier
        self._weigh(np.logaddexp(right, wrong))

    def estimate(self) -> Estimate | None:
        if self._cloud is None or self._motion.stamp_ns is None:
            return None
        mean, covariance, _ = best_of(self._cloud, self._moments, _ALONE)
        pose, carried = self._carried(mean, covariance)
        return Estimate(self._motion.stamp_ns, pose, carried)

    def ambiguity(self) -> Ambiguity | None:
        if self._cloud is None or self._motion.stamp_ns is None:
            return None
        found = hypotheses(self._cloud, self._moments, _ALONE, self._tracks, 0.0, self._carried, self._mirror)
        return Ambiguity(self._motion.stamp_ns, found.hypotheses, found.mirrored, 0.0)

    @property
    def events(self) -> Sequence[Event]:
        return self._tracks.events

    def _carried(self, pose: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        now = se2.compose(pose, self._pending.before_from_after)
        robot = Increment.carry(covariance, self._pending.before_from_after) + self._pending.covariance
        return now, se2.rotate_covariance(robot + 1e-9 * np.eye(3), now[2])

    def _believe(self, pose: FloatArray, robot_covariance: FloatArray) -> None:
        self._take(_uniform(scattered(pose, robot_covariance, self._settings.max_count, self._random)))

    def _anywhere(self, count: int) -> Cloud:
        assert self._region is not None
        return _uniform(draw(self._region, count, self._random))

    def _take(self, cloud: Cloud) -> None:
        cloud.labels, _, _ = regroup(cloud)
        self._cloud, self._pending = cloud, STANDSTILL
        self._summarise()

    def _summarise(self) -> None:
        cloud = self._cloud
        assert cloud is not None
        self._moments = moments(cloud, cloud.labels, int(cloud.labels.max()) + 1)
        self._tracks.follow(cloud, self._moments, self._motion.stamp_ns or 0)

    def _move(self) -> None:
        """Turn, go, turn, each with noise of its own (table 5.6)."""
        cloud, motion = self._cloud, self._pending.before_from_after
        assert cloud is not None
        self._pending = STANDSTILL
        far = float(np.hypot(motion[0], motion[1]))
        first = math.atan2(motion[1], motion[0]) if far > 0.01 else 0.0
        # driving backwards is no turn
        first = float(se2.wrap(first + np.pi)) if abs(first) > 0.5 * np.pi else first
        signed = far if math.cos(math.atan2(motion[1], motion[0]) - first) >= 0.0 else -far
        last = float(se2.wrap(motion[2] - first))
        a1, a2, a3, a4 = self._settings.alphas
        noise = self._random.standard_normal((len(cloud), 3))
        turn = first + math.sqrt(a1 * first**2 + a2 * far**2) * noise[:, 0]
        way = signed + math.sqrt(a3 * far**2 + a4 * (first**2 + last**2)) * noise[:, 1]
        back = last + math.sqrt(a1 * last**2 + a2 * far**2) * noise[:, 2]
        step = np.column_stack([way * np.cos(turn), way * np.sin(turn), turn + back])
        cloud.poses = se2.compose(cloud.poses, step)

    def _weigh(self, log_likelihood: FloatArray) -> None:
        cloud = self._cloud
        assert cloud is not None
        top = float(log_likelihood.max())
        weights = cloud.weights * np.exp(log_likelihood - top)
        mean = float(weights.sum()) * math.exp(min(top, 600.0))
        for_slow, for_fast = self._settings.recovery
        self._slow += (mean - self._slow) * (for_slow if self._slow else 1.0)
        self._fast += (mean - self._fast) * (for_fast if self._fast else 1.0)
        cloud.weights = weights / weights.sum()
        self._updates += 1
        if self._updates % self._settings.resample_every == 0:
            self._resample()
        self._summarise()

    def _resample(self) -> None:
        cloud, settings = self._cloud, self._settings
        assert cloud is not None
        kept = systematic(cloud.weights, len(cloud), self._random)
        bins = occupied(cloud.poses[kept], settings.bin_m, settings.bin_rad)
        count = int(
            np.clip(kld_size(bins, settings.kld_error, settings.kld_quantile), settings.min_count, settings.max_count)
        )
        anew = 0
        if settings.recovery[1] > 0.0 and self._region is not None:
            anew = int(self._random.binomial(count, max(0.0, 1.0 - self._fast / self._slow)))
        poses = cloud.poses[systematic(cloud.weights, count - anew, self._random)] if anew < count else cloud.poses[:0]
        if anew:
            poses = np.concatenate([poses, self._anywhere(anew).poses])
            self._slow = self._fast = 0.0
        self._cloud = _uniform(poses)
        self._cloud.labels, _, _ = regroup(self._cloud)


def _uniform(poses: FloatArray) -> Cloud:
    count = len(poses)
    labels = np.zeros(count, dtype=np.intp)
    return Cloud(poses, np.zeros(count), np.full(count, 1.0 / count), np.ones((count, 1)), labels)
