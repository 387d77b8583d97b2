"""What a result file is made of: streams of messages in the order of log time, to be merged by it.

offset_ns: log time minus stamp, where the log's clock is not that of the stamps (`clock_offset_ns`).
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice

import numpy as np

from estimators.base import Ambiguity, Estimate, Event
from fieldloc.measurements import Compass, ImageFeatures, LandmarkScan, Odometry
from fieldloc.pose import FloatArray
from logs.foxglove.topics import BESIDE_OTHERS, PREFIX, Frames
from logs.reader import LogFile
from logs.recording import Recording
from logs.replay import Replay
from logs.schema import BY_KIND, BY_NAME, MESSAGE_ENCODING, SCHEMA_ENCODING, TOPICS, Record, encode, topic_of
from logs.source import Container, Encoded, RawMessage, Source

_SAMPLES = 100  # of each kind of measurement, to compare clocks
_OURS_IF_IN_OUR_WORDS = tuple(TOPICS[role] for role in ("field", "hypotheses", "events"))  # others may mean anything
_SAME_CLOCK_NS = 1_000_000_000  # a message's way to the log is shorter


def clock_offset_ns(log: LogFile) -> int:
    """The median of log time minus stamp over the first measurements; 0 where that is no more than their way to the
    log (a second). Results that are merged into the log are shifted by it, or they would stand beside it."""
    offsets: list[int] = []
    for kind in (Odometry, ImageFeatures, LandmarkScan, Compass):
        if log.has(kind):
            messages = islice(log.messages(log.topics(BY_KIND[kind].role)), _SAMPLES)
            records = [(message.log_time_ns, message.record) for message in messages]
            offsets += [logged_ns - record.stamp_ns for logged_ns, record in records if isinstance(record, kind)]
    if not offsets:
        return 0
    median_ns = sorted(offsets)[len(offsets) // 2]
    return median_ns if abs(median_ns) > _SAME_CLOCK_NS else 0


def kept_channels(merge: Container) -> dict[int, Source]:
    """All but earlier results and a map of fieldloc's, whose place the map takes that the estimates were made on."""
    return {number: source for number, source in merge.sources.items() if not _is_result(source)}


def _is_result(source: Source) -> bool:
    if source.topic in _OURS_IF_IN_OUR_WORDS:
        return source.schema_name in BY_NAME
    if source.topic == "/tf" and source.message_encoding == "cdr":
        from logs.ros.results import sources

        return source in sources()  # a robot's own recorder says more of its channel than we do
    return source.topic == TOPICS["estimate"] or source.topic.startswith(PREFIX)


def not_ros2(merge: Container) -> str | None:
    """A topic that stays of the input and that ROS 2's tools cannot read, None where there is none."""
    kept = kept_channels(merge).values()
    return next(
        (s.topic for s in kept if s.message_encoding != "cdr" or not s.schema_encoding.startswith("ros2")), None
    )


def kept_messages(merge: Container) -> Iterator[tuple[Source, RawMessage]]:
    """What stays of the input, byte by byte."""
    sources = kept_channels(merge)
    for message in merge.messages(sources.keys()):
        yield sources[message.channel], message


def own_streams(recording: Recording, done: Replay, begin_ns: int, offset_ns: int) -> list[Iterator[Encoded]]:
    """Map and estimates, hypotheses, events, as fieldloc reads them. ValueError for what no reader would accept."""
    the_map = Encoded(own_source(recording.field), begin_ns, encode(recording.field))
    return [
        chain([the_map], _as_logged(done.estimates, offset_ns)),
        _as_logged(done.ambiguities, offset_ns),
        _as_logged(done.events, offset_ns),
    ]


def _as_logged(
    records: Sequence[Estimate] | Sequence[Ambiguity] | Sequence[Event], offset_ns: int
) -> Iterator[Encoded]:
    """Of one kind."""
    source: Source | None = None
    for record in records:
        source = source or own_source(record)
        yield Encoded(source, int(record.stamp_ns) + offset_ns, encode(record))


def own_source(record: Record) -> Source:
    """The usual channel of such records."""
    schema = BY_KIND[type(record)]
    return Source(topic_of(type(record)), MESSAGE_ENCODING, schema.name, SCHEMA_ENCODING, schema.text.encode())


def foxglove_streams(
    recording: Recording,
    done: Replay,
    odom_from_robot: FloatArray,
    begin_ns: int,
    offset_ns: int,
    frames: Frames,
) -> list[Iterator[Encoded]]:
    """What Foxglove and Lichtblick draw of it. ValueError for an estimate of a wrong shape."""
    from logs.foxglove.hypotheses import ambiguities_messages, event_messages
    from logs.foxglove.results import estimates_messages

    return [
        _at_the_beginning(recording, done.estimates, begin_ns, frames),
        _shifted(estimates_messages(done.estimates, odom_from_robot, frames), offset_ns),
        _shifted(ambiguities_messages(done.ambiguities, frames), offset_ns),
        _shifted(event_messages(done.events), offset_ns),
        _shifted(_sights(recording, done.estimates, frames), offset_ns),
    ]


def _at_the_beginning(
    recording: Recording, estimates: Sequence[Estimate], begin_ns: int, frames: Frames
) -> Iterator[Encoded]:
    """Map and trajectory, to be seen from the first moment on."""
    from logs.foxglove.results import field_messages, trajectory_messages

    first_ns = int(estimates[0].stamp_ns)
    yield from (m._replace(log_time_ns=begin_ns) for m in field_messages(recording.field, first_ns, frames))
    yield from (m._replace(log_time_ns=begin_ns) for m in trajectory_messages(estimates, first_ns, frames))


def ros2_streams(
    done: Replay, odom_from_robot: FloatArray, offset_ns: int, beside_others: bool
) -> list[Iterator[Encoded]]:
    """What ROS 2 tools know. ValueError where its stamps end, in 2038.

    beside_others: the file has someone else's transforms, so that ours must not name the same frames.
    """
    from logs.ros.hypotheses import pose_arrays
    from logs.ros.results import Frames, ros2_messages

    frames = Frames("map", *BESIDE_OTHERS[1:]) if beside_others else Frames()

    def estimates() -> Iterator[Encoded]:
        for estimate, odom in zip(done.estimates, odom_from_robot, strict=True):
            yield from ros2_messages(estimate, odom, frames)

    return [_shifted(estimates(), offset_ns), _shifted(pose_arrays(done.ambiguities, frames), offset_ns)]


def _sights(recording: Recording, estimates: Sequence[Estimate], frames: Frames) -> Iterator[Encoded]:
    """From the newest estimate at each scan or image; rays at most ten times a second, annotations always."""
    from logs.foxglove.results import measurement_messages
    from logs.foxglove.throttle import Throttle

    stamps_ns = np.array([estimate.stamp_ns for estimate in estimates], dtype=np.int64)
    throttle = Throttle()
    for measurement in recording.measurements:
        if not isinstance(measurement, (LandmarkScan, ImageFeatures)):
            continue
        newest = int(np.searchsorted(stamps_ns, measurement.stamp_ns, side="right")) - 1
        pose = estimates[newest].pose if newest >= 0 and throttle.passes(measurement.stamp_ns) else None
        yield from measurement_messages(measurement, pose, recording.camera, recording.field, frames)


def _shifted(messages: Iterable[Encoded], offset_ns: int) -> Iterator[Encoded]:
    for message in messages:
        yield message._replace(log_time_ns=message.log_time_ns + offset_ns) if offset_ns else message
