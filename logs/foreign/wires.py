"""Which room decodes a channel. Nothing of ROS or Foxglove is imported for a log that has nothing of theirs."""

from collections.abc import Callable, Iterable

from logs.foreign.parts import Part, Transforms
from logs.schema import BY_NAME, MESSAGE_ENCODING, SCHEMA_ENCODING, Schema
from logs.source import Source

_ROS = ("cdr", "ros1")
_FOXGLOVE = ("protobuf", "json")


def own_schema(source: Source) -> Schema | None:
    """What fieldloc itself wrote there, if it did."""
    if (source.message_encoding, source.schema_encoding) != (MESSAGE_ENCODING, SCHEMA_ENCODING):
        return None
    return BY_NAME.get(source.schema_name)


def known_type(source: Source) -> type[Part] | None:
    """What the messages of someone else's channel become; None where that is not known."""
    if source.message_encoding in _ROS:
        from logs import ros

        return ros.known_type(source)
    if source.message_encoding in _FOXGLOVE:
        from logs import foxglove

        return foxglove.known_type(source)
    return None


def has_transforms(sources: Iterable[Source]) -> bool:
    """Whether someone else's frames are in it: frames of the same name must not get a second parent."""
    return any(known_type(source) is Transforms for source in sources)


def decoder(source: Source) -> Callable[[bytes], Part] | None:
    """Raises BadPart for a message that does not fit; None where `known_type` is."""
    if source.message_encoding in _ROS:
        from logs import ros

        return ros.decoder(source)
    if source.message_encoding in _FOXGLOVE:
        from logs import foxglove

        return foxglove.decoder(source)
    return None
