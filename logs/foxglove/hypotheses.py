"""What an estimator says of its hypotheses, and of what befell them, as Foxglove messages."""

from collections.abc import Iterable, Iterator

import numpy as np
from foxglove.messages import Log, LogLevel

from estimators.base import Ambiguity, Event
from logs.foxglove import shapes, topics
from logs.foxglove.encoded import encoded
from logs.foxglove.results import hypothesis_messages
from logs.foxglove.topics import Frames
from logs.source import Encoded

_OWN = Frames()
_NOTED = ("decision", "recovery", "carried")  # of the others there may be many
_LEAST_WEIGHT = 0.01  # of what is shown: fainter arrows are not seen


def ambiguities_messages(ambiguities: Iterable[Ambiguity], frames: Frames = _OWN) -> Iterator[Encoded]:
    """All hypotheses of at least 1 %, those under the map's symmetries among them."""
    for ambiguity in ambiguities:
        likely = [one for one in ambiguity.hypotheses if one.weight >= _LEAST_WEIGHT]
        poses = np.array([one.pose for one in likely]).reshape(-1, 3)
        weights = np.array([one.weight for one in likely], dtype=np.float64)
        yield from hypothesis_messages(poses, weights, int(ambiguity.stamp_ns), frames)


def event_messages(events: Iterable[Event]) -> Iterator[Encoded]:
    """Lines of a log panel: decisions and recoveries as information, the rest for debugging."""
    for event in events:
        stamp_ns = int(event.stamp_ns)
        line = Log(
            timestamp=shapes.timestamp(stamp_ns),
            level=LogLevel.Info if event.kind in _NOTED else LogLevel.Debug,
            message=event.text,
            name=event.kind,
        )
        yield encoded(topics.EVENTS, stamp_ns, line)
