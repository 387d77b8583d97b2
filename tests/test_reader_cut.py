"""MCAP files that end too early."""

import random

import mcap.writer
import pytest
from mcap_files import DATA_END, DEFINED, END, HEADER, chunk, chunk_of, message, messages, put, times, written
from mcap_files import by_mcap as expected_messages

from logs.reader.mcap_container import McapContainer
from logs.reader.records import MAGIC

SECOND = 10**9


def ends_of_whole_parts(content):
    """Where each record of the file ends, by its lengths."""
    ends, at = [], len(MAGIC)
    while at + 9 < len(content):
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        ends.append(at)
    return ends


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": mcap.writer.CompressionType.LZ4},
        {"compression": mcap.writer.CompressionType.NONE},
        {"use_chunking": False},
    ],
    ids=str,
)
@pytest.mark.parametrize("step", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_wherever_a_file_is_cut_it_gives_a_prefix_with_every_whole_chunk_or_record_and_says_so_once(
    tmp_path, options, step
):
    path = written(tmp_path / "log.mcap", random.Random(1), count=40, times=lambda i: i, chunk_size=400, **options)
    content = path.read_bytes()
    everything = expected_messages(path)
    whole = {}  # end of a record -> messages up to there
    for end in ends_of_whole_parts(content)[:-1]:
        path.write_bytes(content[:end])
        whole[end] = len(times(path))
    summary = int.from_bytes(content[-28:-20], "little")
    assert whole[summary] == 40
    for length in range(len(MAGIC), len(content), step):
        path.write_bytes(content[:length])
        read, damage = messages(path)
        least = max(count for end, count in {0: 0, **whole}.items() if end <= length)
        assert read == everything[: len(read)]
        assert len(read) >= least
        assert len(damage) == 1
        assert "cut off" in damage[0]
        if len(read) > 0 and length < summary:
            assert f"{len(read)} message" in damage[0]


def test_of_a_chunk_that_is_cut_the_messages_before_the_cut_are_read_and_the_missing_time_is_said(tmp_path):
    noise = random.Random(0).randbytes(1000)
    last = chunk_of([SECOND * i for i in range(10, 20)], "", data=noise)
    parts = MAGIC + DEFINED + chunk_of([SECOND * i for i in range(10)], data=noise)
    path = tmp_path / "log.mcap"
    path.write_bytes(parts + last[:5300])
    read, damage = messages(path)
    assert [raw.log_time_ns // SECOND for raw in read] == list(range(15))
    assert all(raw.data == noise for raw in read)
    assert damage == (
        "cut off (or still being written): 15 messages read, up to 14.0 s (the last 5 could not be checked); "
        "5.0 s of its last chunk are missing, and all that came after",
    )


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_packed_chunk_that_is_cut_gives_its_first_messages_too(tmp_path, compression):
    rng = random.Random(0)
    parts = [message(SECOND * i, data=rng.randbytes(50_000)) for i in range(20)]
    whole = MAGIC + DEFINED + chunk(b"".join(parts), 0, 19 * SECOND, compression)
    path = tmp_path / "log.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    read, damage = messages(path)
    assert 5 <= len(read) <= 10
    assert [raw.log_time_ns // SECOND for raw in read] == list(range(len(read)))
    assert f"; {20 - len(read)}.0 s of its last chunk are missing" in damage[0]


def test_a_file_of_which_only_a_part_of_one_chunk_is_left_says_how_long_that_was(tmp_path):
    part = chunk_of([0, 3 * SECOND // 2], data=random.Random(0).randbytes(1000))
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + DEFINED + part[:200])
    assert messages(path) == (
        [],
        (
            "cut off (or still being written) before its first whole message; "
            "1.5 s of its last chunk are missing, and all that came after",
        ),
    )


def test_what_cannot_be_known_is_not_claimed(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, message(SECOND), message(2 * SECOND), message(3 * SECOND)[:-1])
    assert messages(path)[1] == (
        "cut off (or still being written): 2 messages read, up to 2.0 s; how much is missing is not known",
    )
    nonsense = chunk_of([2**63, 2**63 + 2**62])[:60]
    path = put(path, DEFINED, message(SECOND), nonsense)
    assert messages(path)[1][0].endswith("1 message read, up to 1.0 s; how much is missing is not known")


@pytest.mark.parametrize(
    "end", [b"", HEADER, HEADER[:5], DEFINED], ids=["only magic", "header", "half a header", "no message"]
)
def test_a_file_cut_before_its_first_message_says_so(tmp_path, end):
    path = put(tmp_path / "log.mcap", end)
    container = McapContainer(path)
    assert container.span_ns is None
    assert container.damage == (
        "cut off (or still being written) before its first whole message; how much is missing is not known",
    )


def test_a_file_that_only_lost_its_index_is_read_in_full(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, chunk_of(range(5)), DATA_END)
    assert messages(path)[1] == ("the index at the end is cut off; all 5 messages are there",)
    path = put(path, DEFINED, chunk_of(range(5)), END[: -len(MAGIC)])
    assert messages(path)[1] == ("the index at the end is cut off; all 5 messages are there",)
    assert times(path) == list(range(5))


def test_a_tail_of_zeros_is_no_message(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, chunk_of(range(5)), message(5), bytes(5000))
    read, damage = messages(path)
    assert len(read) == 6
    assert damage == (
        "cut off (or still being written): 6 messages read, up to 0.000000005 s; how much is missing is not known",
    )


@pytest.mark.slow
@pytest.mark.parametrize("compression", [*mcap.writer.CompressionType], ids=str)
def test_wherever_a_large_file_is_cut_it_gives_a_prefix(tmp_path, compression):
    rng = random.Random(2)
    options = {"compression": compression, "chunk_size": 200_000}
    path = written(tmp_path / "log.mcap", rng, count=40_000, size=200, times=lambda i: i, **options)
    content = path.read_bytes()
    everything = expected_messages(path)
    for _ in range(170):
        length = rng.randrange(len(content))
        path.write_bytes(content[: max(length, len(MAGIC))])
        read, damage = messages(path)
        assert read == everything[: len(read)]
        assert len(read) >= 40_000 * (length - 400_000) // len(content)
        assert len(damage) == 1
