"""Where results may go, checked before the work that makes them begins."""

import os
from pathlib import Path

from fieldloc.errors import FieldlocError


def output_file(path: Path, *sources: Path) -> Path:
    """`path`; FieldlocError where it is a source itself or cannot be written. Missing folders are no obstacle."""
    try:
        if path.is_dir():
            raise FieldlocError(f"{path}: is a directory; give a file with -o")
        if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
            raise FieldlocError(f"{path}: is what is read; give another file with -o")
    except OSError as error:
        raise FieldlocError(f"{path}: cannot be written: {error.strerror}") from None
    _check_folder(path.parent, path)
    return path


def output_folder(path: Path) -> Path:
    """`path`; FieldlocError where files cannot be written into it, or it cannot be made."""
    _check_folder(path, path)
    return path


def _check_folder(folder: Path, path: Path) -> None:
    nearest = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise FieldlocError(f"{path}: cannot be written: {nearest} is a file")
    if not os.access(nearest, os.W_OK):
        raise FieldlocError(f"{path}: cannot be written: no permission for {nearest}")
