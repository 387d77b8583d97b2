"""Files that appear whole or not at all, also after an error or Ctrl-C."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from fieldloc.errors import FieldlocError


def write_atomic(path: Path, data: bytes) -> None:
    """In a folder that is made if needed. FieldlocError where it cannot be written."""
    with _unfinished(path) as unfinished:
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(data)


@contextmanager
def atomic_text(path: Path) -> Iterator[TextIO]:
    """A UTF-8 file to write; it takes the place of `path` when the block ends well and vanishes when it does not.

    FieldlocError where the directory cannot be written.
    """
    with _unfinished(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="\n") as file:
        yield file


@contextmanager
def _unfinished(path: Path) -> Iterator[Path]:
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield unfinished
        unfinished.replace(path)
    except OSError as error:
        raise FieldlocError(f"cannot write {path}: {error.strerror}") from error
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def atomic_directory(directory: Path) -> Iterator[Path]:
    """An empty directory to fill; its files go to `directory` when the block ends well and vanish when it does not.

    `directory` is made if needed; other files in it stay. FieldlocError where it cannot be written.
    """
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", suffix=".part", dir=directory.parent))
        try:
            yield unfinished
            directory.mkdir(exist_ok=True)
            for file in sorted(unfinished.iterdir()):
                file.replace(directory / file.name)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise FieldlocError(f"cannot write to {directory}: {error.strerror}") from error
