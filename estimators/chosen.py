"""What mixtures' solutions are as plain factors, each asked for once: a log is solved many times."""

from estimators.copies import Moved, moved
from fieldloc.factors import Factor
from fieldloc.mixture import MixtureFactor

_Factors = tuple[Factor, ...]


class Chosen:
    def __init__(self) -> None:
        self._known: dict[tuple[int, int], tuple[MixtureFactor, _Factors]] = {}  # by identity, which the mixture keeps

    def __call__(self, mixture: MixtureFactor, choice: int) -> _Factors:
        if (key := (id(mixture), choice)) not in self._known:
            if isinstance(mixture, Moved):
                factors = tuple(moved(factor, mixture.by) for factor in self(mixture.still, choice))
            else:
                factors = mixture.chosen(choice)
            self._known[key] = mixture, factors
        return self._known[key][1]
