"""rosbag2's SQLite files, all versions. They are opened as what never changes: nothing is written beside them."""

import shutil
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from fieldloc.errors import FieldlocError
from logs.ros.passing import PassingFolder
from logs.ros.standard import standard_text
from logs.ros.zstd import inflated
from logs.source import Attachment, RawMessage, Source

_BROKEN = (sqlite3.Error, UnicodeDecodeError)  # the latter where it cannot put into words what is broken
_UNFINISHED = ("-wal", "-journal")  # what SQLite has not yet put into the file itself
_FURTHEST = 1 << 20  # rows skipped at once behind a broken page
_LOST = b"\xf3lost in a cut\xf3!"  # 16 bytes for those that are missing; a page that begins so is no page
_IN_A_MESSAGE = _LOST[4:] + _LOST[:4]  # where a long message goes on in a missing page, behind a page number
_SMALLEST_PAGE = 512
_MOST_MISSING = 10  # times what is there; more than that, and it is the header that is broken


class SqliteBag:
    """A `logs.source.Container`. path: the file; shown: what to call it, where it is the copy of another."""

    def __init__(self, path: Path, shown: Path | None = None) -> None:
        self.path = shown or path
        self.metadata: Mapping[str, Mapping[str, str]] = {}
        self._damage: list[str] = []
        self._file = path
        try:
            missing = _missing_bytes(path)
            self._filled = missing > 0
            if missing > 0 or any(_size(path.with_name(path.name + end)) > 0 for end in _UNFINISHED):
                self._folder = PassingFolder()
                self._file = _mended(path, self._folder.path, missing)
            if missing > 0:
                self._note(f"the last {missing} bytes of the database are missing")
            with closing(self._connect()) as base:
                self.sources = _sources(base)
                self._rows: NDArray[np.int64] | None = None
                try:
                    self.counts, self.span_ns = _overview(base, self.sources)
                except _BROKEN:
                    self._salvage(base)
                if self._filled and self._rows is None:  # nothing that leads to a message, but what one goes on in
                    self._salvage(base)
        except (*_BROKEN, OSError) as error:
            raise FieldlocError(
                f"{self.path}: cannot be read as a rosbag2 database: {error}; "
                "`sqlite3 broken.db3 .recover | sqlite3 mended.db3` may save what is in it"
            ) from None

    @property
    def damage(self) -> tuple[str, ...]:
        """What was found when it was opened, and since then while reading."""
        return tuple(self._damage)

    def attachments(self) -> Iterator[Attachment]:
        return iter(())

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Log and publish time are the same: when the recorder received it."""
        start, end = min(max(start_ns or 0, 0), _ALWAYS), min(_ALWAYS if end_ns is None else end_ns, _ALWAYS)
        wanted = sorted(set(channels) & set(self.sources))
        done = (start, -1)
        with closing(self._connect()) as base:
            if self._rows is None:
                marks = ",".join("?" * len(wanted))
                query = (
                    "SELECT id, topic_id, timestamp, data FROM messages"
                    f" WHERE topic_id IN ({marks}) AND timestamp >= ? AND timestamp < ? ORDER BY timestamp, id"
                )
                try:
                    for row in base.execute(query, (*wanted, start, end)):
                        if (message := _message(row)) is not None:
                            if (message.log_time_ns, row[0]) <= done:
                                raise sqlite3.DatabaseError("its index leads astray")
                            yield message
                            done = message.log_time_ns, row[0]
                    return
                except _BROKEN:
                    self._salvage(base)
            yield from self._saved(base, wanted, done, end)

    def _saved(
        self, base: sqlite3.Connection, wanted: list[int], done: tuple[int, int], end: int
    ) -> Iterator[RawMessage]:
        """Row by row what is left of a broken table, from the message behind `done` (its time and row) on."""
        assert self._rows is not None
        lost = 0
        for time, row, channel in (each for some in _slices(self._rows) for each in some.tolist()):
            if (time, row) <= done or time >= end or channel not in wanted:
                continue
            try:
                query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id = ?"
                message = _message(base.execute(query, (row,)).fetchone())
            except _BROKEN:
                message = None
            right = message is not None and message.log_time_ns == time and message.channel == channel
            if message is None or not right or (self._filled and _IN_A_MESSAGE in message.data):
                lost += 1
            else:
                yield message
        if lost:
            self._note(f"{lost} messages are broken and left out")

    def _salvage(self, base: sqlite3.Connection) -> None:
        """Note the time, row and channel of each row that can be reached."""
        self._note("the database is broken; messages that it does not lead to any more are left out")
        self._rows = _reachable(base, self.sources)
        numbers, counts = np.unique(self._rows[:, 2], return_counts=True)
        self.counts = dict.fromkeys(self.sources, 0) | dict(zip(numbers.tolist(), counts.tolist(), strict=True))
        self.span_ns = (int(self._rows[0, 0]), int(self._rows[-1, 0])) if len(self._rows) else None

    def _note(self, sentence: str) -> None:
        if sentence not in self._damage:
            self._damage.append(sentence)

    def _connect(self) -> sqlite3.Connection:
        try:
            base = sqlite3.connect(f"file:{quote(str(self._file.absolute()))}?mode=ro&immutable=1", uri=True)
        except _BROKEN as error:
            raise FieldlocError(f"{self.path}: cannot be opened: {error}") from None
        base.text_factory = lambda text: text.decode(errors="replace")
        return base


_ALWAYS = 2**63 - 1


def _slices(rows: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """A few thousand at once, since they become Python's numbers."""
    return (rows[start : start + 4096] for start in range(0, len(rows), 4096))


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _missing_bytes(path: Path) -> int:
    """How much shorter the file is than its header says (sqlite.org/fileformat2.html, sections 1.3.2 and 1.3.8)."""
    with path.open("rb") as file:
        head = file.read(100)
    page = int.from_bytes(head[16:18], "big")
    said = int.from_bytes(head[28:32], "big") if head[24:28] == head[92:96] else 0
    missing = said * (65536 if page == 1 else page) - _size(path)
    return missing if missing < _MOST_MISSING * _size(path) else 0


def _mended(path: Path, folder: Path, missing: int) -> Path:
    """A copy of its full length, to which SQLite adds what a killed recorder left beside the file.

    SQLite reads nothing of a file that is too short, but what is whole of one with pages that are none.
    """
    for name in (path.name, *(path.name + end for end in _UNFINISHED)):
        if path.with_name(name).exists():
            shutil.copyfile(path.with_name(name), folder / name)
    copy = folder / path.name
    if missing > 0:
        with copy.open("r+b") as file:
            there = _size(copy)
            whole = there - there % _SMALLEST_PAGE
            file.truncate(whole)
            file.seek(whole)
            for _ in range((there + missing - whole) // _SMALLEST_PAGE):
                file.write(_LOST * (_SMALLEST_PAGE // len(_LOST)))
    with closing(sqlite3.connect(copy)) as base, suppress(*_BROKEN):
        base.execute("PRAGMA journal_mode=DELETE").fetchall()
    return copy


def _columns(base: sqlite3.Connection, table: str) -> set[str]:
    return {str(row[1]) for row in base.execute(f"PRAGMA table_info({table})")}


def _sources(base: sqlite3.Connection) -> Mapping[int, Source]:
    columns = _columns(base, "topics")
    if not {"id", "name", "type"} <= columns or not {"id", "topic_id", "timestamp", "data"} <= _columns(
        base, "messages"
    ):
        raise sqlite3.DatabaseError("it has no tables of topics and messages")
    defined: dict[str, tuple[str, bytes]] = {}
    if _columns(base, "message_definitions") >= {"topic_type", "encoding", "encoded_message_definition"}:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
        for name, encoding, text in base.execute(query):
            if encoding in ("ros2msg", "ros2idl") and isinstance(text, str):
                defined.setdefault(str(name), (encoding, text.encode()))
    optional = ("serialization_format", "offered_qos_profiles", "type_description_hash")
    extra = [name if name in columns else "''" for name in optional]
    sources = {}
    for number, topic, name, encoding, qos, digest in base.execute(
        f"SELECT id, name, type, {', '.join(extra)} FROM topics"
    ):
        schema_encoding, text = defined.get(str(name)) or standard_text(str(name))
        said = {"offered_qos_profiles": str(qos)} | ({"topic_type_hash": str(digest)} if digest else {})
        sources[int(number)] = Source(str(topic), str(encoding) or "cdr", str(name), schema_encoding, text, said)
    return sources


def _overview(base: sqlite3.Connection, sources: Mapping[int, Source]) -> tuple[dict[int, int], tuple[int, int] | None]:
    query = (
        "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp),"
        " SUM(typeof(timestamp) != 'integer' OR timestamp < 0) FROM messages GROUP BY topic_id"
    )
    rows = [row for row in base.execute(query) if row[0] in sources]
    if any(row[4] for row in rows):
        raise sqlite3.DatabaseError("some times are no times")
    counts = dict.fromkeys(sources, 0) | {row[0]: row[1] for row in rows}
    return counts, (min(row[2] for row in rows), max(row[3] for row in rows)) if rows else None


def _reachable(base: sqlite3.Connection, sources: Mapping[int, Source]) -> NDArray[np.int64]:
    """(n, 3) time, row and channel of all rows that can be walked to, by time; broken stretches are stepped over."""
    found: list[tuple[int, int, int]] = []
    last, step = -1, 0
    while step <= _FURTHEST:
        try:
            query = "SELECT id, topic_id, timestamp FROM messages WHERE id > ? ORDER BY id"
            for row, channel, time in base.execute(query, (last + step,)):
                if not isinstance(row, int) or row <= last:
                    raise sqlite3.DatabaseError("rows out of order")
                last, step = row, 0
                if channel in sources and isinstance(time, int) and time >= 0:
                    found.append((time, row, channel))
            break
        except _BROKEN:
            step = max(2 * step, 1)
    return np.array(sorted(found), np.int64).reshape(-1, 3)


def _message(row: tuple[object, ...] | None) -> RawMessage | None:
    """None where a broken page left something that is no message."""
    match row:
        case (int(), int() as channel, int() as time, bytes() as data) if time >= 0:
            return RawMessage(channel, time, time, 0, inflated(data))
    return None
