"""What the logs of one robot say of the robot: solved one by one, put together, written as settings."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from estimators.calibrated import Quantity, RobotCalibration, calibrated
from estimators.config import Config
from estimators.smoother import Smoother
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.atomic import atomic_text
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.replay import load_recording, replay
from logs.table import NOTHING, Cell, Table
from logs.table_text import format_columns


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedRobot:
    """logs: names of those that it is from. warnings: what is wrong with them."""

    logs: tuple[str, ...]
    robot: RobotCalibration
    warnings: tuple[str, ...]


def calibrate(
    logs: Sequence[LogFile],
    config: Config,
    field: FieldMap | None = None,
    start: FloatArray | str | None = None,
    progress: Progress = unwatched,
) -> CalibratedRobot:
    """FieldlocError where a log cannot be localized in."""
    if not logs:
        raise ValueError("no logs to calibrate from")
    solutions, names, warnings = [], [], []
    for log in logs:
        recording = load_recording(log, field, progress)
        smoother = Smoother(config)
        done = replay(recording, smoother, start, config, progress)
        if smoother.solution is None:
            raise FieldlocError(f"{recording.name}: it says nothing of the robot: no start was found")
        solutions.append(smoother.solution)
        names.append(recording.name)
        warnings += [*recording.warnings, *done.warnings]
    return CalibratedRobot(tuple(names), calibrated(solutions, config), tuple(warnings))


def calibration_table(robot: RobotCalibration) -> str:
    """For the terminal; no newline at the end."""
    titles = ("quantity", "value", "sigma", "sigma before", "unit", "log-likelihood")
    rows = tuple(tuple(map(Cell, _row(quantity))) for quantity in robot.quantities)
    return format_columns(Table(tuple(("", title) for title in titles), rows)).lstrip("\n")


def write_settings(path: Path, done: CalibratedRobot, config: Config) -> None:
    """A TOML file that --config takes, with what was estimated beside its settings. It appears whole or not at all."""
    known = done.robot.settings(config)
    with atomic_text(path) as file:
        file.write(f"# What {', '.join(done.logs)} says of the robot; sigmas are a little wider than estimated, as a\n")
        file.write("# robot is not quite the same the next day.\n")
        for section, values in (("calibration", known.calibration), ("sensor", known.sensor)):
            file.write(f"\n[{section}]\n")
            for quantity in (one for one in done.robot.quantities if one.section == section):
                said = f"+- {quantity.sigma:.2g}" if quantity.told else "these logs say nothing of it"
                file.write(f"{quantity.name} = {getattr(values, quantity.name)!r}  # {quantity.unit}, {said}\n")
            for name in (item.name for item in fields(values) if "sigma" in item.name):
                file.write(f"{name} = {float(getattr(values, name))!r}\n")


def _row(quantity: Quantity) -> tuple[str, ...]:
    name = quantity.name
    for unit in ("_rad_per_m", "_radps", "_mps", "_rad", "_s"):
        name = name.removesuffix(unit)
    name, value, before = name.replace("_", " "), f"{quantity.value:+.4f}", f"{quantity.prior_sigma:.4f}"
    if not quantity.told:
        return name, value, "not told", before, quantity.unit, NOTHING
    return name, value, f"{quantity.sigma:.4f}", before, quantity.unit, f"{quantity.log_gain:+.1f}"
