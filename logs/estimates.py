"""Trajectories to logs and back: what `run` and `smooth` write and `evaluate` and `export` read."""

import heapq
from collections.abc import Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path

import numpy as np

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Truth
from logs import result_streams
from logs.foreign.wires import has_transforms
from logs.foxglove.topics import BESIDE_OTHERS, STAMPS_NS, Frames
from logs.odom import odom_from_robot
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.recording import Recording
from logs.replay import Replay
from logs.schema import ROS2_ESTIMATES, topic_of
from logs.source import Container, Encoded, RawMessage, Source
from logs.trajectory import Trajectory, from_estimates, from_truth
from logs.writer import METADATA, ROS2, LogWriter

_PROGRESS_EVERY = 500
_PER_ESTIMATE = (topic_of(Estimate), ROS2_ESTIMATES)

_Item = tuple[int, Source, RawMessage | Encoded]


def write_estimates(
    path: Path,
    recording: Recording,
    done: Replay,
    metadata: Mapping[str, str],
    progress: Progress = unwatched,
    merge: Container | None = None,
    ros2: bool = False,
    offset_ns: int = 0,
) -> tuple[str, ...]:
    """The map and the estimates, for fieldloc, Foxglove and Lichtblick; or, with `ros2`, the estimates for ROS 2 alone:
    its own tools open no file in which a single channel is anything else. If the log that is merged is, all are there.

    merge: a log whose messages go into the file too, as they are, but for earlier results. offset_ns: how much later
    than the stamps the log times are (`result_streams.clock_offset_ns`). Returns what a person should know, a
    sentence each. FieldlocError where the file cannot be written or an estimate is none.
    """
    estimates, warnings = done.estimates, []
    stamps_ns = np.array([estimate.stamp_ns for estimate in estimates], dtype=np.int64)
    odom = odom_from_robot(recording.measurements, stamps_ns)
    begin_ns = recording.measurements[0].stamp_ns + offset_ns
    if merge is not None and merge.span_ns is not None:
        begin_ns = min(begin_ns, merge.span_ns[0])
    others = merge is not None and has_transforms(result_streams.kept_channels(merge).values())
    strange = result_streams.not_ros2(merge) if ros2 and merge is not None else None
    streams = []
    if not ros2 or strange:
        own = result_streams.own_streams(recording, done, begin_ns, offset_ns)
        told = (recording.measurements[0], recording.measurements[-1], *estimates, *done.ambiguities, *done.events)
        if all(one.stamp_ns in STAMPS_NS for one in told):
            frames = BESIDE_OTHERS if ros2 or others else Frames()
            own += result_streams.foxglove_streams(recording, done, odom, begin_ns, offset_ns, frames)
        else:
            warnings.append(f"{path}: without messages for Foxglove, whose stamps end with the year 2106")
        streams += [_or_fail(stream, f"{path}: not written: the estimator gave a broken estimate") for stream in own]
    if ros2:
        of_ros = result_streams.ros2_streams(done, odom, offset_ns, others)
        streams += [_or_fail(stream, f"{path}: not written: no ROS 2 messages can be made") for stream in of_ros]
    if strange:
        warnings.append(f"{path}: rosbag2 and rosbags cannot open it, as {strange} of the merged log is not ROS 2")
    total = len(estimates)
    items = [_items(stream) for stream in streams]
    if merge is not None:
        total += sum(merge.counts.get(number, 0) for number in result_streams.kept_channels(merge))
        items.insert(0, _kept_items(merge))
    with LogWriter(path, metadata, ROS2 if ros2 and not strange else "") as log:
        if merge is not None:
            _keep_rest(log, merge)
        counted = 0
        for _, source, message in heapq.merge(*items, key=itemgetter(0)):
            if isinstance(message, RawMessage):
                log.write_raw(source, message.log_time_ns, message.data, message.publish_time_ns, message.sequence)
            else:
                log.add_encoded(message)
                if source.topic not in _PER_ESTIMATE:
                    continue
            if counted % _PROGRESS_EVERY == 0:
                progress(counted, total, "writing")
            counted += 1
    return tuple(warnings)


def read_estimates(log: LogFile) -> Trajectory:
    """FieldlocError where there are none."""
    trajectory = from_estimates(log.records(Estimate))
    if not len(trajectory):
        topic = log.roles["estimate"]
        raise FieldlocError(f"{log.path}: no usable message on {topic}; give what fieldloc run or smooth wrote")
    return trajectory


def read_truth(log: LogFile) -> Trajectory:
    """FieldlocError where there is none."""
    trajectory = from_truth(log.records(Truth))
    if not len(trajectory):
        raise FieldlocError(f"{log.path}: no usable message on {log.roles['truth']}; give a log that holds the truth")
    return trajectory


def _items(stream: Iterable[Encoded]) -> Iterator[_Item]:
    return ((message.log_time_ns, message.source, message) for message in stream)


def _kept_items(merge: Container) -> Iterator[_Item]:
    return ((message.log_time_ns, source, message) for source, message in result_streams.kept_messages(merge))


def _or_fail(stream: Iterator[Encoded], what: str) -> Iterator[Encoded]:
    try:
        yield from stream
    except ValueError as error:
        raise FieldlocError(f"{what}: {error}") from error


def _keep_rest(log: LogWriter, merge: Container) -> None:
    """Channels, also those without messages, files and metadata of the input; its own record of how it was made is
    renamed, as the result has one."""
    for source in result_streams.kept_channels(merge).values():
        log.add_source(source)
    for name, mapping in merge.metadata.items():
        renamed = f"{METADATA} ({merge.path.name})"
        while renamed in merge.metadata:
            renamed += "+"
        log.add_metadata(renamed if name == METADATA else name, mapping)
    for attachment in merge.attachments():
        log.attach(attachment)
