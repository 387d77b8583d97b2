"""The batch smoother: a filter goes ahead to find the start and the way, then one solution for the whole past."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimators.base import Ambiguity, Estimate, Event, Hypothesis, Innovation
from estimators.chain import Chain, ChainRecorder, Recorded
from estimators.config import Config
from estimators.ekf import Ekf
from estimators.engines import solver
from estimators.legs import Legs, as_noisy
from estimators.mixture.filter import MixtureFilter
from estimators.mixture.lost import UNKNOWN
from estimators.modes import ModeSequence
from estimators.resolve import resolve
from estimators.resolved import Resolution
from estimators.said import Said
from estimators.solution import Solution
from fieldloc import pose as se2
from fieldloc.factors import Factor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.regions import Region
from fieldloc.told_mixture import told_mixture

_READINGS = 16
_TOLD_WRONG = 0.05


class Smoother:
    """Online it answers as a filter does; `trajectory` looks back with all that is known by then.

    The filter is the EKF as long as all factors are plain ones, the bank of hypotheses from the first region or mixture
    on. What was told as a start is a factor like others then: it can be wrong.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._ahead = Ekf(config)
        self._bank: MixtureFilter | None = None
        self._region = UNKNOWN
        self._told: Estimate | None = None
        self._odometry: Odometry | None = None
        self._said = Said(config.motion, config.calibration.odometry_delay_s)
        self._untold: list[Odometry] = []  # that the filter ahead has not heard yet
        self._recorder = ChainRecorder(config.graph.node_interval_s)
        self._ambiguity: Ambiguity | None = None
        self._stamps_ns: tuple[int, ...] = ()
        self.solution: Solution | None = None
        """Of the last call of `trajectory`."""
        self.chain: Chain | None = None
        """What that is the solution of."""
        self.resolution: Resolution | None = None
        """Of the last call of `trajectory`, where there were mixtures."""

    def start(self, estimate: Estimate) -> None:
        self._tell()
        self._filter.start(estimate)
        at_ns = self._forget(estimate.stamp_ns)
        self._told = replace(estimate, stamp_ns=at_ns)
        told = PoseFactor(at_ns, estimate.pose, estimate.robot_covariance)
        self._recorder.add(told, at_ns, estimate.pose)

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self._tell()
        self._mixtures().start_in(region, stamp_ns)
        self._region, self._told = region, None
        self._forget(stamp_ns)

    def predict(self, odometry: Odometry) -> None:
        self._untold.append(odometry)
        self._record(odometry.stamp_ns)
        self._said.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        self._tell()
        self._filter.advance(stamp_ns)
        self._record(stamp_ns)

    def looked(self) -> None:
        self._filter.looked()

    def update(self, factor: Factor) -> Innovation | None:
        self._tell()
        innovation = self._filter.update(factor)
        at_ns = self._record(factor.stamp_ns)
        now = self.estimate()
        self._recorder.add(factor, at_ns, None if now is None else now.pose)
        return innovation

    def observe(self, mixture: MixtureFactor) -> None:
        self._tell()
        self._mixtures().observe(mixture)
        self._recorder.observe(mixture, self._record(mixture.stamp_ns))

    def estimate(self) -> Estimate | None:
        """The likeliest so far, however unlikely: what it is in the end `trajectory` tells."""
        self._tell()
        return self._ahead.estimate() if self._bank is None else self._bank.likeliest()

    def ambiguity(self) -> Ambiguity | None:
        """That of the whole past once `trajectory` has looked at it, until something new comes."""
        if self._ambiguity is not None:
            return self._ambiguity
        self._tell()
        if self._bank is not None:
            return self._bank.ambiguity()
        now = self.estimate()
        return (
            None if now is None else Ambiguity(now.stamp_ns, (Hypothesis(1.0, now.pose, now.covariance, 0),), 0.0, 0.0)
        )

    @property
    def events(self) -> Sequence[Event]:
        """Those of the whole past once `trajectory` has looked at it, until something new comes."""
        if self._ambiguity is not None and self.resolution is not None:
            return self.resolution.events
        return () if self._bank is None else self._bank.events

    def ambiguities(self) -> tuple[Ambiguity, ...]:
        """Of the whole past in the light of everything seen, once `trajectory` has looked at it; none before, or where
        there were no mixtures."""
        if self._ambiguity is None or self.resolution is None:
            return ()
        return self.resolution.ambiguities(self._stamps_ns)

    @property
    def settled(self) -> bool:
        """Whether the filter ahead is sure of the place."""
        return self._bank is None or self._bank.settled

    @property
    def legs(self) -> Legs:
        """What the way ahead has taught of the odometry's noise."""
        return self._filter.legs

    def relearn(self, relearned: Callable[[MixtureFactor], MixtureFactor]) -> None:
        """Take all mixtures as they are by what has been learned of the sensors since."""
        self._recorder.relearn(relearned)

    def trajectory(self) -> tuple[Estimate, ...]:
        """An estimate per node of the chain; none while no start has been found."""
        self._tell()
        self._recorder.move(self._said.motions(self._recorder.stamps_ns))
        recorded = self._recorder.recorded()
        recorded = replace(recorded, motions=as_noisy(recorded.motions, self._filter.legs.scales))
        self.resolution = None
        if recorded.mixtures and self._bank is not None:
            recorded, sequences = self._with_start(recorded, self._bank.sequences(_READINGS))
            told = None if self._told is None else 0
            self.resolution = resolve(recorded, sequences, self._region, told, self._config)
        if self.resolution is not None:
            self.solution, self.chain = self.resolution.solution, self.resolution.chain
        else:
            chain = self._recorder.chain(self._ahead.carried_ns)
            if chain is None:
                return ()
            chain = replace(chain, motions=as_noisy(chain.motions, self._filter.legs.scales))
            self.solution, self.chain = solver(self._config)(chain, self._config, None), chain
        covariances = se2.rotate_covariance(self.solution.covariances, self.solution.poses[:, 2])
        out = tuple(map(Estimate, recorded.stamps_ns, self.solution.poses, covariances))
        if self.resolution is not None:
            self._ambiguity = self.resolution.ambiguity(out[-1].stamp_ns)
            self._stamps_ns = recorded.stamps_ns
        return out

    @property
    def _filter(self) -> Ekf | MixtureFilter:
        return self._ahead if self._bank is None else self._bank

    def _mixtures(self) -> MixtureFilter:
        """The bank of hypotheses, which goes on from the EKF where that has been ahead so far."""
        self._ambiguity = None
        if self._bank is None:
            now = self._ahead.estimate()
            self._bank = MixtureFilter(self._config, remember=True)
            if self._odometry is not None:
                self._bank.predict(self._odometry)
            if now is not None:
                self._bank.start(now)
        return self._bank

    def _tell(self) -> None:
        """The filter ahead hears at last what the odometry has said."""
        untold, self._untold = self._untold, []
        for odometry in untold:
            self._filter.predict(odometry)
            self._odometry = odometry

    def _forget(self, stamp_ns: int) -> int:
        """All that was recorded; the stamp that is reached."""
        self._recorder = ChainRecorder(self._config.graph.node_interval_s)
        return self._record(stamp_ns)

    def _record(self, stamp_ns: int) -> int:
        """Up to the stamp; the stamp that is reached, later than a stamp that runs backwards."""
        self._ambiguity = None
        at_ns = self._said.advance(stamp_ns)
        self._recorder.advance(at_ns, None, None)
        return at_ns

    def _with_start(
        self, recorded: Recorded, sequences: tuple[ModeSequence, ...]
    ) -> tuple[Recorded, tuple[ModeSequence, ...]]:
        """What was told as the start as a mixture, which can be wrong, in place of the first factor."""
        # what was observed before anything was known is in no reading
        sequences = tuple(_later(one, len(recorded.mixtures) - len(one.choices), -1) for one in sequences)
        if self._told is None:
            return recorded, sequences
        estimate = self._told
        told = told_mixture(estimate.stamp_ns, estimate.pose, estimate.covariance, _TOLD_WRONG, self._region)
        mixtures = ((recorded.factors[0][0], told), *recorded.mixtures)
        recorded = replace(recorded, factors=recorded.factors[1:], mixtures=mixtures)
        return recorded, tuple(_later(one, 1, 0) for one in sequences)


def _later(sequence: ModeSequence, by: int, choice: int) -> ModeSequence:
    """The reading with more observations before it, all of them the same choice."""
    choices = np.concatenate([np.full(by, choice, dtype=np.intp), sequence.choices])
    way = None if sequence.way is None else sequence.way.later(by)
    return replace(sequence, choices=choices, births=tuple(birth + by for birth in sequence.births), way=way)
