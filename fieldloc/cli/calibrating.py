"""calibrate: what differs between robots, from a robot's own logs."""

import argparse
from pathlib import Path

from fieldloc.cli.commands import Commands, positive
from fieldloc.cli.localize import add_estimation_options, settings
from fieldloc.cli.reading import add_meaning_options, add_part_options, open_log
from fieldloc.cli.terminal import bar, say, warn, warning_of
from fieldloc.errors import FieldlocError

_SIGMA_M = 0.05


def add_commands(commands: Commands) -> None:
    """calibrate."""
    what, example = "What a robot's odometry and eyes get wrong, from its logs", "calibrate a.mcap b.mcap -o robot.toml"
    sub = commands.add("calibrate", _calibrate, what, example)
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="each is a recording of the same robot")
    sub.add_argument(
        "-o", "--output", type=Path, metavar="ROBOT.toml", help="settings for --config of run, smooth and compare"
    )
    sub.add_argument("--landmarks", action="store_true", help="find out, too, where the landmarks really are")
    sub.add_argument(
        "--landmark-sigma-m",
        type=positive,
        metavar="S",
        help=f"standard deviation of where the map has them, for those that it takes as exact (default: {_SIGMA_M})",
    )
    sub.add_argument("--field-output", type=Path, metavar="MAP.toml", help="the map with them, for --field")
    add_estimation_options(sub)
    add_part_options(sub)
    add_meaning_options(sub)


def _calibrate(options: argparse.Namespace) -> None:
    from logs.calibrating import calibrate, calibration_table, write_settings
    from logs.output import output_file
    from logs.surveying import landmark_table, write_map

    if not options.landmarks and (options.landmark_sigma_m is not None or options.field_output is not None):
        raise FieldlocError("--landmark-sigma-m and --field-output are about landmarks: ask for them with --landmarks")
    config, field = settings(options)
    sources = [*options.logs, *([Path(options.field)] if options.field else [])]
    out, map_out = (
        None if path is None else output_file(path, *sources) for path in (options.output, options.field_output)
    )
    sigma_m = (options.landmark_sigma_m or _SIGMA_M) if options.landmarks else None
    logs = [open_log(options, [path]) for path in options.logs]
    with warning_of(*logs), bar(options, "calibrate") as progress:
        done = calibrate(logs, config, field, options.start, progress, sigma_m)
    warn(done.warnings)
    print(calibration_table(done))
    if done.landmarks is not None:
        print(f"\n{landmark_table(done.landmarks)}")
        if map_out is not None:
            write_map(map_out, done.landmarks, done.logs)
            say(options, f"{map_out}: for --field")
    if out is not None:
        write_settings(out, done, config)
        say(options, f"{out}: for --config of run, smooth and compare")
