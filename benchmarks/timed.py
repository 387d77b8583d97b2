"""An estimator, and the processor time that it takes itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import process_time

from estimators.base import Estimate, Guessing, Innovation, MixtureEstimator
from fieldloc.factors import Factor
from fieldloc.measurements import Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.regions import Region


class Timed:
    """The same estimator. spent_s: in it so far."""

    def __init__(self, estimator: MixtureEstimator) -> None:
        self._estimator = estimator
        self.spent_s = 0.0

    def start(self, estimate: Estimate) -> None:
        with self._timed():
            self._estimator.start(estimate)

    def start_in(self, region: Region, stamp_ns: int) -> None:
        with self._timed():
            self._estimator.start_in(region, stamp_ns)

    def predict(self, odometry: Odometry) -> None:
        with self._timed():
            self._estimator.predict(odometry)

    def advance(self, stamp_ns: int) -> None:
        with self._timed():
            self._estimator.advance(stamp_ns)

    def update(self, factor: Factor) -> Innovation | None:
        with self._timed():
            return self._estimator.update(factor)

    def observe(self, mixture: MixtureFactor) -> None:
        with self._timed():
            self._estimator.observe(mixture)

    def estimate(self) -> Estimate | None:
        with self._timed():
            return self._estimator.estimate()

    def likeliest(self) -> Estimate | None:
        with self._timed():
            asked = self._estimator
            return asked.likeliest() if isinstance(asked, Guessing) else asked.estimate()

    @contextmanager
    def _timed(self) -> Iterator[None]:
        before_s = process_time()
        yield
        self.spent_s += process_time() - before_s
