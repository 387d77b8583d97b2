"""What mixtures' solutions are as plain factors, each asked for once: a log is solved many times."""

from collections.abc import Sequence

from estimators.copies import Moved, moved
from fieldloc.factors import Factor
from fieldloc.mixture import MixtureFactor
from fieldloc.scan_mixture import ScanMixture
from fieldloc.scan_poses import factors_of

_Factors = tuple[Factor, ...]


class Chosen:
    def __init__(self) -> None:
        self._known: dict[tuple[int, int], tuple[MixtureFactor, _Factors]] = {}  # by identity, which the mixture keeps

    def ask(self, mixtures: Sequence[MixtureFactor], choices: Sequence[int]) -> None:
        """Of all of these at once, which is faster than one by one."""
        scans = {
            (id(mixture), choice): mixture
            for mixture, choice in zip(mixtures, choices, strict=True)
            if isinstance(mixture, ScanMixture) and choice >= 0 and (id(mixture), choice) not in self._known
        }
        known = factors_of(list(scans.values()), [choice for _, choice in scans])
        for key, mixture, factors in zip(scans, scans.values(), known, strict=True):
            self._known[key] = mixture, factors

    def __call__(self, mixture: MixtureFactor, choice: int) -> _Factors:
        if (key := (id(mixture), choice)) not in self._known:
            if isinstance(mixture, Moved):
                factors = tuple(moved(factor, mixture.by) for factor in self(mixture.still, choice))
            else:
                factors = mixture.chosen(choice)
            self._known[key] = mixture, factors
        return self._known[key][1]
