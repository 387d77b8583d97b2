"""What every estimator takes and gives. One contract suite holds all of them to it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from fieldloc import pose as se2
from fieldloc.factors import Factor
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.regions import Region


@dataclass(frozen=True, slots=True)
class Estimate:
    """field_from_robot `pose` (3,) at a stamp; covariance (3, 3) of (x_m, y_m, heading_rad) in field axes."""

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray

    @property
    def robot_covariance(self) -> FloatArray:
        """(3, 3) in the robot frame of the pose."""
        return se2.rotate_covariance(self.covariance, -self.pose[2])


@dataclass(frozen=True, slots=True)
class Innovation:
    """How a factor met the prediction, before the update.

    residual: (m,) the factor's error at the predicted pose. covariance: (m, m) what the estimator expected of it.
    nis: normalised innovation squared, chi-square with m degrees of freedom when all is as modelled.
    weight: share of the factor's information used, 1 unless a robust model took the factor for a partial outlier.
    """

    stamp_ns: int
    residual: FloatArray
    covariance: FloatArray
    nis: float
    weight: float


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One of the poses that the robot may have, with its probability.

    pose: (3,) field_from_robot; covariance: (3, 3) of (x_m, y_m, heading_rad) in field axes, if it is this one.
    track: the same number for the same hypothesis from its beginning to its end.
    """

    weight: float
    pose: FloatArray
    covariance: FloatArray
    track: int


@dataclass(frozen=True, slots=True)
class Ambiguity:
    """What the robot may be mistaken about at a stamp.

    hypotheses: the likeliest first, all copies under the map's symmetries that are alive among them; the first one is
    the estimate. mirrored: probability that the robot stands where the map's symmetries take the estimate to, and the
    cloud of hypotheses around it. lost: probability that it is at none of the hypotheses. The hypotheses' weights and
    `lost` add up to one.
    """

    stamp_ns: int
    hypotheses: tuple[Hypothesis, ...]
    mirrored: float
    lost: float


EventKind = Literal["start", "split", "merge", "decision", "recovery", "carried"]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that befell the hypotheses; text: a sentence for people.

    decision: one hypothesis, or one side, holds 99 %. recovery: the robot was found elsewhere. carried: it was put
    down elsewhere, known when looking back.
    """

    stamp_ns: int
    kind: EventKind
    text: str


class Estimator(Protocol):
    """Takes motion and factors in the order of their stamps. Starts knowing nothing unless told."""

    def start(self, estimate: Estimate) -> None:
        """Forget everything and believe this."""

    def predict(self, odometry: Odometry) -> None:
        """Move to the odometry's stamp with the velocity held until then; its own velocity is held from there."""

    def advance(self, stamp_ns: int) -> None:
        """Move to a stamp with the velocity that is held; a stamp in the past moves nothing."""

    def update(self, factor: Factor) -> Innovation | None:
        """Move to the factor's stamp and take it in; None while there is no estimate that it could correct."""

    def estimate(self) -> Estimate | None:
        """The present belief; None while nothing is known."""


@runtime_checkable
class MixtureEstimator(Estimator, Protocol):
    """An estimator that keeps several solutions of an observation. Others get what `resolution.sure` makes of it."""

    def start_in(self, region: Region, stamp_ns: int) -> None:
        """Forget everything and believe that the robot is somewhere in the region, at that stamp."""

    def observe(self, mixture: MixtureFactor) -> None:
        """Move to the mixture's stamp and take it in; from nothing, all whole poses that it allows."""


@runtime_checkable
class Seeing(Protocol):
    """An estimator that knows that its eyes are late and turned."""

    def seen_from(self) -> Estimate | None:
        """The pose that what is seen at present is about; None while nothing is known."""


@runtime_checkable
class Watching(Protocol):
    """An estimator that heeds when images cease to come: a robot that falls or is carried sees nothing."""

    def looked(self) -> None:
        """There was an image at the stamp that is reached, whatever was seen in it."""


@runtime_checkable
class Guessing(Protocol):
    """An estimator that has an idea of the pose before it would call it an estimate."""

    def likeliest(self) -> Estimate | None:
        """The likeliest pose, however unlikely; None while nothing is known."""


@runtime_checkable
class Settled(Protocol):
    """An estimator that is at times of several minds."""

    @property
    def settled(self) -> bool:
        """Whether one place, its copies under the map's symmetries included, holds 99 % of all that may be now."""


@runtime_checkable
class Ambiguous(Protocol):
    """An estimator that says how sure it is of what it cannot tell apart."""

    def ambiguity(self) -> Ambiguity | None:
        """The present one; None while nothing is known."""

    @property
    def events(self) -> Sequence[Event]:
        """All so far, in order of stamps."""


class Smoother(Estimator, Protocol):
    """An estimator that can also look back."""

    def trajectory(self) -> tuple[Estimate, ...]:
        """The whole past in the light of everything seen, in order of stamps."""
