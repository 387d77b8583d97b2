"""A recording of any format, by what is in it rather than by its name."""

import re
from pathlib import Path

from fieldloc.errors import FieldlocError
from logs.reader.mcap_container import McapContainer
from logs.reader.records import MAGIC
from logs.source import Container

_BAG_MAGIC = b"#ROSBAG V"
_SQLITE_MAGIC = b"SQLite format 3\0"
_PART = re.compile(r"(.+?)(_\d+)?\.(mcap|db3)(\.zstd)?")


def open_container(path: str | Path) -> Container:
    """An MCAP file, a ROS 1 bag, or a ROS 2 bag (its .db3 file or its folder). FieldlocError for anything else."""
    path = Path(path)
    if path.is_dir():
        if _is_bag(path):
            return _open_bag(path)
        raise FieldlocError(f"{path}: is a directory; give an MCAP file, a bag or the folder of a ROS 2 bag")
    if path.name.endswith((".mcap.zstd", ".db3.zstd")):
        return _open_bag(path)
    magic = _first_bytes(path)
    if magic.startswith(MAGIC):
        return McapContainer(path)
    if magic.startswith((_BAG_MAGIC, _SQLITE_MAGIC)):
        return _open_bag(path)
    if not magic:
        raise FieldlocError(f"{path}: empty; give an MCAP file or a ROS bag")
    if MAGIC.startswith(magic):
        raise FieldlocError(f"{path}: cut off within its first {len(MAGIC)} bytes")
    raise FieldlocError(f"{path}: not an MCAP file (it does not begin with MCAP's magic number), nor a ROS bag")


def _is_bag(folder: Path) -> bool:
    """Whether it has rosbag2's index, or, of a recorder that was killed, the parts of one recording and of no other."""
    if (folder / "metadata.yaml").exists():
        return True
    parts = (_PART.fullmatch(file.name) for file in folder.iterdir())
    return len({part[1] for part in parts if part}) == 1


def _open_bag(path: Path) -> Container:
    from logs.ros.bags import open_bag  # not for those who read MCAP

    return open_bag(path)


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            if not file.seekable():
                raise FieldlocError(f"{path}: cannot be read: a pipe, save it to a file first")
            return file.read(16)
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise FieldlocError(f"{path}: cannot be opened: {error}") from None
