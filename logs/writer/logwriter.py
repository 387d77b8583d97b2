"""Records and raw messages into one MCAP file."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType

from mcap.records import Attachment as AttachmentRecord

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from logs.schema import BY_KIND, MESSAGE_ENCODING, SCHEMA_ENCODING, Record, Schema, encode
from logs.source import Attachment, Encoded, Source
from logs.writer.partial import partial_file
from logs.writer.stream import McapStream

METADATA = "fieldloc"
"""Name of the metadata record in which fieldloc says how a log was made."""
ROS2 = "ros2"
"""MCAP's name for a file in which everything is ROS 2."""

_REMEMBERED = 1024  # sources whose channels are found without comparing their contents

_Key = tuple[str, str, str, str, bytes, tuple[tuple[str, str], ...]]


class LogWriter:
    """Use as a context manager; the file is there, whole, after the block, and not at all if the block raises.

    metadata: how the log was made (estimator, configuration, source, ...), stored beside fieldloc's version.
    signed: False where the record "fieldloc" with all that is left out, as in the copy of another log.
    profile: MCAP's word for what the whole file is ("ros1" or ROS2), if it is.
    The same calls give the same bytes. Until the end the messages are in a hidden file beside it, whose name ends in
    `.partial`; it is removed when the block ends by an exception, Ctrl-C or SIGTERM, and stays readable after SIGKILL:
    all but what came in its last second is in it.
    """

    def __init__(
        self, path: str | Path, metadata: Mapping[str, str] | None = None, profile: str = "", signed: bool = True
    ) -> None:
        self.path = Path(os.path.realpath(path))
        self._metadata = {"version": _version(), **(metadata or {})} if signed else None
        self._profile = profile
        self._known: dict[int, tuple[Source, int]] = {}
        self._channels: dict[_Key, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._own: dict[str, tuple[Schema, Source]] = {}
        self._sequences: dict[int, int] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "LogWriter":
        with self._as_fieldloc_error(), contextlib.ExitStack() as stack:
            self._stream = McapStream(
                stack.enter_context(partial_file(self.path)), f"fieldloc {_version()}", self._profile
            )
            if self._metadata is not None:
                self._stream.metadata(METADATA, self._metadata)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._as_fieldloc_error():
            if error is not None:
                self._stack.__exit__(kind, error, trace)
                return
            with self._stack:
                self._stream.finish()

    def write(self, topic: str, record: Record, log_time_ns: int | None = None) -> None:
        """Append a message; `logs.schema.topic_of(type(record))` is the usual topic.

        log_time_ns: the record's stamp by default; the map and the camera have none and need it. ValueError for a
        record that no reader would accept, and for two kinds of record on one topic.
        """
        stamp_ns = log_time_ns if isinstance(record, (Camera, FieldMap)) else record.stamp_ns
        if stamp_ns is None:
            raise ValueError(f"a {type(record).__name__} has no stamp: give log_time_ns")
        data = encode(record)
        source = self._source(topic, BY_KIND[type(record)])
        self.write_raw(source, stamp_ns if log_time_ns is None else log_time_ns, data, stamp_ns)

    def write_raw(
        self,
        source: Source,
        log_time_ns: int,
        data: bytes,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Append a message as it is. Sources that say the same are one channel.

        publish_time_ns: the log time by default. sequence: the number of the channel's messages before it by default.
        ValueError for times that MCAP cannot hold (they are unsigned).
        """
        known = self._known.get(id(source))
        try:
            channel = known[1] if known else self._channel(source)
            if sequence is None:
                sequence = self._sequences.get(channel, 0)
                self._sequences[channel] = sequence + 1 & 0xFFFFFFFF
            published_ns = log_time_ns if publish_time_ns is None else publish_time_ns
            self._stream.message(channel, sequence, log_time_ns, published_ns, data)
        except OSError as error:
            raise self._unwritable(error) from None

    def add_encoded(self, encoded: Encoded) -> None:
        """Append a message that is ready for it."""
        self.write_raw(encoded.source, encoded.log_time_ns, encoded.data)

    def add_source(self, source: Source) -> None:
        """Tell of a channel that may stay without messages."""
        with self._as_fieldloc_error():
            self._channel(source)

    def attach(self, attachment: Attachment) -> None:
        """Append a file."""
        with self._as_fieldloc_error():
            self._stream.attachment(
                AttachmentRecord(
                    create_time=attachment.create_time_ns,
                    log_time=attachment.log_time_ns,
                    name=attachment.name,
                    media_type=attachment.media_type,
                    data=attachment.data,
                )
            )

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Append a metadata record."""
        with self._as_fieldloc_error():
            self._stream.metadata(name, mapping)

    def keep(self) -> None:
        """Give the operating system what has come so far.

        Writing does so once a second; call it where nothing may come for longer than that.
        """
        with self._as_fieldloc_error():
            self._stream.keep()

    def _source(self, topic: str, schema: Schema) -> Source:
        if topic not in self._own:
            source = Source(topic, MESSAGE_ENCODING, schema.name, SCHEMA_ENCODING, schema.text.encode())
            self._own[topic] = schema, source
        carried, source = self._own[topic]
        if carried is not schema:
            raise ValueError(f"topic {topic} carries {carried.name}, not {schema.name}")
        return source

    def _channel(self, source: Source) -> int:
        schema = source.schema_name, source.schema_encoding, source.schema_data
        key = source.topic, source.message_encoding, *schema, tuple(sorted(source.metadata.items()))
        if key not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._stream.schema(*schema) if any(schema) else 0
            self._channels[key] = self._stream.channel(
                source.topic, source.message_encoding, self._schemas[schema], source.metadata
            )
        if len(self._known) == _REMEMBERED:  # someone makes a new source for each message
            self._known.clear()
        self._known[id(source)] = source, self._channels[key]  # with the source, so that its id is no other's
        return self._channels[key]

    @contextlib.contextmanager
    def _as_fieldloc_error(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> FieldlocError:
        """A full disk or a folder without permission is the user's to mend."""
        return FieldlocError(f"{self.path}: cannot be written: {error.strerror or error}")


def _version() -> str:
    try:
        return version("fieldloc")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"
