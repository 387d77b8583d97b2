"""Gaussian-sum filter over all places where the robot may be (Alspach & Sorenson 1972; multi-hypothesis localization).

Motion moves all hypotheses, an observation splits each into what it allows, those that say the same merge, the
unlikely go. The robot may also be at none of them: lost, at the start or because it was carried. Then an observation
finds it at any of its solutions. So the start from nothing, the start in a region and recovery are one and the same.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.base import Ambiguity, Estimate, Event, Hypothesis, Innovation
from estimators.config import Config
from estimators.divergence import Restart
from estimators.legs import Legs
from estimators.mixture import report
from estimators.mixture.attention import Attention
from estimators.mixture.bank import Bank, gaussian
from estimators.mixture.heard import Heard
from estimators.mixture.lineage import Lineage
from estimators.mixture.log_sums import either, total
from estimators.mixture.lost import UNKNOWN, Lost
from estimators.mixture.merge import merged
from estimators.mixture.sides import Sides
from estimators.mixture.split import Children, met
from estimators.mixture.watch import Watch
from estimators.modes import ModeSequence
from estimators.motion import CALIBRATION, STANDSTILL, HeldVelocity, Increment
from estimators.views import LATE, View, Views, of_factor, prior
from fieldloc.factors import Factor, PoseFactor
from fieldloc.heading_mixture import HeadingMixture
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor, PoseSolutions
from fieldloc.one_pose import turned
from fieldloc.pose import FloatArray
from fieldloc.regions import Region

_ONE_PLACE = 0.99  # as `Watch` calls it a decision
_CROWD = 4  # times as many as may stay are compared for being alike


class MixtureFilter:
    """Starts at the first observation that holds whole poses, unless `start` or `start_in` is called before.

    symmetries: (s, 3) poses that map the field onto itself; `start_in` brings those of its region. remember: keep all
    choices for `sequences`.
    """

    def __init__(self, config: Config, symmetries: FloatArray | None = None, remember: bool = False) -> None:
        self._config = config
        self._motion = HeldVelocity(config.motion, config.calibration.odometry_delay_s)
        self._views = Views(config, self._motion)
        self._legs = Legs(config.motion)
        self._restart = Restart(config.robust.restart_after)
        self._watch = Watch()
        self._heard = Heard()
        self._unheard = False  # whether the compass has not spoken since the robot was found, nor just before
        self._sides = Sides.of(np.zeros((0, 3)) if symmetries is None else symmetries)
        self._bank = self._nobody = Bank.empty(len(self._sides))
        self._lost = Lost.within(UNKNOWN, 0.0)
        self._lineage = Lineage.none(len(self._sides), remember)
        self._extra, self._known = prior(config)  # of the best
        self._decided = False  # whether there was one place once
        self._first = (0, 0)  # row and copy of the best
        self._last: FloatArray | None = None  # its pose
        self._pending, self._pending_s = STANDSTILL, 0.0
        self._attention = Attention(config.mixture.evidence_share)
        self._said: tuple[Bank, Increment, Estimate] | None = None  # the likeliest, and of what

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, estimate.robot_covariance, self._views.now(self._extra))
        self._watch.begin(self._now_ns, "the start was given")

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self.advance(stamp_ns)
        self._settle()
        self._sides = Sides.of(region.symmetries)
        self._bank = self._nobody = Bank.empty(len(self._sides))
        self._lost = Lost.within(region, 0.0)
        self._lineage.begin(self._bank)
        self._restart.forget()
        self._watch.forget(decided=False)
        self._decided = False
        self._last = None
        self._attention.asked(None)

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)
        self._said = None
        if (gained := self._views.heard()) > 0.0:
            self._known = self._known.copy()
            self._known[LATE - 3, LATE - 3] += gained
            self._bank.covariances[:, LATE, LATE] += gained

    def advance(self, stamp_ns: int) -> None:
        before_ns = self._motion.stamp_ns
        motion = self._motion.advance(stamp_ns)
        if motion is None or before_ns is None:
            return
        self._pending_s += (stamp_ns - before_ns) * 1e-9
        if len(self._bank):
            # gathered, as the odometry of the best hypothesis has it; others differ linearly
            motion = motion.calibrated(self._extra[:CALIBRATION])
            self._pending = self._pending.then(motion)
            self._restart.advance(motion)

    def looked(self) -> None:
        self._motion.looked()

    def update(self, factor: Factor) -> Innovation | None:
        """A factor of one solution: as an extended Kalman filter does, in each of the hypotheses."""
        self.advance(factor.stamp_ns)
        if not len(self._bank):
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance, of_factor(self._views, factor, self._extra, self._known))
                self._watch.begin(self._now_ns, "a whole pose")
            return None
        self._settle()
        view = of_factor(self._views, factor, self._extra, self._known)
        children, innovation, log_unknown = met(
            self._bank, self._sides, factor, view, self._config.robust.nis_per_dof, self._first
        )
        if (elsewhere := self._restart.consider(factor, disagrees=innovation.weight < 1.0)) is not None:
            self._believe(elsewhere.pose, elsewhere.covariance, view)
            self._watch.recovered(self._now_ns)
            return innovation
        self._take(children, self._nobody, self._lost.log_weights + log_unknown, view, choice=False)
        return innovation

    def observe(self, mixture: MixtureFactor) -> None:
        self.advance(mixture.stamp_ns)
        self._settle()
        if self._unheard and isinstance(mixture, HeadingMixture):
            mixture, self._unheard = replace(mixture, wider=1.0), False  # what it said before was not said to these
        if isinstance(mixture, HeadingMixture):
            self._heard = Heard(mixture)
        view = self._views.about(mixture.by_sight, mixture.by_compass, self._extra, self._known)
        children = Children.of(self._bank, self._sides, mixture, view)
        news = self._attention.news(mixture, self._now_ns)
        children = children.tempered(news)
        asks = self._attention.asks(children, mixture, self._lost.total, self._now_ns)
        solutions = mixture.solutions() if asks else None
        missed = self._lost.missed(mixture, solutions)
        births = self._born(solutions or PoseSolutions.none(), mixture.symmetric, view)
        if news < 1.0 and len(self._bank):
            # a robot that is lost has seen much the same a moment ago, too
            whole = either(total(births.log_weights), total(missed)) - self._lost.total
            if math.isfinite(whole):
                back = (news - 1.0) * (whole - children.of_likeliest)
                missed, births = missed + back, births.weighing(births.log_weights + back)
        self._take(children, births, missed, view, choice=True)
        self._decided = self._decided or self._decides(mixture)

    def estimate(self) -> Estimate | None:
        """`likeliest`, from when it was told or one place held 99 % of all that may be, its copies under the map's
        symmetries together; from the first one on if its covariance is that of all hypotheses, and so says it."""
        return self.likeliest() if self._decided or self._config.mixture.whole_covariance else None

    def likeliest(self) -> Estimate | None:
        """Where the robot is sooner than anywhere else, however unlikely that is."""
        if not len(self._bank):
            return None
        if self._said is None or self._said[0] is not self._bank or self._said[1] is not self._pending:
            self._said = self._bank, self._pending, self._seen(self._views.now(self._extra))
        return self._said[2]

    def seen_from(self) -> Estimate | None:
        """Where the eyes were when they saw what they show now."""
        return self._seen(self._views.sight(self._extra, self._known)) if len(self._bank) else None

    @property
    def settled(self) -> bool:
        """Whether one place, its copies under the map's symmetries included, holds 99 % of all that may be now."""
        return len(self._bank) > 0 and report.place(self._bank, self._sides, self._first[0]) >= _ONE_PLACE

    @property
    def legs(self) -> Legs:
        """What has been learned of the odometry's noise."""
        return self._legs

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """Mean (EXTRA,) and covariance (EXTRA, EXTRA) of what the best keeps beside the pose (`estimators.views`)."""
        return self._extra, self._known

    def _seen(self, view: View) -> Estimate:
        row, copy = self._first
        if self._config.mixture.whole_covariance:
            bank = self._moved(self._bank).seen(view)
            pose = self._sides.of_one(copy, bank.poses[row])
            return Estimate(self._now_ns, pose, self._motion.doubted(report.covariance_about(pose, bank, self._sides)))
        pose, covariance = self._bank.moved_one(row, self._pending, view)
        pose = self._sides.of_one(copy, pose)
        return Estimate(self._now_ns, pose, self._motion.doubted(turned(covariance, float(pose[2]))))

    def ambiguity(self) -> Ambiguity | None:
        if (now := self.likeliest()) is None:
            return None
        lost, tracks = math.exp(self._fed().total), self._lineage.tracks
        if tracks.size == 1:
            return Ambiguity(
                now.stamp_ns, (Hypothesis(1.0 - lost, now.pose, now.covariance, tracks.item()),), 0.0, lost
            )
        bank = self._moved(self._bank)
        if not self._views.same:
            bank = bank.seen(self._views.now(self._extra))
        return report.ambiguity(self._now_ns, bank, self._sides, self._first, tracks, lost)

    @property
    def events(self) -> Sequence[Event]:
        return tuple(self._watch.events)

    def sequences(self, count: int) -> tuple[ModeSequence, ...]:
        """The likeliest ways to read all mixtures observed since the start, best first: one for each hypothesis on each
        copy that is alive. ValueError unless it was made to remember."""
        if not self._lineage.remember:
            raise ValueError("made without remember=True: the choices of the past are not kept")
        return self._lineage.sequences(self._bank, self._sides, count)

    @property
    def _now_ns(self) -> int:
        assert self._motion.stamp_ns is not None
        return self._motion.stamp_ns

    def _believe(self, pose: FloatArray, robot_covariance: FloatArray, view: View) -> None:
        """One place, one side. What is known of the odometry, the eyes and the compass stays known."""
        self._settle()
        pose, covariance = view.back(pose, self._extra), view.of_state(robot_covariance, self._known)
        self._bank = gaussian(pose, covariance, self._extra, len(self._sides))
        self._lost = self._lost.after(np.array([-np.inf, -np.inf]))
        self._first, self._last = (0, 0), pose
        self._begin_leg()
        self._attention.asked(self._now_ns)
        self._lineage.begin(self._bank)
        self._restart.forget()
        self._watch.forget(decided=True)
        self._decided = True

    def _settle(self) -> None:
        """Do what the time that passed has left to be done."""
        self._bank, self._lost = self._moved(self._bank), self._fed()
        if len(self._bank):
            row, copy = self._first
            self._legs.move(self._pending, self._extra[:CALIBRATION])
            self._known = self._bank.covariances[row, 3:, 3:]
            self._extra = self._bank.extra[row]
            self._last = self._sides.of_one(copy, self._bank.poses[row])
            self._bank = self._bank.weighing(self._bank.log_weights + math.log1p(-self._carried))
        self._heard = self._heard.turned(float(self._pending.before_from_after[2]))
        self._pending, self._pending_s = STANDSTILL, 0.0

    def _decides(self, mixture: MixtureFactor) -> bool:
        """Whether there is an estimate from now on: one place is likely, or the robot was told a pose."""
        if not len(self._bank):
            return False
        if not (mixture.by_sight or mixture.by_compass) and len(mixture.solutions().ids) == 1:
            return True
        return self.settled

    def _begin_leg(self) -> None:
        row = self._first[0]
        self._legs.begin(self._bank.poses[row], self._bank.covariances[row], self._extra[:CALIBRATION])

    @property
    def _carried(self) -> float:
        """Probability that the robot was carried away in the time that passed."""
        return -math.expm1(-self._config.mixture.kidnaps_per_min / 60.0 * self._pending_s)

    def _fed(self) -> Lost:
        return self._lost.fed(self._carried) if self._carried > 0.0 else self._lost

    def _moved(self, bank: Bank) -> Bank:
        if self._pending_s == 0.0 or not len(bank):
            return bank
        left, gain = self._config.compass.wander(self._pending_s)
        return bank.moved(self._pending, self._extra[:CALIBRATION], left, gain)

    def _born(self, solutions: PoseSolutions, symmetric: bool, view: View) -> Bank:
        count = len(solutions.ids)
        if not count:
            return self._nobody
        log_weights, found = self._lost.found(solutions, self._sides.copies, symmetric)
        headings = self._sides.unfold(solutions.poses)[..., 2]
        log_weights += self._heard.log_share(headings, self._config.compass, self._now_ns, found[:, None])
        extra, known = self._extra.copy(), self._known.copy()
        extra[-1] = known[-1] = known[:, -1] = 0.0  # which steel it is that the compass feels there, nobody knows
        known[-1, -1] = self._config.compass.offset_sigma_rad**2
        covariances = view.of_state(solutions.covariances, known)
        poses, extras, none = view.back(solutions.poses, extra), np.tile(extra, (count, 1)), np.full(count, -1)
        return Bank(poses, extras, covariances, log_weights, none, solutions.ids, found.astype(np.intp))

    def _take(self, children: Children, births: Bank, missed: FloatArray, view: View, choice: bool) -> None:
        tracked = either(children.total, total(births.log_weights))
        everything = either(tracked, total(missed))
        if not math.isfinite(everything):
            return  # beyond all that was thought of
        started = not len(self._bank)
        settings = self._config.mixture
        least = tracked + math.log(settings.prune_below)
        bank = children.born(self._bank, least, view) if not started else self._bank
        if len(births):
            bank = bank.joined(births.take(np.flatnonzero(births.totals >= least)))
        self._lost = self._lost.after(missed - everything)
        if not len(bank):
            return
        if len(bank) > _CROWD * settings.max_hypotheses:
            bank = bank.take(np.argsort(-bank.totals, kind="stable")[: _CROWD * settings.max_hypotheses])
        bank = bank.weighing(bank.log_weights - everything)
        if len(bank) > 1:
            crowd = bank
            bank, into = merged(crowd, self._sides)
            self._watch.merges(self._now_ns, crowd, into, self._lineage.tracks)
            bank = bank.take(np.arange(min(len(bank), settings.max_hypotheses)))
        left = total(bank.log_weights)
        bank = bank.weighing(bank.log_weights + (tracked - everything - left))
        # of several, which then is the same one is not asked
        self._settle_on(bank, choice, started, children.margin if len(bank) == 1 else 0.0)

    def _settle_on(self, bank: Bank, choice: bool, started: bool, margin: float) -> None:
        """These are the hypotheses from now on. margin: as `Way` has it."""
        before = self._first[0]
        self._bank = bank
        self._first = row, copy = report.best(bank, self._sides, self._last)
        self._last = self._sides.of_one(copy, bank.poses[row])
        self._extra, self._known = bank.extra[row], bank.covariances[row, 3:, 3:]
        if bank.parents[row] == before:
            covariance, calibration = bank.covariances[row], self._extra[:CALIBRATION]
            self._motion.scales = self._legs.look(bank.poses[row], covariance, calibration)
        else:  # another one's way has led here
            self._begin_leg()
        self._lineage.follow(bank, before, choice, margin)
        if started:
            self._watch.begin(self._now_ns, f"{len(bank) * len(self._sides)} places are possible")
        elif bank.found[row]:
            self._watch.recovered(self._now_ns)
        if started or bank.found[row]:
            bank.found[:] = 0
            # who was carried may have been turned since the compass spoke: what it says next is news again
            self._unheard = not started or not self._heard.lately(self._now_ns)
        lost = math.exp(self._lost.total)
        self._watch.after(self._now_ns, bank, self._sides, self._first, self._lineage.tracks, lost)
