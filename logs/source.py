"""What stands in a log before anyone decodes it: channels, and messages as bytes. Knows no file format."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Protocol

_NONE: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Source:
    """What a channel says about its messages. Encodings are MCAP's names ("cdr", "ros1", "protobuf", "json", ...)."""

    topic: str
    message_encoding: str
    schema_name: str = ""
    schema_encoding: str = ""
    schema_data: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=lambda: _NONE)


def is_latched(source: Source) -> bool:
    """Whether ROS keeps its last message for who comes late: QoS transient local (ROS 2), latching (ROS 1)."""
    qos = source.metadata.get("offered_qos_profiles", "").replace(" ", "")
    transient_local = "durability:1\n" in f"{qos}\n" or "durability:transient_local" in qos
    return transient_local or source.metadata.get("latching") in ("1", "true", "True")


class RawMessage(NamedTuple):
    """A message as it stands in the file. channel: a key of its container's `sources`."""

    channel: int
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


class Encoded(NamedTuple):
    """A message that is ready for a file or a wire."""

    source: Source
    log_time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside a log."""

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    data: bytes


class Container(Protocol):
    """A recording of any format, opened; nothing is kept open between calls.

    sources, counts: by channel number; a count is that of the messages which can be read. span_ns: log time of the
    first and the last message, None where there are none. metadata: records by name. damage: what is wrong with the
    file, one sentence each.
    """

    @property
    def path(self) -> Path: ...
    @property
    def sources(self) -> Mapping[int, Source]: ...
    @property
    def counts(self) -> Mapping[int, int]: ...
    @property
    def span_ns(self) -> tuple[int, int] | None: ...
    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]: ...
    @property
    def damage(self) -> tuple[str, ...]: ...

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages of these channels with start <= log time < end, in the order of log time, ties as in the file."""

    def attachments(self) -> Iterator[Attachment]:
        """The files inside, one at a time."""
