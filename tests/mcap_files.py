"""MCAP files of every shape for the reader's tests: by mcap's own writer, and byte by byte."""

import struct
import zlib
from pathlib import Path

import lz4.frame
import mcap.writer
import zstandard
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from logs.reader.mcap_container import McapContainer
from logs.reader.records import MAGIC, Op
from logs.source import RawMessage

SHARED = Path(__file__).parents[2] / "shared" / "data" / "mcap"
PACK = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}


def text(value):
    return struct.pack("<I", len(value.encode())) + value.encode()


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


HEADER = record(Op.HEADER, text("") + text(""))
DATA_END = record(Op.DATA_END, bytes(4))
END = DATA_END + record(Op.FOOTER, bytes(20)) + MAGIC


def schema(number=1, name="s", encoding="jsonschema", data=b"{}"):
    content = struct.pack("<H", number) + text(name) + text(encoding) + struct.pack("<I", len(data)) + data
    return record(Op.SCHEMA, content)


def channel(number=1, topic="/t", schema=1, encoding="json"):
    return record(Op.CHANNEL, struct.pack("<HH", number, schema) + text(topic) + text(encoding) + bytes(4))


def message(log_time_ns, number=1, data=b"", sequence=0, publish_time_ns=0):
    return record(Op.MESSAGE, struct.pack("<HIQQ", number, sequence, log_time_ns, publish_time_ns) + data)


def metadata(name, **pairs):
    content = b"".join(text(key) + text(value) for key, value in pairs.items())
    return record(Op.METADATA, text(name) + struct.pack("<I", len(content)) + content)


def chunk(content, first_ns=0, last_ns=0, compression="zstd", size=None, crc=None, packed=None):
    """size, crc, packed: lies."""
    packed = PACK[compression](content) if packed is None else packed
    size = len(content) if size is None else size
    crc = zlib.crc32(content) if crc is None else crc
    head = struct.pack("<QQQI", first_ns, last_ns, size, crc) + text(compression) + struct.pack("<Q", len(packed))
    return record(Op.CHUNK, head + packed)


def message_index(number, entries):
    content = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(Op.MESSAGE_INDEX, struct.pack("<HI", number, len(content)) + content)


def chunk_of(times, compression="zstd", indexed=True, data=b"x" * 20, **lies):
    """A chunk with a message of channel 1 at each of these times, and its message index."""
    content = b"".join(message(time, data=data, sequence=i) for i, time in enumerate(times))
    out = chunk(content, min(times), max(times), compression, **lies)
    return out + (message_index(1, [(time, 0) for time in times]) if indexed else b"")


DEFINED = HEADER + schema() + channel()


def put(path, *parts):
    path.write_bytes(MAGIC + b"".join(parts))
    return path


def messages(path, *span_ns):
    """All messages of a file, and what is wrong with it after they were read."""
    container = McapContainer(path)
    read = list(container.messages(container.sources, *span_ns))
    return read, container.damage


def times(path, *span_ns):
    return [raw.log_time_ns for raw in messages(path, *span_ns)[0]]


def written(path, rng, count=200, size=40, channels=3, times=None, **options):
    """A file by mcap's own writer with random messages, a metadata record and an attachment in the middle."""
    with path.open("wb") as file:
        log = mcap.writer.Writer(file, **options)
        log.start()
        number = log.register_schema("s", "jsonschema", b"{}")
        numbers = [log.register_channel(f"/t{i}", "json", number if i else 0) for i in range(channels)]
        for i in range(count):
            time_ns = rng.randrange(10**9) if times is None else times(i)
            log.add_message(rng.choice(numbers), time_ns, rng.randbytes(rng.randrange(size)), rng.randrange(9), i)
            if i == count // 2:
                log.add_metadata("m", {"a": "b"})
                log.add_attachment(5, 6, "name", "text/plain", b"data")
        log.finish()
    return path


def by_mcap(path, channels=None):
    """The messages as mcap's stream reader gives them, sorted by log time, those at equal times as they stand."""
    with path.open("rb") as file:
        found = list(StreamReader(file, validate_crcs=True, record_size_limit=None).records)
    raw = [
        RawMessage(r.channel_id, r.log_time, r.publish_time, r.sequence, r.data)
        for r in found
        if isinstance(r, Message) and (channels is None or r.channel_id in channels)
    ]
    return sorted(raw, key=lambda message: message.log_time_ns)


def definitions_by_mcap(path):
    """Channels and schemas by number, metadata by name, attachments."""
    with path.open("rb") as file:
        found = list(StreamReader(file).records)
    return (
        {r.id: r for r in found if isinstance(r, Channel)},
        {r.id: r for r in found if isinstance(r, Schema)},
        {r.name: r.metadata for r in found if isinstance(r, Metadata)},
        [r for r in found if isinstance(r, Attachment)],
    )
