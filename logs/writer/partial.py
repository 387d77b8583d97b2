"""A file that takes its name when it is whole: the same for every kind of log."""

import contextlib
import os
import secrets
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import IO

from fieldloc.errors import FieldlocError


@contextlib.contextmanager
def partial_file(path: Path) -> Iterator[IO[bytes]]:
    """A hidden file beside `path`, its name ending in `.partial`; it takes the place of `path` if the block ends well.

    It is removed when the block ends by an exception, Ctrl-C or SIGTERM; SIGKILL leaves it. `path` has no symbolic
    link in it. OSError where it cannot be written, FieldlocError where it is a directory.
    """
    if path.is_dir():
        raise FieldlocError(f"{path}: is a directory; give a file to write")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    with sigterm_as_exit():
        try:
            with partial.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def sigterm_as_exit() -> Iterator[None]:
    """While inside, SIGTERM unwinds the program as Ctrl-C does, unless someone else already handles it."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
