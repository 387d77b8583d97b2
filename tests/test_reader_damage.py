"""MCAP files with bytes that are not what they were."""

import random
import resource
import struct
import tracemalloc

import lz4.frame
import mcap.writer
import pytest
import zstandard
from mcap_files import (
    DEFINED,
    END,
    by_mcap,
    chunk,
    chunk_of,
    message,
    message_index,
    messages,
    put,
    times,
    written,
)

from logs.reader.damage import Losses, Lost
from logs.reader.mcap_container import McapContainer
from logs.reader.records import LIMIT_BYTES, MAGIC, Op

SECOND = 10**9
NONE = mcap.writer.CompressionType.NONE


def seconds(*numbers):
    return [SECOND * number for number in numbers]


FIRST, LAST = chunk_of(seconds(0, 1, 2)), chunk_of(seconds(7, 8))
LOST = "missing, from 3.0 s on"


def flipped(content, place, bit=1):
    return content[:place] + bytes([content[place] ^ bit]) + content[place + 1 :]


@pytest.mark.parametrize("end", [END, b""], ids=["whole", "cut"])
@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_a_chunk_with_a_wrong_checksum_is_left_out_and_its_time_and_messages_are_said(tmp_path, compression, end):
    bad = chunk_of(seconds(3, 4, 5, 6), compression, crc=1)
    path = put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, end)
    read, damage = messages(path)
    assert [raw.log_time_ns // SECOND for raw in read] == [0, 1, 2, 7, 8]
    assert damage[0] == f"1 damaged chunk left out (its checksum is wrong): 3.0 s {LOST}, 4 messages"
    assert len(damage) == (1 if end else 2)


def test_a_chunk_that_turns_out_bad_only_when_it_is_read_is_told_from_then_on_and_once(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0), count=90, times=lambda i: i * SECOND, chunk_size=1000)
    content = path.read_bytes()
    block = McapContainer(path)._contents.blocks[1]
    path.write_bytes(flipped(content, (block.start + block.end) // 2))
    container = McapContainer(path)
    assert container.damage == ()
    for _ in range(2):
        read = [raw.log_time_ns // SECOND for raw in container.messages(container.sources)]
        missing = sorted({*range(90)} - {*read})
        assert missing == [*range(missing[0], missing[-1] + 1)]
        (sentence,) = container.damage
        assert f"{len(missing) - 1}.0 s missing, from {missing[0]}.0 s on, {len(missing)} messages" in sentence


def test_without_a_message_index_the_number_of_lost_messages_is_not_claimed(tmp_path):
    bad = chunk_of(seconds(3, 4, 5, 6), indexed=False, crc=1)
    _, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, END))
    assert damage[0].endswith(f"3.0 s {LOST}, how many messages is not known")


def test_a_time_that_no_recording_lasts_is_not_claimed(tmp_path):
    bad = chunk(message(3 * SECOND), 2**63, 2**63 + 2**62, crc=1)
    _, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, END))
    assert "at what time is not known" in damage[0]
    bad = chunk(message(3 * SECOND), 3 * SECOND, 2**63, crc=1)
    _, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, END))
    assert "at what time is not known" in damage[0]


def test_many_damaged_chunks_are_one_sentence_and_time_is_not_counted_twice(tmp_path):
    bad = [chunk_of(seconds(*times), crc=1) for times in [(3, 4), (3, 5), (10, 12)]]
    _, damage = messages(put(tmp_path / "log.mcap", DEFINED, *bad, LAST, END))
    assert damage == (f"3 damaged chunks left out (its checksum is wrong): 4.0 s {LOST}, 6 messages",)
    losses = Losses({1: Lost("it is bad", 3, (0, SECOND)), 2: Lost("it is worse", None, None)})
    (sentence,) = losses.sentences((0, SECOND), 9)
    assert sentence == (
        "2 damaged chunks left out (it is bad): at least 1.0 s missing, from 0.0 s on, at least 3 messages"
    )


NONSENSE = [
    (chunk(b"no records, but enough bytes for one"), "its records do not fill it"),
    (chunk(message(3 * SECOND) + b"\5"), "its records do not fill it"),
    (chunk(message(3 * SECOND) + bytes(9)), "its records do not fill it"),
    (chunk(message(3 * SECOND), packed=b"\x28\xb5\x2f\xfd nonsense"), "[a-z]"),
    (chunk(message(3 * SECOND), compression="zstd", packed=b""), "[a-z]"),
    (chunk(message(3 * SECOND), compression="lz4", packed=b"\4\x22\x4d\x18 nonsense"), "[a-z]"),
    (chunk(message(3 * SECOND), compression="lz4", packed=b""), "[a-z]"),
]


@pytest.mark.parametrize(("bad", "why"), NONSENSE, ids=range(len(NONSENSE)))
def test_a_chunk_with_nonsense_inside_is_left_out(tmp_path, bad, why):
    read, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, END))
    assert [raw.log_time_ns // SECOND for raw in read] == [0, 1, 2, 7, 8]
    assert len(damage) == 1
    assert damage[0].startswith("1 damaged chunk left out (")


# Records whose head is damaged: reading goes on after them


@pytest.mark.parametrize("bit", [1, 2, 4, 8, 16, 32, 64, 128])
@pytest.mark.parametrize("place", range(9))
@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_chunk_with_a_damaged_head_costs_no_other_chunk(tmp_path, compression, place, bit):
    bad = flipped(chunk_of(seconds(3, 4, 5, 6), compression), place, bit)
    read, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bad, LAST, END))
    stamps = [raw.log_time_ns // SECOND for raw in read]
    assert stamps in ([0, 1, 2, 7, 8], list(range(9)))
    assert len(stamps) == 9 or (len(damage) == 1 and f"3.0 s {LOST}, 4 messages" in damage[0])


@pytest.mark.parametrize("bit", [1, 2, 4, 8, 16, 32, 64, 128])
@pytest.mark.parametrize("place", range(9))
def test_a_message_with_a_damaged_head_costs_no_other_message(tmp_path, place, bit):
    noise = random.Random(0).randbytes(60)
    parts = [message(SECOND * i, data=noise) for i in range(10)]
    parts[4] = flipped(parts[4], place, bit)
    read, damage = messages(put(tmp_path / "log.mcap", DEFINED, *parts, END))
    stamps = [raw.log_time_ns // SECOND for raw in read]
    assert [stamp for stamp in stamps if stamp != 4] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert damage == ("1 damaged record left out",) or (place, bit) == (0, 128)  # then it is another program's own


def test_a_message_index_that_a_flipped_bit_makes_a_message_is_none(tmp_path):
    index = message_index(1, [(SECOND * i, i) for i in range(3, 7)])
    good = chunk_of(seconds(3, 4, 5, 6), indexed=False)
    bad = flipped(index, 0, Op.MESSAGE ^ Op.MESSAGE_INDEX)
    for indexes, count in [
        ([bad], "1 damaged record"),
        ([index, bad], "1 damaged record"),
        ([bad, bad], "2 damaged records"),
    ]:
        read, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, good, *indexes, message(7 * SECOND), END))
        assert [raw.log_time_ns // SECOND for raw in read] == list(range(8))
        assert damage == (f"{count} left out",)


@pytest.mark.parametrize("hole", [9, 100, 5000, 2_000_000])
def test_reading_goes_on_after_a_hole(tmp_path, hole):
    for filling in (bytes(hole), random.Random(0).randbytes(hole)):
        path = put(tmp_path / "log.mcap", DEFINED, FIRST, filling, LAST, message(9 * SECOND), END)
        read, damage = messages(path)
        assert [raw.log_time_ns // SECOND for raw in read] == [0, 1, 2, 7, 8, 9]
        assert damage == ("1 damaged record left out",)


def test_reading_goes_on_wherever_the_hole_ends(tmp_path):
    for hole in range(4070, 4110):  # the file is searched in pieces, the first of 4096 bytes
        assert times(put(tmp_path / "log.mcap", DEFINED, FIRST, bytes(hole), LAST, END)) == seconds(0, 1, 2, 7, 8)


def test_messages_in_an_uncompressed_chunk_with_a_destroyed_head_are_still_read(tmp_path):
    bad = chunk_of(seconds(3, 4, 5, 6), "", indexed=False)
    path = put(tmp_path / "log.mcap", DEFINED, FIRST, bytes(60) + bad[60:], LAST, END)
    read, damage = messages(path)
    assert [raw.log_time_ns // SECOND for raw in read] == [0, 1, 2, 4, 5, 6, 7, 8]
    assert damage == ("1 damaged record left out",)


def test_a_message_of_several_megabytes_with_a_wrong_length_costs_no_other(tmp_path):
    big = message(3 * SECOND, data=random.Random(0).randbytes(3_000_000))
    for wrong in (flipped(big, 3), flipped(big, 3, 2), flipped(big, 1), flipped(big, 5, 8)):
        path = put(tmp_path / "log.mcap", DEFINED, message(0), wrong, *(message(i * SECOND) for i in range(4, 50)), END)
        assert [time for time in times(path) if time != 3 * SECOND] == seconds(0, *range(4, 50))


def test_a_sound_summary_finds_the_chunks_whatever_their_heads_say(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0), count=90, times=lambda i: i, chunk_size=1000)
    content = bytearray(path.read_bytes())
    for block in McapContainer(path)._contents.blocks:
        content[block.start : block.start + 9] = bytes(9)
    path.write_bytes(content)
    assert times(path) == list(range(90))


def test_damage_to_the_summary_costs_no_message_and_is_said(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0), count=30, chunk_size=300)
    content = path.read_bytes()
    whole = by_mcap(path)
    summary = int.from_bytes(content[-28:-20], "little")
    for place in range(summary, len(content), 5):
        path.write_bytes(flipped(content, place, 4))
        read, damage = messages(path)
        assert read == whole
        assert len(damage) == 1, place
        assert "the index at the end is" in damage[0], place


def test_a_damaged_attachment_is_left_out_and_counted(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0))
    path.write_bytes(
        path.read_bytes().replace(
            b"text/plaindata".replace(b"plain", b"plain" + struct.pack("<Q", 4)),
            b"text/plain" + struct.pack("<Q", 4) + b"daTa",
        )
    )
    container = McapContainer(path)
    assert list(container.attachments()) == []
    assert container.damage == ("1 damaged attachment left out",)
    path = put(path, DEFINED, struct.pack("<BQ", Op.ATTACHMENT, 100) + bytes(95) + b"\xff" * 5, END)
    container = McapContainer(path)
    assert [a.data for a in container.attachments()] in ([], [b""])


def test_a_chunk_index_that_claims_later_times_than_there_are_is_told(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0), times=lambda i: i, chunk_size=1000, enable_crcs=False)
    content = path.read_bytes()
    summary = int.from_bytes(content[-28:-20], "little")
    start = McapContainer(path)._contents.blocks[1]
    claim = struct.pack("<QQQ", start.first_ns, start.last_ns, start.start)
    lie = struct.pack("<QQQ", start.last_ns, start.last_ns, start.start)
    assert claim in content[summary:]
    path.write_bytes(content[:summary] + content[summary:].replace(claim, lie))
    read, damage = messages(path)
    assert sorted(raw.log_time_ns for raw in read) == list(range(200))
    assert damage == ("1 chunk with messages earlier than the index says: they may come late",)


# Chunks that would fill the memory


def unknown_compression():
    return chunk(message(3 * SECOND)).replace(struct.pack("<I", 4) + b"zstd", struct.pack("<I", 4) + b"zip!")


def packed_zstd(content):
    return zstandard.ZstdCompressor(write_content_size=False).compress(content)


def packed_lz4(content):
    return lz4.frame.compress(content, store_size=False)


def big(pack=zstandard.compress, **lies):
    """64 MiB, in a quarter of a megabyte at most."""
    content = message(3 * SECOND, data=bytes(1 << 26))
    return chunk(content, compression="lz4" if pack is packed_lz4 else "zstd", packed=pack(content), **lies)


BOMBS = {
    "big and honest": big,
    "zstd, bigger than it claims": lambda: big(size=1 << 20, crc=0),
    "zstd, bigger than it claims, which it does not say": lambda: big(packed_zstd, size=1 << 20, crc=0),
    "lz4, bigger than it claims": lambda: big(packed_lz4, size=1 << 20, crc=0),
    "beyond the limit": lambda: chunk(message(3 * SECOND), size=LIMIT_BYTES + 1),
    "zstd, endless": lambda: chunk(message(3 * SECOND), size=2**64 - 1),
    "lz4, endless": lambda: chunk(message(3 * SECOND), compression="lz4", size=2**63),
    "not packed, endless": lambda: chunk(message(3 * SECOND), compression="", size=2**63),
    "packed by nobody knows what": unknown_compression,
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS.keys())
@pytest.mark.parametrize("cut", [0, 8])
def test_a_chunk_that_would_fill_the_memory_is_refused_in_one_sentence(tmp_path, bomb, cut):
    content = bomb()
    path = put(tmp_path / "log.mcap", DEFINED, FIRST, content[: len(content) - cut], *([] if cut else [LAST, END]))
    tracemalloc.start()
    try:
        read, damage = messages(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert [raw.log_time_ns // SECOND for raw in read] == ([0, 1, 2] if cut else [0, 1, 2, 7, 8])
    assert len(damage) == 1
    assert damage[0].startswith("cut off" if cut else "1 damaged chunk left out (")
    assert peak < 1 << 24


def test_a_record_that_claims_to_be_huge_is_not_believed(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, message(1), struct.pack("<BQ", Op.CHUNK, 2**62) + bytes(100))
    assert times(path) == [1]
    path = put(path, DEFINED, message(1), struct.pack("<BQ", Op.MESSAGE, 2**62) + bytes(100), LAST, END)
    assert times(path) == [1, *seconds(7, 8)]


# Anything


FILES = [
    {},
    {"use_chunking": False},
    {"compression": NONE},
    {"compression": mcap.writer.CompressionType.LZ4},
    {"index_types": mcap.writer.IndexType.NONE},
    {"use_statistics": False},
]


def flip_randomly(tmp_path, options, rng, rounds):
    path = written(tmp_path / "log.mcap", rng, count=150, times=lambda i: i * SECOND, chunk_size=700, **options)
    content = path.read_bytes()
    whole = by_mcap(path)
    known = set(whole)
    for _ in range(rounds):
        damaged = bytearray(content)
        flips = rng.choice([1, 1, 1, 4])
        for _ in range(flips):
            damaged[rng.randrange(len(MAGIC), len(damaged))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        container = McapContainer(path)
        read = list(container.messages(container.sources))
        list(container.attachments())
        assert all("\n" not in sentence for sentence in container.damage)
        assert [raw.log_time_ns for raw in read] == sorted(raw.log_time_ns for raw in read)
        if "use_chunking" not in options and (flips == 1 or "compression" not in options):
            assert set(read) <= known  # nothing is checked outside chunks, nor in one that lost its head
        if flips == 1:
            assert len(read) >= len(whole) - 20  # a chunk
            assert len(read) == len(whole) or container.damage


@pytest.mark.parametrize("options", FILES, ids=str)
def test_flipped_bits_never_give_a_traceback_a_wrong_message_or_silence(tmp_path, options):
    flip_randomly(tmp_path, options, random.Random(7), 50)


@pytest.mark.slow
@pytest.mark.parametrize("options", FILES, ids=str)
def test_ten_thousand_flipped_bits_never_give_a_traceback_a_wrong_message_or_silence(tmp_path, options):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    flip_randomly(tmp_path, options, random.Random(8), 1700)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_a_chunk_that_claims_to_end_beyond_any_file_is_damaged(tmp_path):
    bad = bytearray(chunk_of(seconds(3, 4, 5, 6)))
    bad[9 + 32 + 4 + 7] = 0xFF  # the highest byte of the size of what is packed
    read, damage = messages(put(tmp_path / "log.mcap", DEFINED, FIRST, bytes(bad), LAST, END))
    assert [raw.log_time_ns // SECOND for raw in read] == [0, 1, 2, 7, 8]
    assert len(damage) == 1


def test_noise_after_the_magic_number_is_no_message(tmp_path):
    for seed in range(20):
        rng = random.Random(seed)
        read, damage = messages(put(tmp_path / "log.mcap", rng.randbytes(rng.randrange(20_000))))
        assert read == []
        assert len(damage) == 1
