"""Files inside a file."""

import zlib
from typing import IO

from logs.reader.records import HEAD, LIMIT_BYTES, Damaged, Fields, Span
from logs.source import Attachment


def read_attachment(file: IO[bytes], span: Span) -> Attachment:
    """The attachment that stands there; Damaged if it is not whole or its CRC is wrong (0: it has none)."""
    if span.end - span.start > LIMIT_BYTES:
        raise Damaged("too big")
    file.seek(span.start + HEAD.size)
    content = file.read(span.end - span.start - HEAD.size)
    fields = Fields(content)
    log_time, create_time, name, media_type = fields.number(8), fields.number(8), fields.text(), fields.text()
    data = fields.take(fields.number(8))
    end, crc = fields.at, fields.number(4)
    if crc and zlib.crc32(memoryview(content)[:end]) != crc:
        raise Damaged("its checksum is wrong")
    return Attachment(name, media_type, log_time, create_time, data)
