"""A log with pictures, and what is seen in them beside them."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures
from logs.edit.copying import Copy, Summary
from logs.output import output_file
from logs.pictures import picture_features
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.schema import TOPICS
from logs.source import RawMessage
from logs.writer import LogWriter


def with_features(
    log: LogFile, out: Path | str, field: FieldMap | None = None, progress: Progress = unwatched
) -> Summary:
    """A copy of the log with posts and lines of its pictures as fieldloc's own image features, each logged when its
    picture was taken. Features of that kind that are in the log already are left out, with a note.

    field: says what colour posts are; the log's own by default. FieldlocError where there are no pictures, no camera,
    no map, or nothing that says where the camera was.
    """
    topic = TOPICS["image_features"]
    path = output_file(Path(out), log.path)
    field = log.field_map() if field is None else field
    if field is None:
        raise FieldlocError(f"{log.path}: holds no map; name one with --field, for example --field kidsize")
    found = sorted(picture_features(log, field, progress), key=lambda features: features.stamp_ns)
    if not found:
        raise FieldlocError("; ".join((f"{log.path}: no picture can be used", *log.warnings)))
    container = log.container
    kept = [number for number, source in container.sources.items() if source.topic != topic]
    with LogWriter(path, signed=False) as writer:
        copy = Copy(container, writer, progress)
        copy.everything_else()
        copy.messages(_between(container.messages(kept), found, writer), container.span_ns or (0, 0))
    done = copy.summary(path)
    replaced = len(kept) < len(container.sources)
    notes = (f"what {topic} held before is left out",) if replaced else ()
    told = sum(len(features.posts) for features in found), sum(len(features.lines) for features in found)
    seen = f"{topic}: {len(found)} pictures, {told[0]} posts, {told[1]} lines"
    return Summary(
        done.path, {**done.counts, topic: len(found)}, done.span_ns, done.attachments, done.lost, (seen, *notes)
    )


def _between(messages: Iterator[RawMessage], found: Sequence[ImageFeatures], writer: LogWriter) -> Iterator[RawMessage]:
    """The messages, while the features are written as their time comes."""
    topic = TOPICS["image_features"]
    waiting = iter(found)
    features = next(waiting, None)
    for message in messages:
        while features is not None and features.stamp_ns < message.log_time_ns:
            writer.write(topic, features)
            features = next(waiting, None)
        yield message
    for late in chain(() if features is None else (features,), waiting):
        writer.write(topic, late)
