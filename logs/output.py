"""Where results may go, checked before the work that makes them begins."""

import os
from pathlib import Path

from fieldloc.errors import FieldlocError


def output_file(path: Path, source: Path) -> Path:
    """`path`; FieldlocError where it is the source itself or cannot be written. Missing folders are no obstacle."""
    try:
        if path.is_dir():
            raise FieldlocError(f"{path}: is a directory; give a file with -o")
        if path.exists() and source.exists() and path.samefile(source):
            raise FieldlocError(f"{path}: is what is read; give another file with -o")
        output_folder(path.parent)
    except OSError as error:
        raise FieldlocError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def output_folder(path: Path) -> Path:
    """`path`; FieldlocError where files cannot be written into it, or it cannot be made."""
    nearest = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise FieldlocError(f"{path}: cannot be written to: {nearest} is a file")
    if not os.access(nearest, os.W_OK):
        raise FieldlocError(f"{path}: cannot be written to: no permission for {nearest}")
    return path
