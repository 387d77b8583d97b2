"""Foxglove's JSON: times are {sec, nsec}, bytes are base64 (https://docs.foxglove.dev/docs/visualization/message-schemas)."""

import base64
import json
from typing import NoReturn

import numpy as np

from fieldloc.pose import FloatArray
from logs.foreign.parts import BadPart
from logs.foxglove.wire import to_ns

_NANOSECONDS = ("nsec", "nanosec")  # Foxglove's and ROS 2's spelling


def parse_json(data: bytes) -> "JsonFields":
    """BadPart for what is no JSON object."""
    try:
        parsed = json.loads(data)
    except (ValueError, RecursionError):
        raise BadPart("not JSON") from None
    if not isinstance(parsed, dict):
        raise BadPart("not a JSON object")
    return JsonFields(parsed)


class JsonFields:
    """`logs.foxglove.wire.Fields` of a JSON object. null counts as left out."""

    def __init__(self, values: dict[str, object]) -> None:
        self._values = values

    def text(self, name: str) -> str:
        value = self._values.get(name)
        if value is None:
            return ""
        return value if isinstance(value, str) else _refuse(name, "a string")

    def integer(self, name: str) -> int:
        value = self._values.get(name)
        if value is None:
            return 0
        return value if isinstance(value, int) and not isinstance(value, bool) else _refuse(name, "an integer")

    def number(self, name: str) -> float:
        return self.maybe_number(name) or 0.0

    def maybe_number(self, name: str) -> float | None:
        value = self._values.get(name)
        return None if value is None else _number(value, name)

    def data(self, name: str) -> bytes:
        text = self.text(name)
        try:
            return base64.b64decode(text, validate=True)
        except ValueError:  # also for characters outside ASCII
            return _refuse(name, "base64")

    def numbers(self, name: str) -> FloatArray:
        return np.array([_number(value, name) for value in self._list(name)], dtype=np.float64)

    def child(self, name: str) -> "JsonFields | None":
        value = self._values.get(name)
        return None if value is None else _object(value, name)

    def children(self, name: str) -> "tuple[JsonFields, ...]":
        return tuple(_object(value, name) for value in self._list(name))

    def stamp_ns(self, name: str) -> int | None:
        time = self.child(name)
        if time is None:
            return None
        spelling = next((key for key in _NANOSECONDS if key in time._values), _NANOSECONDS[0])
        return to_ns(time.integer("sec"), time.integer(spelling), name)

    def _list(self, name: str) -> list[object]:
        value = self._values.get(name)
        if value is None:
            return []
        return value if isinstance(value, list) else _refuse(name, "a list")


def _object(value: object, name: str) -> JsonFields:
    return JsonFields(value) if isinstance(value, dict) else _refuse(name, "an object")


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return _refuse(name, "a number")
    try:
        return float(value)
    except OverflowError:
        return _refuse(name, "a number that a double holds")


def _refuse(name: str, needed: str) -> NoReturn:
    raise BadPart(f"{name} is not {needed}")
