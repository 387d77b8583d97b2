"""fieldloc's records as a programme of Foxglove messages: field, robot, uncertainty, hypotheses, rays to what is
seen."""

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from estimators.base import Ambiguity, Ambiguous, Estimate
from estimators.base import Event as Happened
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures, LandmarkScan, Odometry, Truth
from fieldloc.pose import FloatArray
from logs.foreign.wires import has_transforms
from logs.foxglove import topics
from logs.foxglove.throttle import Throttle
from logs.kept import KeptAmbiguities
from logs.odom import odom_from_robot
from logs.reader import LogFile
from logs.replay import Run
from logs.schema import BY_KIND, Record
from logs.source import Encoded, Source
from logs.viewing.timeline import Event, Shown, Timeline

TRUE_WAY, TRUE_POSE = "/fieldloc/true_way", "/fieldloc/true_pose"

_BLOCK = 16  # events that are turned into messages together: an estimator is so far ahead of what is shown
_STANDING: tuple[type[Shown], ...] = (Estimate, LandmarkScan, ImageFeatures, Truth, Ambiguity)


class Scenes:
    """The programme. lasting: what holds all the time, such as the map."""

    def __init__(
        self,
        timeline: Timeline,
        span_ns: tuple[int, int],
        lasting: Sequence[Encoded],
        camera: Camera | None,
        field: FieldMap | None,
        frames: topics.Frames,
    ) -> None:
        self._timeline, self._span_ns, self._lasting = timeline, span_ns, lasting
        self._camera, self._field, self._frames = camera, field, frames

    @property
    def span_ns(self) -> tuple[int, int]:
        return self._span_ns

    @property
    def sources(self) -> Sequence[Source]:
        from foxglove import messages as kinds

        from logs.foxglove.encoded import channel

        return [
            channel(topics.POSE, kinds.PoseInFrame),
            channel(topics.STATE, kinds.Odometry),
            channel(topics.TRANSFORMS, kinds.FrameTransforms),
            channel(topics.UNCERTAINTY, kinds.SceneUpdate),
            channel(topics.SIGHTS, kinds.SceneUpdate),
            channel(topics.ANNOTATIONS, kinds.ImageAnnotations),
            channel(topics.HYPOTHESES, kinds.PosesInFrame),
            channel(topics.WEIGHTS, kinds.SceneUpdate),
            channel(topics.EVENTS, kinds.Log),
            channel(TRUE_POSE, kinds.PoseInFrame),
            *(message.source for message in self._lasting),
        ]

    def messages(self, start_ns: int) -> Iterator[Encoded]:
        rays = Throttle()
        events = self._timeline.after(start_ns)
        while block := list(islice(events, _BLOCK)):
            sights = self._sights(block, rays)
            shown = [*self._estimates(block), *self._hypotheses(block), *sights, *self._truth(block)]
            yield from sorted(shown, key=lambda message: message.log_time_ns)

    def standing(self, at_ns: int) -> Iterator[Encoded]:
        yield from self._lasting
        for last in self._timeline.before(at_ns, _STANDING):
            block = [last]
            yield from (*self._estimates(block), *self._hypotheses(block))
            yield from (*self._sights(block, Throttle()), *self._truth(block))

    def _estimates(self, block: Sequence[Event]) -> Iterator[Encoded]:
        from logs.foxglove.results import estimates_messages

        odom = [event.odom_from_robot for event in block if isinstance(event.record, Estimate)]
        known = [pose for pose in odom if pose is not None]
        estimates = [event.record for event in block if isinstance(event.record, Estimate)]
        if not estimates:
            return
        logged_ns = {int(e.record.stamp_ns): e.log_time_ns for e in block if isinstance(e.record, Estimate)}
        stacked = np.array(known) if len(known) == len(odom) else None
        for message in estimates_messages(estimates, stacked, self._frames):
            yield message._replace(log_time_ns=logged_ns[message.log_time_ns])

    def _hypotheses(self, block: Sequence[Event]) -> Iterator[Encoded]:
        from logs.foxglove.hypotheses import ambiguities_messages, event_messages

        for event in block:
            messages: Iterator[Encoded] = iter(())
            if isinstance(event.record, Ambiguity):
                messages = ambiguities_messages([event.record], self._frames)
            elif isinstance(event.record, Happened):
                messages = event_messages([event.record])
            for message in messages:
                yield message._replace(log_time_ns=event.log_time_ns)

    def _sights(self, block: Sequence[Event], rays: Throttle) -> Iterator[Encoded]:
        from logs.foxglove.results import measurement_messages

        for event in block:
            if isinstance(event.record, LandmarkScan | ImageFeatures):
                pose = event.field_from_robot if rays.passes(event.log_time_ns) else None
                for message in measurement_messages(event.record, pose, self._camera, self._field, self._frames):
                    yield message._replace(log_time_ns=event.log_time_ns)

    def _truth(self, block: Sequence[Event]) -> Iterator[Encoded]:
        from foxglove.messages import PoseInFrame

        from logs.foxglove import shapes
        from logs.foxglove.encoded import encoded

        for event in block:
            if isinstance(event.record, Truth):
                pose = shapes.flat_pose(*event.record.pose.tolist())
                time = shapes.timestamp(event.record.stamp_ns)
                message = PoseInFrame(timestamp=time, frame_id=self._frames.field, pose=pose)
                yield encoded(TRUE_POSE, event.log_time_ns, message)


def log_scenes(log: LogFile, frames: topics.Frames) -> Scenes | None:
    """Of what stands in a log: its estimates, and what was seen from there; from the truth where there are none.

    None where there is nothing to show. All of it is read before the first is shown.
    """
    field, camera = log.field_map(), next(log.records(Camera), None)
    kinds = [kind for kind in (Estimate, Truth, LandmarkScan, ImageFeatures, Ambiguity, Happened) if log.has(kind)]
    if not kinds and field is None:
        return None
    guide = Estimate if Estimate in kinds else Truth
    roles = {BY_KIND[kind].role for kind in kinds}
    played = {source.topic for source, count in log.sources if count and roles & {*log.plays(source)}}
    found: list[tuple[int, Shown]] = []
    for message in log.messages(played) if played else ():
        record = message.record
        if isinstance(record, Shown) and record.stamp_ns in topics.STAMPS_NS:
            found.append((message.log_time_ns, record))
    events = _with_poses(sorted(found, key=lambda one: (one[0], not isinstance(one[1], guide))), guide)
    span_ns = (events[0].log_time_ns, events[-1].log_time_ns) if events else log.span_ns or (0, 0)
    lasting = _lasting(field, [event.record for event in events], frames)
    return Scenes(Timeline(events), span_ns, lasting, camera, field, frames)


def _with_poses(found: Sequence[tuple[int, Shown]], guide: type[Estimate] | type[Truth]) -> list[Event]:
    """Each with the last pose that the guide told by then."""
    pose: FloatArray | None = None
    events = []
    for log_time_ns, record in found:
        if isinstance(record, guide):
            pose = record.pose
        events.append(Event(log_time_ns, record, pose))
    return events


def run_scenes(run: Run, truth: Sequence[Truth], offset_ns: int, frames: topics.Frames) -> Scenes:
    """Of an estimator that runs while it is watched. offset_ns: log time minus stamp."""
    measurements = run.recording.measurements
    stamps_ns = np.array([measurement.stamp_ns for measurement in measurements], dtype=np.int64)
    has_odometry = any(isinstance(measurement, Odometry) for measurement in measurements)
    odom = odom_from_robot(measurements, stamps_ns) if has_odometry else None

    ambiguous = run.estimator if isinstance(run.estimator, Ambiguous) else None

    def events() -> Iterator[Event]:
        kept, happened = KeptAmbiguities(), 0
        for i, step in enumerate(run.steps()):
            logged_ns = step.measurement.stamp_ns + offset_ns
            now = step.estimate
            if step.measurement.stamp_ns not in topics.STAMPS_NS or (
                now is not None and now.stamp_ns not in topics.STAMPS_NS
            ):
                continue
            if now is not None:
                yield Event(logged_ns, now, now.pose, None if odom is None else odom[i])
            if isinstance(step.measurement, LandmarkScan | ImageFeatures):
                yield Event(logged_ns, step.measurement, None if now is None else now.pose)
            if ambiguous is not None and step.update_s is not None:
                unsure = ambiguous.ambiguity()
                news = [] if unsure is None else [kept.take(unsure)]
                for record in (*news, *ambiguous.events[happened:]):
                    if record is not None and record.stamp_ns in topics.STAMPS_NS:
                        yield Event(logged_ns, record, None)
                happened = len(ambiguous.events)

    lasting = _lasting(run.recording.field, truth, frames)
    span_ns = (int(stamps_ns[0]) + offset_ns, int(stamps_ns[-1]) + offset_ns)
    return Scenes(Timeline(events()), span_ns, lasting, run.recording.camera, run.recording.field, frames)


def frames_beside(sources: Sequence[Source]) -> topics.Frames:
    """Names that no one else's transforms use."""
    return topics.BESIDE_OTHERS if has_transforms(sources) else topics.Frames()


def _lasting(field: FieldMap | None, records: Sequence[Record], frames: topics.Frames) -> list[Encoded]:
    """The map, and the way of estimates and truth as far as it is known beforehand."""
    from logs.foxglove.results import field_messages, trajectory_messages

    estimates = [record for record in records if isinstance(record, Estimate)]
    truth = [record for record in records if isinstance(record, Truth) and record.stamp_ns in topics.STAMPS_NS]
    first: list[Estimate | Truth] = [*estimates[:1], *truth[:1]]
    first_ns = min((int(one.stamp_ns) for one in first), default=0)
    out: list[Encoded] = [] if field is None else [*field_messages(field, first_ns, frames)]
    if estimates:
        out += trajectory_messages(estimates, first_ns, frames)
    if truth:
        out += trajectory_messages(truth, first_ns, frames, TRUE_WAY)
    return out
