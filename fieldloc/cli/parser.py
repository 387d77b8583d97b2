"""From arguments to the options of one command."""

import argparse
from collections.abc import Sequence
from importlib.metadata import version

from fieldloc.cli import (
    calibrating,
    camera,
    detecting,
    editing,
    localize,
    locating,
    recordings,
    rendering,
    results,
    viewing,
)
from fieldloc.cli.commands import Commands, Parser


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options; `options.command(options)` runs them. FieldlocError for a wrong command line."""
    return _parser().parse_args(_with_minus(arguments))


def _parser() -> Parser:
    parser = Parser(
        prog="fieldloc",
        description="Where a soccer robot stands: from its log to trajectories with covariances, compared and drawn.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=version("fieldloc"))
    parser.set_defaults(quiet=False)
    commands = Commands(parser.add_subparsers(metavar="COMMAND", required=True))
    localizing = (localize, locating, calibrating, camera)
    for family in (recordings, rendering, detecting, *localizing, results, viewing, editing):
        family.add_commands(commands)
    parser.epilog = "\n  ".join(["examples:", *commands.examples])
    return parser


def _with_minus(arguments: Sequence[str]) -> list[str]:
    """`--start -2,0,90` as `--start=-2,0,90`: argparse takes what begins with a minus for an option."""
    out: list[str] = []
    for argument in arguments:
        if out and out[-1] in ("--start", "--pose"):
            out[-1] += f"={argument}"
        else:
            out.append(argument)
    return out
