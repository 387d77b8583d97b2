"""A Foxglove message with all that a channel needs to know of it."""

from functools import cache
from typing import Protocol

from foxglove import Schema

from logs.source import Encoded, Source


class Message(Protocol):
    """One of foxglove.messages."""

    @staticmethod
    def get_schema() -> Schema: ...
    def encode(self) -> bytes: ...


def encoded(topic: str, log_time_ns: int, message: Message) -> Encoded:
    return Encoded(channel(topic, type(message)), log_time_ns, message.encode())


@cache
def channel(topic: str, kind: type[Message]) -> Source:
    schema = kind.get_schema()
    return Source(topic, "protobuf", schema.name, schema.encoding, schema.data)
