"""What every estimator takes and gives. One contract suite holds all of them to it."""

from dataclasses import dataclass
from typing import Protocol

from fieldloc.factors import Factor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """field_from_robot `pose` (3,) at a stamp; covariance (3, 3) of (x_m, y_m, heading_rad) in field axes."""

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray


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


class Smoother(Estimator, Protocol):
    """An estimator that can also look back."""

    def trajectory(self) -> tuple[Estimate, ...]:
        """The whole past in the light of everything seen, in order of stamps."""
