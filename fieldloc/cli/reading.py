"""How the commands open logs: which part of them, and which topic means what."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from fieldloc.cli.commands import Parser, seconds_from_start
from fieldloc.errors import FieldlocError
from logs.reader import LogFile


def add_meaning_options(sub: Parser) -> None:
    """What the topics mean, where it is not what fieldloc would guess."""
    sub.add_argument(
        "--role",
        action="append",
        default=[],
        metavar="ROLE=TOPIC",
        help="what a topic is to fieldloc, instead of the guess that 'fieldloc info' shows; may be repeated",
    )
    sub.add_argument("--mapping", type=Path, metavar="FILE.toml", help="roles, frames and noise of other people's logs")


def add_part_options(sub: Parser) -> None:
    """Which part of the log."""
    after = "seconds after the log's first message"
    sub.add_argument("--from", dest="from_s", type=seconds_from_start, metavar="S", help=f"leave out before: {after}")
    sub.add_argument(
        "--to", dest="to_s", type=seconds_from_start, metavar="S", help=f"leave out from there on: {after}"
    )


def open_log(options: argparse.Namespace, paths: Sequence[Path]) -> LogFile:
    """One log, or several read as one, as the options of `add_meaning_options` and `add_part_options` say."""
    from logs.foreign.mapping import LogMapping, load_mapping, with_roles

    mapping = load_mapping(options.mapping) if options.mapping else LogMapping()
    return LogFile(paths, with_roles(mapping, options.role), *part(options))


def part(options: argparse.Namespace) -> tuple[float | None, float | None]:
    """From and to, in seconds; None where there is no such limit."""
    from_s, to_s = getattr(options, "from_s", None), getattr(options, "to_s", None)
    if from_s is not None and to_s is not None and to_s <= from_s:
        raise FieldlocError(f"--to {to_s:g}: needs to be more than --from {from_s:g}")
    return from_s, to_s
