"""Chunks that overlap in time: the order of messages, and how much memory it takes."""

import random
import subprocess
import sys
from pathlib import Path

import mcap_files
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_files import DEFINED, END, chunk_of, message, put

from logs.reader import blocks, mcap_container, order
from logs.reader.mcap_container import McapContainer

ROOT = Path(__file__).parents[1]


def with_budget(monkeypatch, budget_bytes):
    """Watch how much waits for its turn, with another limit than the usual."""
    most = [0]

    def watched(waiting):
        held = sum(unpacked.bytes_held for unpacked in waiting)
        most[0] = max(most[0], held)
        return held

    whole = order.in_time_order
    monkeypatch.setattr(order, "_held", watched)
    monkeypatch.setattr(mcap_container, "in_time_order", lambda *given: whole(*given, budget_bytes))
    return most


@given(data=st.data())
@settings(deadline=None, max_examples=80)
def test_whatever_overlaps_and_however_little_may_wait_the_order_is_that_of_log_time(tmp_path_factory, data):
    instants = data.draw(st.sampled_from([st.integers(0, 30), st.just(5), st.integers(0, 10**6)]))
    groups = data.draw(st.lists(st.lists(instants, min_size=1, max_size=15), min_size=1, max_size=12))
    parts = []
    for number, times in enumerate(groups):
        if data.draw(st.booleans()):
            parts.append(chunk_of(times, data=bytes([number])))
        else:
            parts += [message(time, data=bytes([number]), sequence=i) for i, time in enumerate(times)]
    path = put(tmp_path_factory.mktemp("log") / "log.mcap", DEFINED, *parts, END)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "_MOST_BLOCKS", data.draw(st.sampled_from([4, 1000])))
        with_budget(patch, data.draw(st.sampled_from([0, 500, 3000, 10**6])))
        read, damage = mcap_files.messages(path)
    assert read == mcap_files.by_mcap(path)
    assert damage == ()


def test_what_waits_stays_within_its_limit_when_all_chunks_overlap(tmp_path, monkeypatch):
    rng = random.Random(0)
    parts = [chunk_of(sorted(rng.randrange(10**9) for _ in range(100)), data=rng.randbytes(200)) for _ in range(60)]
    path = put(tmp_path / "log.mcap", DEFINED, *parts, END)
    most = with_budget(monkeypatch, 200_000)
    read, _ = mcap_files.messages(path)
    assert read == mcap_files.by_mcap(path)
    assert 100_000 < most[0] < 250_000  # of 1.5 MB; the last chunk that was opened is on top


def test_chunks_that_overlap_within_the_limit_are_unpacked_once(tmp_path, monkeypatch):
    opened = []
    whole = mcap_container.read_chunk
    monkeypatch.setattr(mcap_container, "read_chunk", lambda *at, check: opened.append(at) or whole(*at))
    path = put(tmp_path / "log.mcap", DEFINED, *(chunk_of(range(i, i + 500)) for i in range(0, 1000, 50)), END)
    assert mcap_files.times(path) == sorted(t for i in range(0, 1000, 50) for t in range(i, i + 500))
    assert len(opened) == 20


@pytest.mark.parametrize("loose", [True, False])
def test_the_index_of_a_file_of_very_many_chunks_or_messages_stays_small(tmp_path, monkeypatch, loose):
    monkeypatch.setattr(blocks, "_MOST_BLOCKS", 16)
    rng = random.Random(0)
    times = [rng.randrange(10**6) for _ in range(400)]
    parts = [message(t, data=bytes(2000)) + b"" if loose else chunk_of([t]) for t in times]
    path = put(tmp_path / "log.mcap", DEFINED, *parts, END)
    container = McapContainer(path)
    assert len(container._contents.blocks) <= 16
    assert [raw.log_time_ns for raw in container.messages([1])] == sorted(times)
    content = path.read_bytes()
    begin = len(mcap_files.MAGIC + DEFINED) + sum(map(len, parts[:200]))
    for damaged, lost in [(range(begin, begin + 9), 1), (range(begin + 70, begin + 71), 0 if loose else 1)]:
        path.write_bytes(bytes(0xFE if place in damaged else byte for place, byte in enumerate(content)))
        read, damage = mcap_files.messages(path)
        assert len(read) == 400 - lost
        assert len(damage) == lost


MEASURE = """
import resource, sys
from logs.reader.mcap_container import McapContainer
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
container = McapContainer(sys.argv[1])
count, last = 0, 0
for message in container.messages(container.sources):
    assert message.log_time_ns >= last
    last, count = message.log_time_ns, count + 1
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one after the other", "overlapping", "no chunks"])
def test_a_file_of_300_megabytes_is_read_in_a_quarter_of_that(tmp_path, kind):
    chunks, per_chunk, noise = 150, 500, random.Random(0).randbytes(4000)
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        file.write(mcap_files.MAGIC + DEFINED)
        for i in range(chunks):
            step, first = (chunks, i) if kind == "overlapping" else (1, i * per_chunk)
            times = range(first, first + step * per_chunk, step)
            if kind == "no chunks":
                file.writelines(message(time, data=noise) for time in times)
            else:
                file.write(chunk_of(times, "", data=noise))
        file.write(END)
    assert path.stat().st_size > 300_000_000
    run = subprocess.run([sys.executable, "-c", MEASURE, path], cwd=ROOT, capture_output=True, text=True, check=True)
    count, growth_kb = map(int, run.stdout.split())
    assert count == chunks * per_chunk
    assert growth_kb < (150_000 if kind == "overlapping" else 50_000)
