"""detect: posts and lines of a log's pictures."""

import argparse
from pathlib import Path

from fieldloc.cli.commands import Commands
from fieldloc.cli.editing import tell
from fieldloc.cli.reading import add_meaning_options, add_part_options, open_log
from fieldloc.cli.terminal import bar, warning_of
from fieldloc.field import load_field


def add_commands(commands: Commands) -> None:
    """detect."""
    what, example = "A log with posts and lines of its pictures beside them", "detect match.mcap -o seen.mcap"
    sub = commands.add("detect", _detect, what, example)
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="several are read as one")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="default: LOG-seen.mcap")
    sub.add_argument("--field", metavar="NAME|FILE", help="a map by name or TOML file instead of the log's own")
    add_part_options(sub)
    add_meaning_options(sub)


def _detect(options: argparse.Namespace) -> None:
    from logs.edit.seen import with_features
    from logs.output import output_file

    first = options.logs[0]
    out = output_file(options.output or first.with_name(f"{first.stem}-seen.mcap"), *options.logs)
    log = open_log(options, options.logs)
    with warning_of(log), bar(options, "detecting") as progress:
        done = with_features(log, out, load_field(options.field) if options.field else None, progress)
    tell(options, done)
