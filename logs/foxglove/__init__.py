"""Foxglove's messages: their wire to parts, and fieldloc's results as messages that Foxglove and Lichtblick draw.

Reading is here and imports neither foxglove nor, until a protobuf channel is met, protobuf. Writing is in
`logs.foxglove.results`, which needs the foxglove-sdk.
"""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

from logs.foreign.parts import Part
from logs.foxglove.kinds import KINDS
from logs.foxglove.wire import Fields
from logs.source import Source

_SCHEMA_ENCODINGS = {"protobuf": "protobuf", "json": "jsonschema"}  # by message encoding, as MCAP's registry has them


def known_type(source: Source) -> type[Part] | None:
    """What the channel's messages become, judged by its encodings and its schema's name; None: not ours."""
    if _SCHEMA_ENCODINGS.get(source.message_encoding) != source.schema_encoding:
        return None
    kind = KINDS.get(source.schema_name)
    return kind.part if kind else None


def decoder(source: Source) -> Callable[[bytes], Part] | None:
    """Decodes the channel's messages by the schema in `source`; None where `known_type` is.

    The function raises BadPart for a message that is none, and for every message where the schema itself is broken.
    """
    if known_type(source) is None:
        return None
    convert, parse = KINDS[source.schema_name].convert, _parser(source)
    return lambda data: convert(parse(data))


def _parser(source: Source) -> Callable[[bytes], Fields]:
    if source.message_encoding == "json":
        from logs.foxglove.json_wire import parse_json

        return parse_json
    from logs.foxglove.protobuf_wire import protobuf_parser

    return protobuf_parser(source.schema_name, source.schema_data)


def layout_path() -> Path:
    """A layout for Foxglove and Lichtblick (Layouts, Import from file) that shows what fieldloc writes."""
    return Path(str(resources.files("logs.foxglove") / "layout.json"))
