"""Bags of ROS 1 and ROS 2 as containers: a file of either kind, or a folder as `ros2 bag record` makes it."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fieldloc.errors import FieldlocError
from logs.ros.bag_records import MAGIC as ROS1_MAGIC
from logs.ros.passing import PassingFolder
from logs.ros.ros1_bag import Ros1Bag
from logs.ros.sqlite_bag import SqliteBag
from logs.ros.zstd import inflated, unpack_file
from logs.source import Attachment, Container, RawMessage, Source

_SQLITE_MAGIC = b"SQLite format 3\0"
_PARTS = ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd", "*.bag")


def open_bag(path: Path) -> Container:
    """A ROS 1 bag, a rosbag2 database or a rosbag2 folder. FieldlocError where it is none or nothing of it can be read.

    What can be read of a damaged one is read; its `damage` says what is wrong.
    """
    return _folder(path) if path.is_dir() else _file(path)


def _file(path: Path) -> Container:
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as error:
        raise FieldlocError(f"{path}: cannot be read: {error.strerror or error}") from None
    if start.startswith(ROS1_MAGIC[:9]):
        return Ros1Bag(path)
    if start == _SQLITE_MAGIC:
        return SqliteBag(path)
    if path.name.endswith((".mcap.zstd", ".db3.zstd")):
        return _unpacked(path)
    from logs.reader.container import open_container

    return open_container(path)


def _unpacked(path: Path) -> Container:
    """Of a file that rosbag2 compressed as a whole; the unpacked one goes with the container."""
    folder = PassingFolder()
    file = folder.path / path.name.removesuffix(".zstd")
    unpack_file(path, file)
    return Bag(path, _file(file), keep=folder)


def _folder(path: Path) -> Container:
    text = _metadata_text(path)
    listed = [path / Path(name).name for name in _listed(text)]
    damage = [f"metadata.yaml lists {file.name}, which is not there" for file in listed if not file.exists()]
    files = [file for file in listed if file.exists()]
    if not files:
        files = sorted((file for pattern in _PARTS for file in path.glob(pattern)), key=_natural)
    if not files:
        raise FieldlocError(f"{path}: is a folder without a bag in it (no .mcap, .db3 or .bag)")
    parts: list[Container] = []
    problem: FieldlocError | None = None
    for file in files:
        try:
            parts.append(_file(file))
        except FieldlocError as error:
            problem = error
            damage.append(f"{file.name} cannot be read and is left out")
    if not parts and problem is not None:
        raise problem
    inflate = re.search(r"^\s*compression_mode:\s*[\"']?message", text, re.IGNORECASE | re.MULTILINE) is not None
    return Bag(path, _together(parts), tuple(damage), inflate)


def _together(parts: Sequence[Container]) -> Container:
    if len(parts) == 1:
        return parts[0]
    from logs.reader.merged import Merged

    return Merged(parts)


def _metadata_text(folder: Path) -> str:
    try:
        return (folder / "metadata.yaml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""  # the recorder was killed before it wrote it; the files say all that is needed


def _listed(text: str) -> list[str]:
    """The files that a metadata.yaml lists. It may be cut off, so that lines are looked at, not the whole document."""
    match = re.search(r"^\s*relative_file_paths:\s*\n((?:\s*-\s.*\n?)+)", text, re.MULTILINE)
    return [line.strip()[1:].strip().strip("\"'") for line in match[1].splitlines()] if match else []


def _natural(path: Path) -> list[tuple[int, str]]:
    """`bag_10` after `bag_9`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


@dataclass(frozen=True, slots=True)
class Bag:
    """A container by another name, with more to say about its damage; `inflate`: its messages are compressed."""

    path: Path
    inside: Container
    more_damage: tuple[str, ...] = ()
    inflate: bool = False
    keep: PassingFolder | None = None

    @property
    def sources(self) -> Mapping[int, Source]:
        return self.inside.sources

    @property
    def counts(self) -> Mapping[int, int]:
        return self.inside.counts

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self.inside.span_ns

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        return self.inside.metadata

    @property
    def damage(self) -> tuple[str, ...]:
        return self.more_damage + self.inside.damage

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        messages = self.inside.messages(channels, start_ns, end_ns)
        return (message._replace(data=inflated(message.data)) for message in messages) if self.inflate else messages

    def attachments(self) -> Iterator[Attachment]:
        return self.inside.attachments()
