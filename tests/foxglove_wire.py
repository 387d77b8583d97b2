"""Foxglove messages for tests: as the SDK writes them, and read by the classes that Foxglove publishes."""

import base64
import importlib
import json

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.json_format import MessageToDict
from google.protobuf.unknown_fields import UnknownFieldSet

from logs.source import Source


def published(name):
    """The class that foxglove-schemas-protobuf has for foxglove.<name>."""
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


def of_sdk(message, topic="/x"):
    """(source, data) of a message of foxglove.messages."""
    schema = message.get_schema()
    return Source(topic, "protobuf", schema.name, schema.encoding, schema.data), message.encode()


def of_published(message, topic="/x"):
    """(source, data) of a message of the published classes, with the descriptors that it was generated from."""
    files = FileDescriptorSet()

    def add(file):
        for needed in file.dependencies:
            add(needed)
        if file.name not in {one.name for one in files.file}:
            file.CopyToProto(files.file.add())

    add(message.DESCRIPTOR.file)
    name = message.DESCRIPTOR.full_name
    return Source(topic, "protobuf", name, "protobuf", files.SerializeToString()), message.SerializeToString()


def as_json(source, data, topic="/x"):
    """The same message as Foxglove's JSON: times as {sec, nsec}, bytes in base64."""
    message = published(source.schema_name.removeprefix("foxglove.")).FromString(data)
    return Source(topic, "json", source.schema_name, "jsonschema", b"{}"), json.dumps(_tree(message)).encode()


def _tree(message):
    out = {}
    for field, value in message.ListFields():
        if field.message_type is not None and field.message_type.full_name == "google.protobuf.Timestamp":
            out[field.name] = {"sec": value.seconds, "nsec": value.nanos}
        elif field.is_repeated:
            out[field.name] = [_tree(one) for one in value] if field.message_type else list(value)
        elif field.message_type is not None:
            out[field.name] = _tree(value)
        elif isinstance(value, bytes):
            out[field.name] = base64.b64encode(value).decode()
        else:
            out[field.name] = value
    return out


def strictly(encoded):
    """The message by the published class of its schema; fails where that class would write other bytes."""
    kind = published(encoded.source.schema_name.removeprefix("foxglove."))
    message = kind.FromString(encoded.data)
    assert not unknown(message), f"{encoded.source.topic} holds fields that {encoded.source.schema_name} has not"
    assert message.SerializeToString(deterministic=True) == encoded.data
    MessageToDict(message)  # every enum value has a name, every time is one
    return message


def unknown(message):
    """Whether the message or one inside it has fields that its schema does not describe."""
    inside = []
    for field, value in message.ListFields():
        if field.message_type is not None:
            inside += list(value) if field.is_repeated else [value]
    return len(UnknownFieldSet(message)) > 0 or any(unknown(one) for one in inside)
