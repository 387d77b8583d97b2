"""ROS 1 bags, whole and broken, against rosbags."""

import contextlib
import random
import struct
import tracemalloc
from pathlib import Path

import pytest
import ros_bags
import ros_messages
from rosbags.rosbag1 import Reader

from fieldloc.errors import FieldlocError
from logs import ros
from logs.edit import cut
from logs.foreign.parts import ImuPart, MagneticPart, OdometryPart
from logs.reader.container import open_container
from logs.ros.bags import open_bag

MESSAGES = ros_bags.contents(60, ros1=True)
RAZOR = Path(__file__).parents[2] / "shared" / "data" / "mcap" / "sparkfun_razor.bag"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ros_bags.write_ros1(tmp_path_factory.mktemp("ros1") / "walk.bag", MESSAGES)


def chunk_starts(bag: Path) -> list[int]:
    with Reader(bag) as reader:
        return sorted(info.pos for info in reader.chunk_infos)


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_all_messages_come_in_the_order_of_time(tmp_path: Path, compression: str) -> None:
    bag = open_bag(ros_bags.write_ros1(tmp_path / "walk.bag", MESSAGES, compression))
    assert ros_bags.read(bag) == ros_bags.in_time_order(MESSAGES)
    assert bag.damage == ()
    assert sorted(bag.counts.values()) == [20, 20, 20]
    assert bag.span_ns == (1_000_000_000, 1_055_000_000)
    assert list(bag.attachments()) == []


def test_a_bag_is_opened_by_its_content(bag: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "walk.txt"
    renamed.write_bytes(bag.read_bytes())
    assert sum(open_container(renamed).counts.values()) == len(MESSAGES)


def test_topics_and_times_are_selected(bag: Path) -> None:
    opened = open_bag(bag)
    times = [None, -5, 0, 1_000_000_000, 1_010_000_000, 1_030_000_001, 2_000_000_000, 2**63, 2**70]
    for start in times:
        for end in times:
            expected = [
                message
                for message in ros_bags.in_time_order(MESSAGES)
                if (start is None or message[1] >= start) and (end is None or message[1] < end)
            ]
            assert ros_bags.read(opened, start, end) == expected
            only = [message for message in expected if message[0] != "/imu"]
            assert ros_bags.read(opened, start, end, "/odometry", "/tfmessage") == only
    assert list(opened.messages([])) == list(opened.messages([99])) == []


def test_what_a_channel_says_is_enough_to_decode_it(bag: Path) -> None:
    opened = open_bag(bag)
    for source in opened.sources.values():
        assert (source.message_encoding, source.schema_encoding) == ("ros1", "ros1msg")
    number = next(number for number, source in opened.sources.items() if source.topic == "/odometry")
    source = opened.sources[number]
    with Reader(bag) as reader:
        connection = next(each for each in reader.connections if each.topic == "/odometry")
    assert source.schema_name == "nav_msgs/Odometry"
    assert source.schema_data.decode() == connection.msgdef.data
    assert source.metadata["md5sum"] == connection.digest
    decode = ros.decoder(source)
    assert decode is not None
    assert all(isinstance(decode(message.data), OdometryPart) for message in opened.messages([number]))


def test_a_topic_of_two_publishers_is_one_channel(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    name = "geometry_msgs/msg/Twist"
    with Writer(tmp_path / "two.bag") as writer:
        ends = [
            writer.add_connection("/cmd", name, typestore=ros_messages.store(ros1=True), callerid=caller)
            for caller in ("/a", "/b")
        ]
        for time, end in enumerate(ends * 3):
            writer.write(end, time, bytes(48))
    bag = open_bag(tmp_path / "two.bag")
    assert list(bag.counts.values()) == [6]
    assert [message.log_time_ns for message in bag.messages(bag.sources)] == list(range(6))


def test_a_latched_topic_is_known_as_one_so_that_a_cut_carries_it_over(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    with Writer(tmp_path / "latched.bag") as writer:
        for topic, latching in (("/map", 1), ("/cmd", None)):
            end = writer.add_connection(
                topic, "geometry_msgs/msg/Twist", typestore=ros_messages.store(ros1=True), latching=latching
            )
            writer.write(end, 1_000_000_000, bytes(48))
            if topic == "/cmd":
                writer.write(end, 9_000_000_000, bytes(48))
    bag = open_bag(tmp_path / "latched.bag")
    assert {source.topic: source.metadata.get("latching") for source in bag.sources.values()} == {
        "/map": "1",
        "/cmd": None,
    }
    assert cut(bag, tmp_path / "cut.mcap", start_ns=5_000_000_000).counts == {"/map": 1, "/cmd": 1}


def test_a_bag_that_is_cut_off_anywhere_gives_what_stands_before(bag: Path, tmp_path: Path) -> None:
    """Every chunk that is whole, and of the last one every message that is; never a message twice or a wrong one."""
    data = bag.read_bytes()
    starts = chunk_starts(bag)
    per_chunk = [count_in_chunk(bag, start) for start in starts]
    cut = tmp_path / "cut.bag"
    for length in [*range(30), *range(30, len(data), 61), len(data) - 1]:
        cut.write_bytes(data[:length])
        if length < 13:
            with pytest.raises(FieldlocError):
                open_bag(cut)
            continue
        opened = open_bag(cut)
        found = ros_bags.read(opened)
        whole = sum(1 for start in starts[1:] if start <= length)
        assert len(found) >= sum(per_chunk[:whole])
        assert sorted(found) == sorted(MESSAGES[: len(found)])
        assert found == ros_bags.in_time_order(MESSAGES[: len(found)])
        assert sum(opened.counts.values()) == len(found)
        if length < starts[-1]:
            assert f"it is cut off at byte {length}" in opened.damage or "broken" in opened.damage[0]


def count_in_chunk(bag: Path, start: int) -> int:
    with Reader(bag) as reader:
        return next(sum(info.connection_counts.values()) for info in reader.chunk_infos if info.pos == start)


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_compressed_bag_that_is_cut_off_gives_its_whole_chunks(tmp_path: Path, compression: str) -> None:
    bag = ros_bags.write_ros1(tmp_path / "walk.bag", MESSAGES, compression)
    starts = chunk_starts(bag)
    data = bag.read_bytes()
    counts = [count_in_chunk(bag, start) for start in starts]
    for whole in (1, 2, len(starts) - 1):
        bag.write_bytes(data[: starts[whole] + 70])
        found = ros_bags.read(open_bag(bag))
        assert len(found) >= sum(counts[:whole])
        assert found == ros_bags.in_time_order(MESSAGES[: len(found)])


def test_a_bag_that_was_never_closed_is_read_and_says_so(bag: Path, tmp_path: Path) -> None:
    """As a killed recorder leaves it: no place of the index in the first record, and no index."""
    data = bag.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack_from("<Q", data, at)
    active = tmp_path / "walk.bag.active"
    active.write_bytes(data[:at] + bytes(8) + data[at + 8 : index])
    with pytest.raises(Exception, match="not indexed"), Reader(active):
        pass
    opened = open_bag(active)
    assert ros_bags.read(opened) == ros_bags.in_time_order(MESSAGES)
    assert len(opened.damage) == 1
    assert "rosbag reindex" in opened.damage[0]


def test_a_broken_stretch_costs_only_its_own_chunk(bag: Path, tmp_path: Path) -> None:
    data = bytearray(bag.read_bytes())
    starts = chunk_starts(bag)
    counts = [count_in_chunk(bag, start) for start in starts]
    data[starts[3] : starts[3] + 60] = b"\xee" * 60
    broken = tmp_path / "broken.bag"
    broken.write_bytes(data)
    opened = open_bag(broken)
    found = ros_bags.read(opened)
    before, after = sum(counts[:3]), sum(counts[:4])
    assert found == ros_bags.in_time_order(MESSAGES[:before] + MESSAGES[after:])
    assert any(f"from {starts[3]} on are broken" in sentence for sentence in opened.damage)


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_compressed_chunk_that_cannot_be_unpacked_is_left_out_and_said(tmp_path: Path, compression: str) -> None:
    bag = ros_bags.write_ros1(tmp_path / "walk.bag", MESSAGES, compression)
    data = bytearray(bag.read_bytes())
    starts = chunk_starts(bag)
    counts = [count_in_chunk(bag, start) for start in starts]
    at = data.index(b"size=", starts[2]) + 9 + 4  # behind the header and the data's length
    data[at : at + 8] = b"\xee" * 8
    bag.write_bytes(data)
    opened = open_bag(bag)
    assert opened.damage == ()
    found = ros_bags.read(opened)
    assert found == ros_bags.in_time_order(MESSAGES[: sum(counts[:2])] + MESSAGES[sum(counts[:3]) :])
    assert opened.damage == (f"{counts[2]} messages are in broken chunks and left out",)


def test_changed_bytes_give_messages_or_one_line(bag: Path, tmp_path: Path) -> None:
    data = bag.read_bytes()
    dice = random.Random(7)
    changed = tmp_path / "changed.bag"
    for _ in range(300):
        new = bytearray(data)
        for _ in range(dice.randrange(1, 5)):
            new[dice.randrange(len(new))] = dice.randrange(256)
        changed.write_bytes(new)
        with contextlib.suppress(FieldlocError):
            opened = open_bag(changed)
            assert len(ros_bags.read(opened)) <= sum(opened.counts.values())


def test_no_length_in_a_bag_is_believed(bag: Path, tmp_path: Path) -> None:
    data = bag.read_bytes()
    last = chunk_starts(bag)[-1]
    at = last + 4 + int.from_bytes(data[last : last + 4], "little")  # the length of the chunk's data
    huge = tmp_path / "huge.bag"
    huge.write_bytes(data[:at] + b"\xf0\xff\xff\xff" + data[at + 4 :])
    tracemalloc.start()
    found = ros_bags.read(open_bag(huge))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == ros_bags.in_time_order(MESSAGES)
    assert peak < 10_000_000


def test_other_bags_are_refused_with_a_way_out(tmp_path: Path, bag: Path) -> None:
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(FieldlocError, match=r"old\.bag.*2\.0; `rosbag fix`"):
        open_bag(old)
    data = bag.read_bytes()
    secret = tmp_path / "secret.bag"
    length = int.from_bytes(data[13:17], "little")
    field = b"encryptor=rosbag/AesCbcEncryptor"
    header = data[17 : 17 + length] + struct.pack("<I", len(field)) + field
    secret.write_bytes(data[:13] + struct.pack("<I", len(header)) + header + data[17 + length :])
    with pytest.raises(FieldlocError, match=r"secret\.bag.*encrypted"):
        open_bag(secret)
    with pytest.raises(FieldlocError, match=r"none\.bag.*cannot be read"):
        open_bag(tmp_path / "none.bag")


@pytest.mark.skipif(not RAZOR.exists(), reason=f"{RAZOR} is missing: a recorded IMU")
def test_a_recorded_imu_is_read_as_rosbags_reads_it() -> None:
    opened = open_container(RAZOR)
    with Reader(RAZOR) as reader:
        theirs = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
    assert ros_bags.read(opened) == theirs
    kinds = {source.topic: ros.known_type(source) for source in opened.sources.values()}
    assert kinds == {"/imu/data_raw": ImuPart, "/imu/mag": MagneticPart}
    decoders = {number: ros.decoder(source) for number, source in opened.sources.items()}
    stamps = []
    for message in opened.messages(opened.sources):
        decode = decoders[message.channel]
        assert decode is not None
        part = decode(message.data)
        assert isinstance(part, (ImuPart, MagneticPart))
        stamps.append(part.stamp_ns)
    assert len(stamps) == 4288
    assert all(abs(stamp - 1_352_907_630_000_000_000) < 30e9 for stamp in stamps)
