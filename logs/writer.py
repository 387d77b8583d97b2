"""Records out: an MCAP file that appears under its name only when it is whole."""

import contextlib
import os
import secrets
import signal
import threading
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType, TracebackType

import mcap.writer

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from logs.schema import BY_KIND, MESSAGE_ENCODING, SCHEMA_ENCODING, Record, Schema, encode

METADATA = "fieldloc"
"""Name of the metadata record in which fieldloc says how a log was made."""

_CHUNK_BYTES = 256 * 1024  # what a killed program loses at most of its unfinished file


class LogWriter:
    """Use as a context manager; the file is there, whole, after the block, and not at all if the block raises.

    metadata: how the log was made (estimator, configuration, source, ...), stored beside fieldloc's version.
    The same calls give the same bytes. Until the end the messages are in a hidden file beside it, whose name ends in
    `.partial`; it is removed when the block ends by an exception, Ctrl-C or SIGTERM, and stays readable after SIGKILL.
    """

    def __init__(self, path: str | Path, metadata: Mapping[str, str] | None = None) -> None:
        self.path = Path(os.path.realpath(path))
        self._metadata = {"version": _version(), **(metadata or {})}
        self._channels: dict[str, tuple[int, Schema]] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "LogWriter":
        with self._as_fieldloc_error(), contextlib.ExitStack() as stack:
            if self.path.is_dir():
                raise FieldlocError(f"{self.path}: is a directory; give a file to write")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._partial = self.path.with_name(f".{self.path.name}.{secrets.token_hex(4)}.partial")
            stack.enter_context(_sigterm_as_exit())
            stack.callback(self._partial.unlink, missing_ok=True)
            self._file = stack.enter_context(self._partial.open("xb"))
            self._mcap = mcap.writer.Writer(self._file, chunk_size=_CHUNK_BYTES)
            self._mcap.start(library=f"fieldloc {_version()}")
            self._mcap.add_metadata(METADATA, self._metadata)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._as_fieldloc_error(), self._stack:
            if kind is None:
                self._mcap.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
                self._partial.replace(self.path)

    def write(self, topic: str, record: Record, log_time_ns: int | None = None) -> None:
        """Append a message; `logs.schema.topic_of(type(record))` is the usual topic.

        log_time_ns: the record's stamp by default; the map and the camera have none and need it. ValueError for a
        record that no reader would accept, and for two kinds of record on one topic.
        """
        stamp_ns = log_time_ns if isinstance(record, (Camera, FieldMap)) else record.stamp_ns
        if stamp_ns is None:
            raise ValueError(f"a {type(record).__name__} has no stamp: give log_time_ns")
        data = encode(record)
        with self._as_fieldloc_error():
            channel = self._channel(topic, BY_KIND[type(record)])
            sequence = self._sequences[channel] = self._sequences.get(channel, -1) + 1
            time_ns = stamp_ns if log_time_ns is None else log_time_ns
            self._mcap.add_message(channel, time_ns, data, publish_time=stamp_ns, sequence=sequence)

    def _channel(self, topic: str, schema: Schema) -> int:
        if topic not in self._channels:
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._mcap.register_schema(
                    schema.name, SCHEMA_ENCODING, schema.text.encode()
                )
            channel = self._mcap.register_channel(topic, MESSAGE_ENCODING, self._schemas[schema.name])
            self._channels[topic] = (channel, schema)
        channel, carried = self._channels[topic]
        if carried is not schema:
            raise ValueError(f"topic {topic} carries {carried.name}, not {schema.name}")
        return channel

    @contextlib.contextmanager
    def _as_fieldloc_error(self) -> Iterator[None]:
        """A full disk or a folder without permission is the user's to mend."""
        try:
            yield
        except OSError as error:
            raise FieldlocError(f"{self.path}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def _sigterm_as_exit() -> Iterator[None]:
    """While inside, SIGTERM unwinds the program as Ctrl-C does, unless someone else already handles it."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _version() -> str:
    try:
        return version("fieldloc")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"
