"""What a file holds and where, as it is kept in memory: small, whatever the file's size."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from logs.reader.damage import Losses
from logs.reader.records import Channel, Schema, Span
from logs.source import Source

_MOST_BLOCKS = 1 << 15
_COALESCED_BYTES = 1 << 22


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of whole records with messages in it.

    first_ns, last_ns: log times of the earliest and the latest. chunks: how many there are in it; 0: it is messages
    outside chunks. channels: None where it is not known. cut: it is a chunk without its end.
    """

    start: int
    end: int
    first_ns: int
    last_ns: int
    chunks: int
    channels: frozenset[int] | None = None
    cut: bool = False


class Blocks:
    """Blocks in the order of the file. Where they are many, neighbours are made one, so that there are never many."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._channels: dict[frozenset[int], frozenset[int]] = {}  # one object for all that are equal
        self._limit = _MOST_BLOCKS

    def __iter__(self) -> Iterator[Block]:
        return iter(self._blocks)

    def shared(self, channels: frozenset[int]) -> frozenset[int]:
        return self._channels.setdefault(channels, channels)

    def add(self, block: Block) -> None:
        self._blocks.append(block)
        if len(self._blocks) >= self._limit:
            before = len(self._blocks)
            self._coalesce()
            if len(self._blocks) > before // 2:  # they are as big as they may get
                self._limit = 2 * len(self._blocks)

    def _coalesce(self) -> None:
        out: list[Block] = []
        for block in self._blocks:
            last = out[-1] if out else None
            alike = last is not None and bool(last.chunks) == bool(block.chunks) and not last.cut and not block.cut
            if last is None or not alike or block.end - last.start > _COALESCED_BYTES:
                out.append(block)
                continue
            channels = None
            if last.channels is not None and block.channels is not None:
                channels = self.shared(last.channels | block.channels)
            first_ns, last_ns = min(last.first_ns, block.first_ns), max(last.last_ns, block.last_ns)
            out[-1] = Block(last.start, block.end, first_ns, last_ns, last.chunks + block.chunks, channels)
        self._blocks = out


@dataclass(slots=True)
class Definitions:
    """Schemas and channels met so far. Where a number is given twice, the first holds."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    contradicted: set[int] = field(default_factory=set)

    def add_schema(self, schema: Schema) -> None:
        self.schemas.setdefault(schema.number, schema)

    def add_channel(self, channel: Channel) -> None:
        known = self.channels.setdefault(channel.number, channel)
        if known != channel:
            self.contradicted.add(channel.number)

    def sources(self) -> Mapping[int, Source]:
        return {number: self._source(channel) for number, channel in self.channels.items()}

    def _source(self, channel: Channel) -> Source:
        schema = self.schemas.get(channel.schema, Schema(0, "", "", b""))
        return Source(channel.topic, channel.encoding, schema.name, schema.encoding, schema.data, channel.metadata)


@dataclass(frozen=True, slots=True)
class Contents:
    """sources and counts by channel number. span_ns: log time of the first and the last message. attachments: where
    they stand. losses: what is wrong with the file; reading its messages may add to it."""

    sources: Mapping[int, Source]
    counts: Mapping[int, int]
    blocks: tuple[Block, ...]
    span_ns: tuple[int, int] | None
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[Span, ...]
    losses: Losses
