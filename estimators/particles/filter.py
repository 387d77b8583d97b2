"""The particle filter: motion, weighing, recovery and answers, one step a line."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from estimators.base import Ambiguity, Estimate, Event, Innovation
from estimators.config import Config
from estimators.divergence import Restart
from estimators.legs import Legs
from estimators.motion import CALIBRATION, STANDSTILL, HeldVelocity, Increment
from estimators.particles.answer import Tracks, best_of, hypotheses
from estimators.particles.calibration import CalibrationBelief
from estimators.particles.cloud import Cloud, Moments, moments, places, regroup
from estimators.particles.likelihoods import FactorLikelihood, mixture_likelihood
from estimators.particles.proposal import proposed
from estimators.particles.recovery import Elsewhere
from estimators.particles.sides import Copies
from estimators.particles.weighing import LogLikelihood, drawn, exact, scattered, weigh, weigh_where_sent
from estimators.views import EXTRA, EYES, LATE, View, Views, of_factor, prior
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.regions import Region

_CONSTANT = EXTRA - 1
_NEWBORN = 1e-3  # a find of less weight is left to the next observation


class ParticleFilter:
    """Starts at the first whole pose, or anywhere in a region (`start_in`) from what the first observation allows.

    Motion is gathered and drawn for the particles only when something is observed: in between the estimate is carried
    along. The particles are at the pose that the last observation was about (`estimators.views`). What odometry and
    eyes get wrong and the side of the field are marginalised, the compass' offset is part of a particle.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._motion = HeldVelocity(config.motion, config.calibration.odometry_delay_s)
        self._views = Views(config, self._motion)
        self._legs = Legs(config.motion)
        self._leg = -1
        self._motion.scales = self._legs.scales
        self._restart = Restart(config.robust.restart_after)
        self._random = np.random.default_rng(config.particles.seed)
        mean, known = prior(config)
        self._calibration = CalibrationBelief(mean[:_CONSTANT], known[:_CONSTANT, :_CONSTANT])
        self._view = self._views.now(mean)
        self._region: Region | None = None
        self._elsewhere = Elsewhere(config.particles, None)
        self._tracks = Tracks()
        self._pending: Increment = STANDSTILL
        self._pending_s = 0.0
        self._cloud: Cloud | None = None
        self._moments = Moments(np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)))

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._scatter(estimate.pose, estimate.robot_covariance, self._views.now(self._extra))

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self.advance(stamp_ns)
        self._forget_place()
        self._cloud = None
        self._region, self._elsewhere = region, Elsewhere(self._config.particles, region)
        self._restart.forget()

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)
        self._calibration.widen(LATE - 3, self._views.heard())

    def advance(self, stamp_ns: int) -> None:
        before_ns = self._motion.stamp_ns
        motion = self._motion.advance(stamp_ns)
        if motion is None or before_ns is None:
            return
        motion = motion.calibrated(self._calibration.mean[:CALIBRATION])
        self._pending_s += (stamp_ns - before_ns) * 1e-9
        if self._cloud is not None:
            self._pending = self._pending.then(motion)
            self._restart.advance(motion)

    def looked(self) -> None:
        self._motion.looked()

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        view = of_factor(self._views, factor, self._extra, self._known)
        if self._cloud is None:
            if isinstance(factor, PoseFactor):
                self._scatter(factor.pose, factor.covariance, view)
            return None
        self._move(view)
        mean, covariance, _ = self._best()
        residual = factor.error(mean)
        _, expected = innovation_covariance(factor, mean, covariance)
        nis = float(squared_mahalanobis(residual, expected))
        weight = self._config.robust.trust(nis, len(residual))
        if (elsewhere := self._restart.consider(factor, disagrees=weight < 1.0)) is not None:
            self._scatter(elsewhere.pose, elsewhere.covariance, view)
            return Innovation(factor.stamp_ns, residual, expected, nis, 0.0)
        likelihood = FactorLikelihood(factor, weight, self._config, self._copies)
        self._weigh(likelihood)
        if weight == 1.0:
            weight = likelihood.inlier(self._cloud, self._moments)
        return Innovation(factor.stamp_ns, residual, expected, nis, weight)

    def observe(self, mixture: MixtureFactor) -> None:
        self.advance(mixture.stamp_ns)
        elsewhere = self._elsewhere
        view = self._views.about(mixture.by_sight, mixture.by_compass, self._extra, self._known)
        if self._cloud is None:
            self._view = view
            self._be_born(mixture, 1.0)
            return
        self._move(view)
        prior = elsewhere.prior()
        log_evidence = self._weigh(mixture_likelihood(mixture, self._copies), mixture)
        if mixture.by_compass:
            return
        outlier = math.exp(min(mixture.log_outlier - log_evidence, 0.0))
        if not elsewhere.wanted(mixture, log_evidence):
            elsewhere.heed(1.0 - outlier)
            elsewhere.lost = prior * outlier / (prior * outlier + 1.0 - prior)
            return
        elsewhere.heed(1.0 - outlier)
        self._be_born(mixture, prior, log_evidence)

    def estimate(self) -> Estimate | None:
        """Mean and covariance of the likeliest cluster, at its likeliest copy."""
        return self._seen(self._views.now(self._extra))

    def seen_from(self) -> Estimate | None:
        """Where the eyes were when they saw what they show now."""
        return self._seen(self._views.sight(self._extra, self._known))

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of what is marginalised: as `MixtureFilter.learned`."""
        return self._calibration.mean, self._calibration.covariance(self._moments.pooled)

    def _seen(self, view: View) -> Estimate | None:
        if self._cloud is None or self._motion.stamp_ns is None:
            return None
        mean, covariance, _ = self._best()
        pose, covariance = self._carried(mean, covariance, self._way(view))
        return Estimate(self._motion.stamp_ns, pose, self._motion.doubted(covariance))

    def ambiguity(self) -> Ambiguity | None:
        if self._cloud is None or self._motion.stamp_ns is None:
            return None
        lost, way = self._elsewhere.lost, self._way(self._views.now(self._extra))
        carry = partial(self._carried, way=way)
        found = hypotheses(self._cloud, self._moments, self._copies, self._tracks, lost, carry)
        return Ambiguity(self._motion.stamp_ns, found.hypotheses, found.mirrored, lost)

    @property
    def events(self) -> Sequence[Event]:
        return self._tracks.events

    @property
    def _copies(self) -> Copies:
        return self._elsewhere.copies

    @property
    def _extra(self) -> FloatArray:
        return np.append(self._calibration.mean, 0.0)

    @property
    def _known(self) -> FloatArray:
        """(EXTRA, EXTRA) beside `_extra`."""
        out = np.zeros((EXTRA, EXTRA))
        cloud = self._moments.pooled if self._cloud is not None else np.zeros((3, 3))
        out[:_CONSTANT, :_CONSTANT] = self._calibration.covariance(cloud)
        return out

    def _way(self, view: View) -> Increment:
        """From the particles' poses to those of the view now, with all that is marginalised as calibration."""
        motion, before, after = self._pending, self._view, view
        back = se2.adjoint(se2.inverse(motion.before_from_after))
        way = se2.compose(motion.before_from_after, se2.exp(after.beside(self._extra)))
        way = se2.compose(se2.exp(-before.beside(self._extra)), way)
        by_calibration = np.hstack([motion.by_calibration, _by(after) - back @ _by(before)])
        return Increment(way, motion.covariance + after.chance, by_calibration, motion.parts)

    def _carried(self, pose: FloatArray, covariance: FloatArray, way: Increment) -> tuple[FloatArray, FloatArray]:
        """A pose and its covariance (robot frame) as they are after the way, the covariance in field axes."""
        now = se2.compose(pose, way.before_from_after)
        return now, se2.rotate_covariance(self._calibration.spreading(way, covariance).after, now[2])

    def _best(self) -> tuple[FloatArray, FloatArray, int]:
        assert self._cloud is not None
        return best_of(self._cloud, self._moments, self._copies)

    def _weigh(self, log_likelihood: LogLikelihood, mixture: MixtureFactor | None = None) -> float:
        assert self._cloud is not None
        config, cloud, of, random = self._config.particles, self._cloud, self._moments, self._random
        if (
            mixture is None
            or mixture.by_compass
            or (sent := proposed(cloud, of, mixture, self._copies, random)) is None
        ):
            self._cloud, self._moments, out = weigh(cloud, of, log_likelihood, config, random)
        else:
            self._cloud, self._moments, out = weigh_where_sent(of, *sent, log_likelihood, config, random)
        self._calibration.shift(out.shift)
        self._tracks.follow(self._cloud, self._moments, self._motion.stamp_ns or 0)
        self._end_leg()
        return out.log_evidence

    def _scatter(self, pose: FloatArray, robot_covariance: FloatArray, view: View) -> None:
        count = self._config.particles.count
        self._forget_place()
        self._view = view
        self._elsewhere = Elsewhere(self._config.particles, self._region)
        self._elsewhere.found()
        sides = np.zeros((count, len(self._copies)))
        sides[:, 0] = 1.0
        poses = scattered(pose, robot_covariance, count, self._random)
        cloud = Cloud(poses, np.zeros(count), np.full(count, 1.0 / count), sides, np.zeros(count, dtype=np.intp))
        self._take(cloud)
        self._restart.forget()

    def _be_born(self, mixture: MixtureFactor, prior: float, log_evidence: float = -math.inf) -> None:
        """Particles at the mixture's solutions, as many as their share of the probability asks for."""
        elsewhere, first = self._elsewhere, self._cloud is None
        found = mixture.solutions()
        count = self._config.particles.count if first else max(self._config.particles.count // 2, 1)
        born = elsewhere.born(found, mixture.symmetric, count, self._random)
        if born is None:
            log_lost, log_rest = -math.inf, elsewhere.log_likelihood(mixture)
        else:
            log_lost, log_rest = born[1], mixture.log_outlier
        cloud_share = math.log1p(-prior) + log_evidence if prior < 1.0 else -math.inf
        logs = np.array([cloud_share, math.log(max(prior, 1e-300)) + log_lost, math.log(max(prior, 1e-300)) + log_rest])
        logs[np.isnan(logs)] = -np.inf
        share, newborn, rest = np.exp(logs - np.logaddexp.reduce(logs))
        if born is None or newborn < _NEWBORN:
            elsewhere.lost = float((newborn + rest) if not first else 1.0)
            return
        cloud = born[0]
        if first:
            elsewhere.found()
        else:
            assert self._cloud is not None
            old = self._cloud
            old.weights = old.weights * (share / (share + newborn))
            cloud.weights = cloud.weights * (newborn / (share + newborn))
            cloud.offsets_rad = self._drawn_offsets(len(cloud))
            cloud = old.joined(cloud)
        elsewhere.lost = float(rest)
        elsewhere.carried = True
        self._forget_place()
        if first:
            cloud.offsets_rad = self._drawn_offsets(len(cloud))
        self._take(cloud)

    def _drawn_offsets(self, count: int) -> FloatArray:
        return np.asarray(self._config.compass.offset_sigma_rad * self._random.standard_normal(count))

    def _take(self, cloud: Cloud) -> None:
        """From now on the cloud is this one."""
        cloud.labels, _, _ = regroup(cloud)
        self._cloud = cloud
        self._moments = moments(cloud, cloud.labels, int(cloud.labels.max()) + 1)
        self._pending, self._pending_s = STANDSTILL, 0.0
        self._tracks.follow(cloud, self._moments, self._motion.stamp_ns or 0)

    def _forget_place(self) -> None:
        if self._cloud is not None:
            self._calibration.forget_place(self._moments.pooled)

    def _move(self, view: View) -> None:
        """To the poses of the view, now."""
        cloud, way, duration_s = self._cloud, self._way(view), self._pending_s
        assert cloud is not None
        self._pending, self._pending_s, self._view = STANDSTILL, 0.0, view
        self._elsewhere.wait(duration_s)
        if duration_s <= 0.0 and not way.by_calibration.any():
            return
        spreading = self._calibration.move(way, self._moments.pooled)
        place = places(cloud, cloud.labels, self._moments.means)
        noise = exact(self._random.standard_normal((len(cloud), 4)), cloud.weights, place)
        by = place[:, :3] @ spreading.by_place.T + drawn(noise[:, :3], spreading.noise)
        # what noise does to a motion is small: (x, y, heading) for the tangent
        cloud.poses = se2.compose(cloud.poses, se2.compose(way.before_from_after, by))
        left, variance = self._config.compass.wander(duration_s)
        cloud.offsets_rad = left * cloud.offsets_rad + math.sqrt(variance) * noise[:, 3]
        self._moments = moments(cloud, cloud.labels, len(self._moments.masses))
        self._legs.move(way, self._calibration.mean)

    def _end_leg(self) -> None:
        """Learn from the way of the best cluster, as long as it is the same."""
        mean, covariance, _ = self._best()
        best = int(self._tracks.numbers[self._moments.best])
        joint = self._calibration.joint(covariance)
        if best == self._leg:
            self._motion.scales = self._legs.look(mean, joint, self._calibration.mean)
        else:
            self._legs.begin(mean, joint, self._calibration.mean)
            self._leg = best


def _by(view: View) -> FloatArray:
    """(3, 3) the change of the view's poses with what the eyes get wrong and how late the robot is."""
    return view.by_state[:, EYES.start : LATE + 1]
