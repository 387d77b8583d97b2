"""ROS message definitions, as they stand in a log, as trees of fields."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from logs.ros.types import short_name
from logs.source import Source

PRIMITIVES = frozenset(
    ("bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
    + ("float32", "float64", "string", "wstring")
)
SEQUENCE = -1
"""As a field's `count`: as many as the message says."""

_MOST = 2**31  # elements of an array; no message is that long
_LINE = re.compile(
    r"\s*(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?P<bound><=)?(?P<count>\d*)\])?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)"
)


class BadDefinition(ValueError):
    """A definition that cannot be read, or that lacks what its type's name promises."""


@dataclass(frozen=True, slots=True)
class Field:
    """count: None for one, SEQUENCE, or that of an array. type: a primitive's name or `pkg/Type`."""

    name: str
    type: str
    count: int | None = None


Fields = tuple[Field, ...]

_BUILT_IN: Mapping[str, Fields] = MappingProxyType(
    {
        "time": (Field("sec", "uint32"), Field("nanosec", "uint32")),
        "duration": (Field("sec", "int32"), Field("nanosec", "int32")),
        "builtin_interfaces/Time": (Field("sec", "int32"), Field("nanosec", "uint32")),
        "builtin_interfaces/Duration": (Field("sec", "int32"), Field("nanosec", "uint32")),
        "tf/tfMessage": (Field("transforms", "geometry_msgs/TransformStamped", SEQUENCE),),
        "tf2_msgs/TFMessage": (Field("transforms", "geometry_msgs/TransformStamped", SEQUENCE),),
    }
)


@dataclass(frozen=True, slots=True)
class Definitions:
    """The types of one schema. What it leaves out, as some recorders do with standard types, is filled in."""

    ros1: bool
    written: Mapping[str, Fields]

    def fields(self, name: str) -> Fields:
        """BadDefinition where nobody defines it."""
        for known in (self.written, _BUILT_IN):
            if name in known:
                return known[name]
        standard = _standard(self.ros1)
        if name not in standard:
            raise BadDefinition(f"the definition of {name} is missing")
        return standard[name]


def definitions(source: Source) -> Definitions:
    """What the schema of a ROS source defines; BadDefinition where it cannot be read."""
    ros1 = source.message_encoding == "ros1"
    try:
        text = source.schema_data.decode()
    except UnicodeDecodeError:
        text = source.schema_data.decode("latin-1")  # comments are all that can be beyond ASCII
    if not text.strip():
        return Definitions(ros1, {})
    if source.schema_encoding == "ros2idl":
        return Definitions(ros1, _from_idl(text))
    return Definitions(ros1, dict(_from_msg(text, short_name(source.schema_name))))


def _from_msg(text: str, name: str) -> Iterator[tuple[str, Fields]]:
    """Sections divided by lines of `=`; each but the first begins with `MSG: pkg/Type`."""
    sections = re.split(r"^={3,}[ \t\r]*$", text, flags=re.MULTILINE)
    names = {name: sections[0]}
    for section in sections[1:]:
        head, _, body = section.strip("\r\n").partition("\n")
        kind, _, called = head.partition(":")
        if kind.strip() != "MSG" or not called.strip():
            raise BadDefinition(f"the definition of {name} has a section without a name: {head[:40]!r}")
        names.setdefault(short_name(called.strip()), body)
    for called, body in names.items():
        yield called, tuple(_fields(body, called.partition("/")[0], frozenset(names)))


def _fields(body: str, package: str, names: frozenset[str]) -> Iterator[Field]:
    for line in body.split("\n"):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        match = _LINE.match(line)
        if match is None:
            raise BadDefinition(f"{line.strip()[:60]!r} defines no field")
        if match["rest"].lstrip().startswith("="):
            continue  # a constant
        count = None if match["array"] is None else SEQUENCE
        if match["array"] and match["count"] and not match["bound"]:
            count = int(match["count"][:12])
            if count > _MOST:
                raise BadDefinition(f"{line.strip()[:60]!r} is too large")
        yield Field(match["name"], _resolve(match["type"], package, names), count)


def _resolve(name: str, package: str, names: frozenset[str]) -> str:
    """A type's full name, seen from a message of this package."""
    if name in PRIMITIVES or name in ("time", "duration"):
        return name
    if "/" in name:
        return short_name(name)
    own = f"{package}/{name}"
    return "std_msgs/Header" if name == "Header" and own not in names else own


def _from_idl(text: str) -> Mapping[str, Fields]:
    from rosbags.typesys import TypesysError, get_types_from_idl

    found: dict[str, Fields] = {}
    for section in re.split(r"^={3,}[ \t\r]*$", text, flags=re.MULTILINE):
        if body := re.sub(r"\A\s*IDL:[^\n]*\n", "", section).strip():
            try:
                found.update(_converted(get_types_from_idl(body)))
            except (TypesysError, ValueError, KeyError, IndexError, AttributeError, TypeError, RecursionError) as error:
                raise BadDefinition(f"the IDL cannot be read: {str(error)[:80]!r}") from None
    return found


@cache
def _standard(ros1: bool) -> Mapping[str, Fields]:
    """What every ROS installation brings."""
    from rosbags.typesys import Stores, get_typestore

    return _converted(get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST).fielddefs)


def _converted(types: Mapping[str, tuple[object, Sequence[tuple[str, tuple[int, object]]]]]) -> dict[str, Fields]:
    return {short_name(name): tuple(_field(*field) for field in fields) for name, (_, fields) in types.items()}


def _field(name: str, description: tuple[int, object]) -> Field:
    """From rosbags' tree: (1, (primitive, bound)), (2, type), (3, (element, count)), (4, (element, bound))."""
    kind, inside = description
    match kind, inside:
        case 1, (str() as primitive, _):
            return Field(name, primitive)
        case 2, str() as nested:
            return Field(name, short_name(nested))
        case ((3 | 4), (tuple() as element, int() as count)):
            return Field(name, _field(name, element).type, count if kind == 3 else SEQUENCE)
    raise BadDefinition(f"{name} is of a kind that is not known here")
