"""What kind of game to make up: one frozen tree, by name or from a TOML file, stored with every log it makes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from dataclasses import field as member  # a scenario has a field of its own
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from fieldloc.errors import FieldlocError
from fieldloc.field import PRESETS as FIELDS
from fieldloc.toml_table import read_toml
from logs.simulate.settings import (
    CompassSettings,
    DeliverySettings,
    FallSettings,
    KidnappingSettings,
    OdometrySettings,
    OthersSettings,
    PenaltySettings,
    StartSettings,
    WalkSettings,
)
from logs.simulate.vision_settings import VisionSettings

SCENARIOS = ("kidsize-game", "spl-game", "quiet", "kidnapped", "falls", "no-compass", "ideal", "crowded")
_COURSE_HZ = 100
_LONGEST_S = 6 * 3600.0  # of which every sample is kept in memory

if TYPE_CHECKING:  # type checkers have a name for all dataclasses, Python has none
    from _typeshed import DataclassInstance

Section = TypeVar("Section", bound="DataclassInstance")


@dataclass(frozen=True, slots=True)
class Scenario:
    """field: a preset of fieldloc.field or the path of a map. truth_hz: of the truth in the log, a divisor of 100.
    about: one sentence for people."""

    about: str = ""
    field: str = "kidsize"
    duration_s: float = 600.0
    truth_hz: int = 100
    start: StartSettings = member(default_factory=StartSettings)
    walk: WalkSettings = member(default_factory=WalkSettings)
    falls: FallSettings = member(default_factory=FallSettings)
    kidnappings: KidnappingSettings = member(default_factory=KidnappingSettings)
    penalties: PenaltySettings = member(default_factory=PenaltySettings)
    others: OthersSettings = member(default_factory=OthersSettings)
    odometry: OdometrySettings = member(default_factory=OdometrySettings)
    compass: CompassSettings = member(default_factory=CompassSettings)
    delivery: DeliverySettings = member(default_factory=DeliverySettings)
    vision: VisionSettings = member(default_factory=VisionSettings)

    def __post_init__(self) -> None:
        if not 0.1 <= self.duration_s <= _LONGEST_S:
            raise ValueError(f"duration_s: needs seconds from 0.1 to {_LONGEST_S:g}, got {self.duration_s}")
        if self.truth_hz < 1 or _COURSE_HZ % self.truth_hz:
            raise ValueError(f"truth_hz: needs a divisor of {_COURSE_HZ}, got {self.truth_hz}")

    def to_json(self) -> str:
        return json.dumps(asdict(self), ensure_ascii=False)


def load_scenario(name_or_path: str) -> Scenario:
    """The scenario of that name, or the one in that TOML file; FieldlocError names file and key for every mistake."""
    if name_or_path in SCENARIOS:
        text = (resources.files("logs.simulate") / "scenarios" / f"{name_or_path}.toml").read_text(encoding="utf-8")
        return _parse(text, name_or_path)
    path = Path(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        names = ", ".join(SCENARIOS)
        raise FieldlocError(f"{path}: no such scenario; give one of {names}, or the path of a TOML file") from None
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise FieldlocError(f"{path}: cannot be read as a scenario: {error}") from None
    scenario = _parse(text, str(path))
    # a map's path in a file is seen from that file
    return scenario if scenario.field in FIELDS else replace(scenario, field=str(path.parent / scenario.field))


def with_settings(scenario: Scenario, settings: Sequence[str]) -> Scenario:
    """The scenario with settings like "odometry.rate_hz=100", in TOML's spelling, the last of equal ones winning."""
    for setting in settings:
        key, _, value = setting.partition("=")
        if not (key.strip() and value.strip()):
            raise FieldlocError(f"--set {setting}: needs NAME=VALUE, for example odometry.rate_hz=100")
        scenario = _changed(scenario, read_toml(setting, f"--set {setting}"), f"--set {setting}")
    return scenario


def _parse(text: str, source: str) -> Scenario:
    values = dict(read_toml(text, source))
    base = values.pop("base", None)
    if base is None:
        return _changed(Scenario(), values, source)
    if base not in SCENARIOS or base == source:
        raise FieldlocError(
            f"{source}: base: needs the name of another scenario ({', '.join(SCENARIOS)}), got {base!r}"
        )
    return _changed(load_scenario(str(base)), values, source)


def _changed(section: Section, values: Mapping[str, object], source: str, prefix: str = "") -> Section:
    """The section (a dataclass) with the values that a table gives: each must be of the kind that stands there."""
    known = {item.name: getattr(section, item.name) for item in fields(section)}
    new: dict[str, object] = {}
    for key, value in values.items():
        where = f"{source}: {prefix}{key}"
        if key not in known:
            raise FieldlocError(f"{where}: unknown key; known here are {', '.join(known)}")
        if is_dataclass(known[key]):
            if not isinstance(value, Mapping):
                raise FieldlocError(f"{where}: needs a table [{prefix}{key}], got {value!r}")
            new[key] = _changed(known[key], value, source, f"{prefix}{key}.")
        else:
            new[key] = _like(known[key], value, where)
    try:
        return replace(section, **new)
    except ValueError as error:  # what only the section knows of its numbers
        raise FieldlocError(f"{source}: {prefix}{error}") from None


def _like(default: object, value: object, where: str) -> object:
    """The value as what the default is: a word, yes or no, a whole number, a number, or several numbers."""
    if isinstance(default, str | bool):
        if type(value) is type(default):
            return value
        raise FieldlocError(f"{where}: needs {'true or false' if isinstance(default, bool) else 'text'}, got {value!r}")
    if isinstance(default, tuple):
        if isinstance(value, list):
            return tuple(_like(0.0, item, where) for item in value)
        raise FieldlocError(f"{where}: needs a list of numbers, got {value!r}")
    whole = isinstance(default, int)
    if type(value) is int or (type(value) is float and not whole):
        try:
            return value if whole else float(value)
        except OverflowError:
            raise FieldlocError(f"{where}: is too large for a number") from None
    raise FieldlocError(f"{where}: needs a {'whole ' if whole else ''}number, got {value!r}")
