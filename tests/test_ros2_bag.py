"""rosbag2's databases and folders, whole and broken."""

import contextlib
import os
import random
import shutil
import sqlite3
from pathlib import Path

import pytest
import ros_bags
import ros_messages
import zstandard
from rosbags.rosbag2 import Reader

from fieldloc.errors import FieldlocError
from logs import ros
from logs.foreign.parts import OdometryPart
from logs.reader.container import open_container
from logs.ros.bags import open_bag

MESSAGES = ros_bags.contents(90)
ORDERED = ros_bags.in_time_order(MESSAGES)
MCAPS = Path(__file__).parents[2] / "shared" / "data" / "mcap"
WBAG = [MCAPS / f"rosbag2_py__test__resources__mcap__wbag__wbag_{part}.mcap" for part in (0, 1)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ros_bags.write_ros2(tmp_path_factory.mktemp("ros2") / "walk", MESSAGES)


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "walk"))


def database(folder: Path) -> Path:
    (file,) = folder.glob("*.db3")
    return file


def fingerprint(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.iterdir()}


def is_in_order(some: list[ros_bags.Logged], everything: list[ros_bags.Logged]) -> bool:
    """Whether these are some of all messages, in their order."""
    rest = iter(everything)
    return all(message in rest for message in some)


@pytest.mark.parametrize("as_folder", [True, False])
def test_all_messages_come_in_the_order_of_time(folder: Path, as_folder: bool) -> None:
    bag = open_container(folder if as_folder else database(folder))
    assert ros_bags.read(bag) == ORDERED
    assert bag.damage == ()
    assert sorted(bag.counts.values()) == [30, 30, 30]
    assert bag.span_ns == (ORDERED[0][1], ORDERED[-1][1])
    assert bag.path == (folder if as_folder else database(folder))
    assert list(bag.attachments()) == []


@pytest.mark.parametrize("compression", ["", "FILE", "MESSAGE"])
@pytest.mark.parametrize("mcap", [True, False])
def test_a_folder_is_read_whatever_rosbag2_did_to_its_files(tmp_path: Path, mcap: bool, compression: str) -> None:
    if mcap and compression == "FILE":  # which rosbags does not write
        folder = ros_bags.write_ros2(tmp_path / "walk", MESSAGES, mcap)
        file, description = folder / "walk.mcap", folder / "metadata.yaml"
        file.with_name("walk.mcap.zstd").write_bytes(zstandard.compress(file.read_bytes()))
        file.unlink()
        description.write_text(description.read_text().replace("walk.mcap", "walk.mcap.zstd"))
    else:
        folder = ros_bags.write_ros2(tmp_path / "walk", MESSAGES, mcap, compression)
    before = fingerprint(folder)
    bag = open_container(folder)
    assert ros_bags.read(bag) == ORDERED
    assert sorted(bag.counts.values()) == [30, 30, 30]
    assert fingerprint(folder) == before


@pytest.mark.parametrize("mcap", [True, False])
def test_a_compressed_file_that_is_cut_off_or_broken_is_read_up_to_there(tmp_path: Path, mcap: bool) -> None:
    folder = ros_bags.write_ros2(tmp_path / "walk", MESSAGES, mcap)
    (file,) = folder.glob("walk.*")
    packed = zstandard.ZstdCompressor(level=1).compress(file.read_bytes() + os.urandom(300_000))
    (folder / "metadata.yaml").unlink()
    signed = zstandard.ZstdCompressor(write_checksum=True).compress(file.read_bytes() + os.urandom(300_000))
    file.unlink()
    for broken in (packed[: len(packed) - 200_000], signed[:-1] + bytes([signed[-1] ^ 1])):
        file.with_name(file.name + ".zstd").write_bytes(broken)
        assert ros_bags.read(open_bag(folder)) == ORDERED
    file.with_name(file.name + ".zstd").write_bytes(b"no zstd" * 9)
    with pytest.raises(FieldlocError, match="not compressed by zstd"):
        open_bag(folder)


def test_topics_and_times_are_selected(folder: Path) -> None:
    bag = open_container(folder)
    times = [None, -5, 0, ORDERED[0][1], ORDERED[30][1], ORDERED[60][1] + 1, 2**63, 2**70]
    for start in times:
        for end in times:
            expected = [
                message
                for message in ORDERED
                if (start is None or message[1] >= start) and (end is None or message[1] < end)
            ]
            assert ros_bags.read(bag, start, end) == expected
            only = [message for message in expected if message[0] != "/imu"]
            assert ros_bags.read(bag, start, end, "/odometry", "/tfmessage") == only
    assert list(bag.messages([])) == list(bag.messages([99])) == []


def test_what_a_channel_says_is_enough_to_decode_it(folder: Path) -> None:
    bag = open_bag(folder)
    number = next(number for number, source in bag.sources.items() if source.topic == "/odometry")
    source = bag.sources[number]
    assert (source.message_encoding, source.schema_encoding) == ("cdr", "ros2msg")
    assert source.schema_name == "nav_msgs/msg/Odometry"
    assert source.schema_data == ros_messages.source("nav_msgs/msg/Odometry").schema_data
    assert source.metadata["topic_type_hash"].startswith("RIHS01_")
    decode = ros.decoder(source)
    assert decode is not None
    assert all(isinstance(decode(message.data), OdometryPart) for message in bag.messages([number]))


def old_database(path: Path, version: int) -> Path:
    """As rosbag2 wrote them up to Foxy (1: topics without quality of service) and Galactic (2), without definitions."""
    with contextlib.closing(sqlite3.connect(path)) as base, base:
        qos = ", offered_qos_profiles TEXT NOT NULL" if version == 2 else ""
        base.execute(
            f"CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT{qos})"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER NOT NULL, data BLOB)"
        )
        names = {ros_bags.topic(name): (number, name) for number, name in enumerate([*ros_bags.TYPES, "my/msg/Own"], 3)}
        for topic, (number, name) in names.items():
            values = (number, topic, name, "cdr", *(["- history: 3"] if version == 2 else []))
            base.execute(f"INSERT INTO topics VALUES({','.join('?' * len(values))})", values)
        rows = [(names[topic][0], time, data) for topic, time, data in MESSAGES]
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_old_databases_lack_definitions_which_standard_types_do_not_need(tmp_path: Path, version: int) -> None:
    bag = open_bag(old_database(tmp_path / "old.db3", version))
    assert ros_bags.read(bag) == ORDERED
    sources = {source.topic: source for source in bag.sources.values()}
    assert sources["/odometry"].schema_data == ros_messages.source("nav_msgs/msg/Odometry").schema_data
    assert (sources["/own"].schema_encoding, sources["/own"].schema_data) == ("", b"")
    assert sources["/odometry"].metadata["offered_qos_profiles"] == ("- history: 3" if version == 2 else "")
    assert bag.counts[next(number for number, source in bag.sources.items() if source.topic == "/own")] == 0


def test_nothing_is_written_beside_a_database(folder: Path) -> None:
    before = fingerprint(folder)
    os.chmod(folder, 0o555)
    try:
        assert len(ros_bags.read(open_bag(folder))) == len(MESSAGES)
    finally:
        os.chmod(folder, 0o755)
    assert fingerprint(folder) == before


def test_a_database_with_a_log_of_its_own_gets_no_company_while_it_is_read(tmp_path: Path) -> None:
    """SQLite would put two files beside it, though it only reads."""
    path = old_database(tmp_path / "logged.db3", 2)
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute("PRAGMA journal_mode=WAL")
    assert [file.name for file in tmp_path.iterdir()] == ["logged.db3"]
    messages = open_bag(path).messages([3])
    next(messages)
    assert [file.name for file in tmp_path.iterdir()] == ["logged.db3"]


def test_what_a_killed_recorder_left_beside_its_database_is_read_too(tmp_path: Path) -> None:
    """SQLite keeps new rows in a log of its own until it is closed; reading them takes a copy, not the original."""
    live = tmp_path / "live.db3"
    old_database(live, 2)
    base = sqlite3.connect(live)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("DELETE FROM messages WHERE id > 50")
    base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(3, 7, x'0102')")
    base.commit()
    dead = tmp_path / "dead"
    dead.mkdir()
    for file in (live, live.with_name("live.db3-wal")):
        shutil.copyfile(file, dead / file.name)
    base.close()
    before = fingerprint(dead)
    assert "live.db3-wal" in before
    bag = open_bag(dead / "live.db3")
    expected = ros_bags.in_time_order([(ros_bags.topic(ros_bags.TYPES[0]), 7, b"\1\2"), *MESSAGES[:50]])
    assert ros_bags.read(bag) == expected
    assert bag.damage == ()
    assert fingerprint(dead) == before


def test_a_folder_without_its_description_is_read_all_the_same(folder: Path) -> None:
    (folder / "metadata.yaml").unlink()
    assert ros_bags.read(open_bag(folder)) == ORDERED


@pytest.mark.parametrize("mcap", [True, False])
def test_a_split_recording_is_one(tmp_path: Path, mcap: bool) -> None:
    parts = [
        ros_bags.write_ros2(tmp_path / f"part{n}", ros_bags.contents(30, start=30 * n), mcap=mcap) for n in range(3)
    ]
    together = tmp_path / "together"
    together.mkdir()
    suffix = "mcap" if mcap else "db3"
    names = []
    for number, part in enumerate(parts):
        (file,) = part.glob(f"*.{suffix}")
        names.append(f"walk_{number}.{suffix}")
        shutil.copyfile(file, together / names[-1])
    listed = "".join(f"    - {name}\n" for name in names)
    (together / "metadata.yaml").write_text(
        f'rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{listed}  compression_mode: ""\n'
    )
    expected = ros_bags.in_time_order([message for n in range(3) for message in ros_bags.contents(30, start=30 * n)])
    bag = open_container(together)
    assert ros_bags.read(bag) == expected
    assert sorted(bag.counts.values()) == [30, 30, 30]
    assert bag.path == together
    (together / names[1]).unlink()
    bag = open_container(together)
    rest = ros_bags.in_time_order([message for n in (0, 2) for message in ros_bags.contents(30, start=30 * n)])
    assert ros_bags.read(bag) == rest
    assert bag.damage == (f"metadata.yaml lists {names[1]}, which is not there",)
    (together / names[1]).write_bytes(b"no bag at all")
    bag = open_container(together)
    assert ros_bags.read(bag) == rest
    assert bag.damage == (f"{names[1]} cannot be read and is left out",)


def test_a_folder_with_no_readable_part_says_why(folder: Path) -> None:
    database(folder).write_bytes(b"SQLite format 3\0" + bytes(4000))
    with pytest.raises(FieldlocError, match=r"walk\.db3: cannot be read as a rosbag2 database"):
        open_bag(folder)
    database(folder).unlink()
    with pytest.raises(FieldlocError, match="without a bag"):
        open_bag(folder)


def test_another_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.db3"
    with contextlib.closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT)")
    with pytest.raises(FieldlocError, match=r"other\.db3.*no tables of topics and messages"):
        open_bag(path)


def test_a_database_that_is_cut_off_gives_what_can_be_reached(folder: Path) -> None:
    """Never a message that is partly lost: long ones go on in pages of their own."""
    file = database(folder)
    with contextlib.closing(sqlite3.connect(file)) as base, base:
        long = [("/odometry", 2_000_000_000 + n, bytes([n]) * 20_000) for n in range(8)]
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", [row[1:] for row in long])
    everything = ORDERED + long
    data = file.read_bytes()
    most = 0
    for length in [*range(0, len(data), 1500), len(data) - 1]:
        file.write_bytes(data[:length])
        try:
            bag = open_bag(file)
        except FieldlocError:
            assert length < 7 * 4096  # the pages that say what the topics are
            continue
        found = ros_bags.read(bag)
        assert is_in_order(found, everything)
        assert bag.damage[0] == f"the last {len(data) - length} bytes of the database are missing"
        lost = sum(int(sentence.split()[0]) for sentence in bag.damage if "are broken and left out" in sentence)
        assert sum(bag.counts.values()) == len(found) + lost
        most = len(found)
    assert most == len(everything) - 1


def test_a_broken_page_costs_only_what_was_on_it(folder: Path) -> None:
    file = database(folder)
    data = bytearray(file.read_bytes())
    page = data.index(MESSAGES[45][2]) // 4096 * 4096
    data[page : page + 4096] = b"\xee" * 4096
    file.write_bytes(data)
    bag = open_bag(file)
    found = ros_bags.read(bag)
    assert is_in_order(found, ORDERED)
    assert 70 < len(found) < 90
    assert bag.damage != ()
    first = found[10][1]
    assert ros_bags.read(bag, first, None, "/imu") == [
        message for message in found if message[1] >= first and message[0] == "/imu"
    ]


def test_changed_bytes_give_messages_or_one_line(folder: Path) -> None:
    file = database(folder)
    data = file.read_bytes()
    dice = random.Random(8)
    for _ in range(200):
        new = bytearray(data)
        for _ in range(dice.randrange(1, 5)):
            new[dice.randrange(len(new))] = dice.randrange(256)
        if dice.random() < 0.5:
            new[dice.randrange(200)] = dice.randrange(256)
        file.write_bytes(new)
        with contextlib.suppress(FieldlocError):
            bag = open_bag(file)
            assert len(ros_bags.read(bag)) <= sum(bag.counts.values())


@pytest.mark.skipif(not WBAG[0].is_file(), reason=f"{WBAG[0]} is missing: a split recording")
def test_a_recorded_split_bag_is_read_as_rosbags_reads_it(tmp_path: Path) -> None:
    theirs = []
    for file in WBAG:
        shutil.copyfile(file, tmp_path / file.name.split("__")[-1])
        with Reader(file) as reader:
            theirs += [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
    assert len(theirs) > 100
    assert sorted(ros_bags.read(open_bag(tmp_path))) == sorted(theirs)
