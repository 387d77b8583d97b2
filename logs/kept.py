"""What is kept of the ambiguities of a run: as much as anyone can see, and no more than fits, however long the log."""

from estimators.base import Ambiguity, Hypothesis

_PERIOD_NS = 100_000_000
_CHANGE = 0.05  # of a probability: worth keeping at once
_LEAST_WEIGHT, _MOST_AT_ONCE = 1e-3, 32  # hypotheses of one ambiguity
_MOST = 100_000  # hypotheses of a run: some 50 MB


class KeptAmbiguities:
    """Ten a second at most, but each one with another best hypothesis than the one before it, or in which a
    probability changed by more than 0.05; and the last. Of each the likeliest hypotheses, which may be all: 32 at most,
    none below 0.001 but the best. When there are too many of them, changes too have to be some time apart, twice as
    long each time that it gets too much."""

    def __init__(self, most: int = _MOST) -> None:
        self._most = most
        self._apart_ns = 0
        self._kept: list[Ambiguity] = []
        self._size = 0
        self._latest: Ambiguity | None = None

    def take(self, ambiguity: Ambiguity) -> Ambiguity | None:
        """In the order of stamps; of several at one stamp the last counts. What is kept of it, None: nothing, yet."""
        self._latest = ambiguity
        if self._kept and self._kept[-1].stamp_ns == ambiguity.stamp_ns:
            self._size -= _size(self._kept.pop())
        elif self._kept and not self._is_news(self._kept[-1], ambiguity):
            return None
        kept = _likeliest(ambiguity)
        self._kept.append(kept)
        self._size += _size(kept)
        if self._size > self._most:
            self._thin_out()
        return kept

    def all(self) -> tuple[Ambiguity, ...]:
        """So far."""
        if self._latest is None or self._kept[-1].stamp_ns == self._latest.stamp_ns:
            return tuple(self._kept)
        return (*self._kept, _likeliest(self._latest))

    def _thin_out(self) -> None:
        while self._size > self._most // 2 and len(self._kept) > 1:
            self._apart_ns = max(2 * self._apart_ns, _PERIOD_NS // 8)
            first, *others = self._kept
            self._kept = [first]
            for one in others:
                if one.stamp_ns - self._kept[-1].stamp_ns >= self._apart_ns:
                    self._kept.append(one)
            self._size = sum(map(_size, self._kept))

    def _is_news(self, last: Ambiguity, now: Ambiguity) -> bool:
        since_ns = now.stamp_ns - last.stamp_ns
        if since_ns < self._apart_ns:
            return False
        if since_ns >= _PERIOD_NS or _best(now) != _best(last):
            return True
        if max(abs(now.mirrored - last.mirrored), abs(now.lost - last.lost)) > _CHANGE:
            return True
        before, after = weights_by_track(last), weights_by_track(now)
        return any(abs(after.get(track, 0.0) - before.get(track, 0.0)) > _CHANGE for track in before.keys() | after)


def weights_by_track(ambiguity: Ambiguity) -> dict[int, float]:
    out: dict[int, float] = {}
    for one in ambiguity.hypotheses:
        out[one.track] = out.get(one.track, 0.0) + one.weight
    return out


def _best(ambiguity: Ambiguity) -> int | None:
    return ambiguity.hypotheses[0].track if ambiguity.hypotheses else None


def _size(ambiguity: Ambiguity) -> int:
    return 1 + len(ambiguity.hypotheses)


def _likeliest(ambiguity: Ambiguity) -> Ambiguity:
    """With arrays of its own: those of an estimator may be pieces of much larger ones."""
    best = ambiguity.hypotheses[:_MOST_AT_ONCE]
    return Ambiguity(
        ambiguity.stamp_ns,
        tuple(
            Hypothesis(float(one.weight), one.pose.copy(), one.covariance.copy(), int(one.track))
            for i, one in enumerate(best)
            if i == 0 or one.weight >= _LEAST_WEIGHT
        ),
        float(ambiguity.mirrored),
        float(ambiguity.lost),
    )
