"""Protobuf by the descriptors that the log itself carries (MCAP: schema data is a FileDescriptorSet).

Every schema has a pool of its own: two files may describe the same name differently. Only here protobuf is imported;
mcap-protobuf-support would do the same with it, and bring mcap's reader along.
"""

from collections.abc import Callable, Iterable
from typing import NoReturn

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

from fieldloc.pose import FloatArray
from logs.foreign.parts import BadPart
from logs.foxglove.wire import to_ns


def protobuf_parser(name: str, descriptors: bytes) -> "Callable[[bytes], ProtobufFields]":
    """Parses messages of the type `name`. Where the descriptors do not describe it, each message is a BadPart."""
    try:
        kind = _message_class(name, descriptors)
    except (DecodeError, KeyError, TypeError, ValueError) as error:
        reason = f"the schema does not describe {name}: {next(iter(str(error).splitlines()), type(error).__name__)}"

        def refuse(data: bytes) -> ProtobufFields:
            raise BadPart(reason)

        return refuse

    def parse(data: bytes) -> ProtobufFields:
        try:
            return ProtobufFields(kind.FromString(data))
        except DecodeError:
            raise BadPart(f"not a {name}") from None

    return parse


def _message_class(name: str, descriptors: bytes) -> type[Message]:
    files = {file.name: file for file in FileDescriptorSet.FromString(descriptors).file}
    pool = DescriptorPool()
    while files:
        # what a file needs goes first; a need that no file meets is for the pool to refuse
        ready = [file for file in files.values() if not any(needed in files for needed in file.dependency)]
        if not ready:
            raise ValueError("its files need each other")
        for file in ready:
            pool.Add(files.pop(file.name))
    kind: type[Message] = GetMessageClass(pool.FindMessageTypeByName(name))
    return kind


class ProtobufFields:
    """`logs.foxglove.wire.Fields` of a protobuf message."""

    def __init__(self, message: Message) -> None:
        self._message = message

    def text(self, name: str) -> str:
        value = self._value(name)
        return value if isinstance(value, str) else self._refuse(name, "a string")

    def integer(self, name: str) -> int:
        value = self._value(name)
        return value if isinstance(value, int) else self._refuse(name, "an integer")

    def number(self, name: str) -> float:
        value = self._value(name)
        return float(value) if isinstance(value, (int, float)) else self._refuse(name, "a number")

    def maybe_number(self, name: str) -> float | None:
        return self.number(name) if self._is_set(name) else None

    def data(self, name: str) -> bytes:
        value = self._value(name)
        return value if isinstance(value, bytes) else self._refuse(name, "bytes")

    def numbers(self, name: str) -> FloatArray:
        value = self._value(name)
        if not isinstance(value, Iterable) or not all(isinstance(one, (int, float)) for one in value):
            return self._refuse(name, "a list of numbers")
        return np.array(list(value), dtype=np.float64)

    def child(self, name: str) -> "ProtobufFields | None":
        value = self._value(name)
        if not isinstance(value, Message):
            return self._refuse(name, "a message")
        return ProtobufFields(value) if self._is_set(name) else None

    def children(self, name: str) -> "tuple[ProtobufFields, ...]":
        value = self._value(name)
        if not isinstance(value, Iterable) or not all(isinstance(one, Message) for one in value):
            return self._refuse(name, "a list of messages")
        return tuple(ProtobufFields(one) for one in value)

    def stamp_ns(self, name: str) -> int | None:
        time = self.child(name)
        return None if time is None else to_ns(time.integer("seconds"), time.integer("nanos"), name)

    def _value(self, name: str) -> object:
        try:
            value: object = getattr(self._message, name)
        except AttributeError:
            return self._refuse(name, "in the schema")
        return value

    def _is_set(self, name: str) -> bool:
        try:
            return bool(self._message.HasField(name))
        except ValueError:  # a schema that does not tell unset from zero
            return True

    def _refuse(self, name: str, needed: str) -> NoReturn:
        raise BadPart(f"{name} is not {needed}")
