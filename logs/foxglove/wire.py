"""What a decoded message offers, whatever it was encoded in."""

from typing import Protocol

from fieldloc.pose import FloatArray
from logs.foreign.parts import BadPart

_INT64 = range(-(2**63), 2**63)


class Fields(Protocol):
    """The fields of one message. A field that is not set has protobuf's default: 0, "", empty, or no child.

    Each raises BadPart where the field is of another type, or its schema has no such field.
    """

    def text(self, name: str) -> str: ...
    def integer(self, name: str) -> int: ...
    def number(self, name: str) -> float: ...
    def data(self, name: str) -> bytes: ...

    def maybe_number(self, name: str) -> float | None:
        """None where the sender left it out."""

    def numbers(self, name: str) -> FloatArray:
        """(n,)"""

    def child(self, name: str) -> "Fields | None":
        """None where the sender left it out."""

    def children(self, name: str) -> "tuple[Fields, ...]": ...

    def stamp_ns(self, name: str) -> int | None:
        """None where the sender left it out."""


def to_ns(seconds: int, nanoseconds: int, name: str) -> int:
    """A stamp that an int64 holds; BadPart else."""
    total = seconds * 1_000_000_000 + nanoseconds
    if total not in _INT64 or not 0 <= nanoseconds < 1_000_000_000:
        raise BadPart(f"{name}: {seconds} s and {nanoseconds} ns are no time")
    return total
