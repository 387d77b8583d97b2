"""How a command joins the command line, and the kinds of arguments that several commands take."""

import argparse
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn, TypeAlias

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray
from fieldloc.regions import REGIONS

RUNS = Path("runs")
"""Where results go unless told otherwise."""

Command = Callable[[argparse.Namespace], None]
Subparsers: TypeAlias = "argparse._SubParsersAction[Parser]"


class Parser(argparse.ArgumentParser):
    """A wrong command line is told as every other mistake."""

    def error(self, message: str) -> NoReturn:
        raise FieldlocError(f"{message}; see {self.prog} --help")


class Commands:
    """The commands so far. examples: one command line for each."""

    def __init__(self, subparsers: Subparsers) -> None:
        self._subparsers = subparsers
        self._common = Parser(add_help=False, argument_default=argparse.SUPPRESS)  # a default would hide an earlier one
        self._common.add_argument(
            "--quiet", action="store_true", help="no progress, no summary; warnings and errors only"
        )
        self.examples: dict[str, None] = {}

    def add(self, name: str, run: Command, what: str, example: str, to: "Subparsers | None" = None) -> Parser:
        """A command, or with `to` one below another command."""
        self.examples[f"fieldloc {example}"] = None
        sub = (to or self._subparsers).add_parser(
            name, help=what, description=f"{what}.", epilog=f"example: fieldloc {example}", parents=[self._common]
        )
        sub.set_defaults(command=run)
        return sub


def start(text: str) -> FloatArray | str:
    """X,Y,HEADING_DEG as (3,) in metres and radians, or the name of a region."""
    if text in REGIONS:
        return text
    with suppress(ValueError):
        x_m, y_m, heading_deg = (float(part) for part in text.split(","))
        pose = np.array([x_m, y_m, np.radians(heading_deg)])
        if np.isfinite(pose).all():
            return pose
    raise argparse.ArgumentTypeError(
        f"'{text}' is neither X,Y,HEADING_DEG in numbers, for example -2.5,0,90, nor one of {', '.join(REGIONS)}"
    )


def positive(text: str) -> float:
    with suppress(ValueError):
        if 0.0 < (value := float(text)) < np.inf:
            return value
    raise argparse.ArgumentTypeError(f"'{text}' is not a number above 0")


def seed(text: str) -> int:
    if text.isascii() and text.isdigit():
        return int(text)
    raise argparse.ArgumentTypeError(f"'{text}' is not a whole number, 0 or more")


def quality(text: str) -> int:
    if text.isascii() and text.isdigit() and 1 <= int(text) <= 100:
        return int(text)
    raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1 to 100")


def image_size(text: str) -> tuple[int, int]:
    """Width and height of WxH."""
    width, _, height = text.partition("x")
    if all(side.isascii() and side.isdigit() and 16 <= int(side) <= 10_000 for side in (width, height)):
        return int(width), int(height)
    raise argparse.ArgumentTypeError(f"'{text}' is not WIDTHxHEIGHT in pixels from 16 to 10000, for example 320x240")


def seconds_from_start(text: str) -> float:
    with suppress(ValueError):
        if 0.0 <= (value := float(text)) < np.inf:
            return value
    raise argparse.ArgumentTypeError(f"'{text}' is not a number of seconds, 0 or more")


def names(text: str) -> tuple[str, ...]:
    """A,B,... as its parts."""
    return tuple(part for part in text.split(",") if part)
