"""A data set's text files, wherever they lie: in a folder, in a folder inside it, in a .tar.gz or a .zip."""

import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from fieldloc.errors import FieldlocError

_UNREADABLE = (OSError, EOFError, zlib.error, tarfile.TarError, zipfile.BadZipFile, NotImplementedError, RuntimeError)


@dataclass(frozen=True, slots=True)
class Row:
    """A line's words, and where it stands, for messages about it."""

    words: tuple[str, ...]
    where: str

    def refuse(self, problem: str) -> FieldlocError:
        return FieldlocError(f"{self.where}: {problem}")

    def number(self, column: int) -> float:
        """FieldlocError for what is not a finite number."""
        try:
            value = float(self.words[column])
        except ValueError:
            value = float("nan")
        if abs(value) < float("inf"):
            return value
        raise self.refuse(f"'{self.words[column]}' is not a number")

    def integer(self, column: int) -> int:
        try:
            return int(self.words[column])
        except ValueError:
            raise self.refuse(f"'{self.words[column]}' is not a whole number") from None


class DataFolder:
    """The folder that holds the file `landmark`, somewhere under `path`; FieldlocError unless there is exactly one."""

    def __init__(self, path: Path, landmark: str) -> None:
        self.path = path
        files = _inventory(path)
        homes = sorted({name.parent for name in files if name.name == landmark})
        if not homes:
            raise FieldlocError(f"{path}: not the data set: there is no {landmark} in it")
        if len(homes) > 1:
            raise FieldlocError(f"{path}: holds several data sets; give one of them: {', '.join(map(str, homes))}")
        self._files = {name.name: read for name, read in files.items() if name.parent == homes[0]}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(self._files))

    def rows(self, name: str, columns: int) -> Iterator[Row]:
        """Lines that are neither empty nor comments (#), split at blanks; FieldlocError for another number of words."""
        where = f"{self.path}: {name}"
        if name not in self._files:
            raise FieldlocError(f"{where} is missing")
        try:
            text = self._files[name]().decode("utf-8", errors="replace")
        except _UNREADABLE as error:
            raise FieldlocError(f"{where} cannot be read: {error}") from None
        for number, line in enumerate(text.splitlines(), 1):
            words = tuple(line.partition("#")[0].split())
            row = Row(words, f"{where} line {number}")
            if words and len(words) != columns:
                raise row.refuse(f"{len(words)} columns where {columns} are needed")
            if words:
                yield row


def _inventory(path: Path) -> dict[PurePosixPath, Callable[[], bytes]]:
    """Everything under a folder or in an archive, with the function that reads it."""
    try:
        if path.is_dir():
            return {
                PurePosixPath(file.relative_to(path)): file.read_bytes for file in path.rglob("*") if file.is_file()
            }
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                return {PurePosixPath(name): partial(_from_zip, path, name) for name in archive.namelist()}
        if tarfile.is_tarfile(path):
            with tarfile.open(path) as archive:
                return {PurePosixPath(m.name): partial(_from_tar, path, m) for m in archive if m.isfile()}
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such file or folder") from None
    except _UNREADABLE as error:
        raise FieldlocError(f"{path}: cannot be read: {error}") from None
    raise FieldlocError(f"{path}: neither a folder nor a .tar.gz nor a .zip")


def _from_zip(path: Path, name: str) -> bytes:
    with zipfile.ZipFile(path) as archive:
        return archive.read(name)


def _from_tar(path: Path, member: tarfile.TarInfo) -> bytes:
    with tarfile.open(path) as archive:
        file = archive.extractfile(member)
        return b"" if file is None else file.read()
