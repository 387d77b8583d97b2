"""How much of an observation is news, and whether it is worth asking for all the places that it allows."""

import math

import numpy as np

from estimators.mixture.split import Children
from fieldloc.mixture import MixtureFactor
from fieldloc.scan_mixture import ScanMixture

_DOUBT = np.log(0.1)  # of all being wrong: an observation is asked for its own poses
_LOST = np.log(0.01)
_ASK_EVERY_NS = 1_000_000_000
_SAID_S = 2.0  # what is seen again after this has partly become news


class Attention:
    """evidence_share: what a scan counts for right after another (estimators.config.Mixture)."""

    def __init__(self, evidence_share: float) -> None:
        self._evidence_share = evidence_share
        self._asked_ns: int | None = None
        self._scan_ns: int | None = None

    def asked(self, stamp_ns: int | None) -> None:
        """All places are known as of this stamp; None: they are not."""
        self._asked_ns = stamp_ns

    def news(self, mixture: MixtureFactor, now_ns: int) -> float:
        """Share of what it says of hypotheses against each other that was not said a moment ago."""
        if not isinstance(mixture, ScanMixture):
            return 1.0  # all other kinds have seen to it themselves
        before_ns, self._scan_ns = self._scan_ns, now_ns
        if before_ns is None:
            return 1.0
        return 1.0 - (1.0 - self._evidence_share) * math.exp((before_ns - now_ns) * 1e-9 / _SAID_S)

    def asks(self, children: Children, mixture: MixtureFactor, log_lost: float, now_ns: int) -> bool:
        """Whether the observation is to say itself where the robot may be, which may take it long: if that is not
        known, if nothing known explains it, and now and then. The approximation: at other times the lost robot is not
        found, though it is unlikely that it is lost."""
        if mixture.by_compass:
            return False
        late = self._asked_ns is None or now_ns - self._asked_ns >= _ASK_EVERY_NS
        if not (late or log_lost > _LOST or children.blind > children.total + _DOUBT):
            return False
        self._asked_ns = now_ns
        return True
