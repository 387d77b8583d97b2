"""The configuration tree from a TOML file and from single settings: [motion] forward_m_per_sqrt_m = 0.1."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TypeVar

from estimators.config import (
    ENGINES,
    Calibration,
    Compass,
    Config,
    Graph,
    Mixture,
    MotionNoise,
    Particles,
    Robust,
    Sensor,
)
from estimators.motion import OdometryCalibration
from estimators.sensor import SensorCalibration
from fieldloc.detection import Detection
from fieldloc.errors import FieldlocError
from fieldloc.mount_correction import PARTS, MountCorrection
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_distortion import DistortionPrior, ScanDistortion
from fieldloc.scan_noise import NoisePrior
from fieldloc.toml_table import TomlTable

_ABOVE_ZERO = (
    "nis_per_dof",
    "restart_after",
    "count",
    "max_count",
    "kld_error",
    "bin_m",
    "bin_rad",
    "cauchy",
    "max_hypotheses",
    "offset_s",
    "own",
)
_QUOTES = "'\""
_WORDS = {"engine": ENGINES}
_SIGNED = (*OdometryCalibration._fields, *SensorCalibration._fields, *ScanDistortion._fields, *PARTS)
_BELOW_ONE = ("outlier_share", "prune_below", "negligible", "post", "clutter", "nothing_right")

Section = TypeVar(
    "Section",
    MotionNoise,
    Robust,
    Mixture,
    Particles,
    Graph,
    Calibration,
    Sensor,
    MountCorrection,
    ErrorCorrelation,
    Detection,
    NoisePrior,
    DistortionPrior,
    Compass,
)


def load_config(path: Path) -> Config:
    """The defaults with what the file changes; FieldlocError names the file and the key for every mistake."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FieldlocError(f"{path}: cannot be read as a configuration: {error}") from None
    return _with_table(Config(), TomlTable.parse(text, str(path)))


def with_settings(config: Config, settings: Sequence[str]) -> Config:
    """The configuration with settings like "motion.forward_m_per_sqrt_m=0.1", the last of equal ones winning."""
    for setting in settings:
        name, _, value = setting.partition("=")
        section, _, key = name.partition(".")
        if not (section and key and value):
            raise FieldlocError(f"--set {setting}: needs SECTION.NAME=NUMBER, for example particles.count=2000")
        if key in _WORDS:
            value = f'"{value.strip(_QUOTES)}"'
        config = _with_table(config, TomlTable.parse(f"[{section}]\n{key} = {value}", f"--set {setting}"))
    return config


def _with_table(config: Config, table: TomlTable) -> Config:
    sections = {item.name: _section(getattr(config, item.name), table, item.name) for item in fields(config)}
    changed = replace(config, **sections)
    table.finish()
    return changed


def _section(section: Section, whole: TomlTable, name: str) -> Section:
    if not whole.has(name):
        return section
    table = whole.table(name)
    values: dict[str, float | str] = {}
    for item in fields(section):
        default = getattr(section, item.name)
        if item.name in _WORDS:
            values[item.name] = _word(table, item.name, default)
            continue
        if item.name in _SIGNED:
            value = table.signed(item.name, float(default))
        else:
            value = table.number(item.name, float(default), positive=item.name in _ABOVE_ZERO)
        if item.name in _BELOW_ONE and value >= 1.0:
            table.fail(item.name, f"needs a share below 1, got {value}")
        if isinstance(default, int):
            if not value.is_integer():
                table.fail(item.name, f"needs a whole number, got {value}")
            value = int(value)
        values[item.name] = value
    table.finish()
    return type(section)(**values)  # type: ignore[arg-type]  # whole numbers went through the check above


def _word(table: TomlTable, key: str, default: str) -> str:
    if not table.has(key):
        return default
    word = table.string(key)
    if word not in _WORDS[key]:
        table.fail(key, f"needs one of {', '.join(_WORDS[key])}, got '{word}'")
    return word
