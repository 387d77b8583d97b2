"""The command line: the one room that sees every other, prints and exits. A file for each family of commands."""

import io
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from types import FrameType

from fieldloc.cli.parser import parse
from fieldloc.cli.terminal import fail
from fieldloc.errors import FieldlocError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it worked, 1 with one line on stderr when not, 130 after Ctrl-C and 143 after SIGTERM."""
    if arguments is None and not sys.warnoptions:
        warnings.simplefilter("ignore")  # what a person should know is in our own warnings
    if isinstance(sys.stdout, io.TextIOWrapper):  # a file's name may be what a terminal cannot show
        sys.stdout.reconfigure(errors="backslashreplace")
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        options = parse(sys.argv[1:] if arguments is None else arguments)
        options.command(options)
        print(end="", flush=True)
    except FieldlocError as error:
        return fail(str(error))
    except KeyboardInterrupt as interrupt:
        fail("interrupted; nothing unfinished was left behind")
        return 128 + int(interrupt.args[0] if interrupt.args else signal.SIGINT)
    except OSError as error:
        with suppress(OSError, ValueError):  # what is left to be written would fail once more when Python exits
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):  # the reader has seen enough
            return 1
        return fail(f"{error.filename or 'output'}: {error.strerror or error}")
    finally:
        signal.signal(signal.SIGTERM, before)
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)
