"""calibrate: what differs between robots, from a robot's own logs."""

import argparse
from pathlib import Path

from fieldloc.cli.commands import Commands
from fieldloc.cli.localize import add_estimation_options, settings
from fieldloc.cli.reading import add_meaning_options, add_part_options, open_log
from fieldloc.cli.terminal import bar, say, warn, warning_of


def add_commands(commands: Commands) -> None:
    """calibrate."""
    what, example = "What a robot's odometry and eyes get wrong, from its logs", "calibrate a.mcap b.mcap -o robot.toml"
    sub = commands.add("calibrate", _calibrate, what, example)
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="each is a recording of the same robot")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="ROBOT.toml", help="settings for --config of run, smooth and compare"
    )
    add_estimation_options(sub)
    add_part_options(sub)
    add_meaning_options(sub)


def _calibrate(options: argparse.Namespace) -> None:
    from logs.calibrating import calibrate, calibration_table, write_settings
    from logs.output import output_file

    config, field = settings(options)
    out = None if options.output is None else output_file(options.output, *options.logs)
    logs = [open_log(options, [path]) for path in options.logs]
    with warning_of(*logs), bar(options, "calibrate") as progress:
        done = calibrate(logs, config, field, options.start, progress)
    warn(done.warnings)
    print(calibration_table(done))
    if out is not None:
        write_settings(out, done, config)
        say(options, f"{out}: for --config of run, smooth and compare")
