"""Writing small messages: fieldloc's writer beside mcap's, and what it costs to make the messages from records."""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from benchmarks.timing import fastest_s, table
from fieldloc.measurements import Odometry
from logs.schema import encode
from logs.source import Source
from logs.writer import LogWriter

_SOURCE = Source("/odometry", "json", "odometry", "jsonschema", b"{}")
_CHUNK_BYTES = 256 * 1024


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(prog="python -m benchmarks writing", description=__doc__)
    parser.add_argument("--messages", type=int, default=100_000, metavar="N", help="so many (100000)")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="the fastest of N runs counts (3)")
    chosen = parser.parse_args(options)
    random = np.random.default_rng(0)
    covariance = np.diag([0.01, 0.01, 0.02])
    velocities = random.normal(size=(chosen.messages, 3))
    records = [Odometry(i * 10**7, velocity, covariance) for i, velocity in enumerate(velocities)]
    datas = [encode(record) for record in records]
    with tempfile.TemporaryDirectory() as folder:
        works = (
            lambda: _by_mcap(Path(folder) / "theirs.mcap", datas),
            lambda: _raw(Path(folder) / "ours.mcap", datas),
            lambda: _records(Path(folder) / "ours.mcap", records),
        )
        theirs, ours, whole = (time / chosen.messages * 1e6 for time in fastest_s(works, chosen.repeats))
    rows = (
        ("mcap.writer.Writer.add_message", f"{theirs:.2f}", ""),
        ("LogWriter.write_raw", f"{ours:.2f}", f"{theirs / ours:.1f}"),
        ("LogWriter.write, checked and encoded", f"{whole:.2f}", f"{theirs / whole:.1f}"),
    )
    return table(("odometry", "us a message", "times as fast"), rows)


def _by_mcap(path: Path, datas: list[bytes]) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=_CHUNK_BYTES)
        writer.start()
        schema = writer.register_schema("odometry", "jsonschema", b"{}")
        channel = writer.register_channel("/odometry", "json", schema)
        for i, data in enumerate(datas):
            writer.add_message(channel, i, data, i, i)
        writer.finish()  # type: ignore[no-untyped-call]


def _raw(path: Path, datas: list[bytes]) -> None:
    with LogWriter(path) as log:
        for i, data in enumerate(datas):
            log.write_raw(_SOURCE, i, data)


def _records(path: Path, records: list[Odometry]) -> None:
    with LogWriter(path) as log:
        for record in records:
            log.write("/odometry", record)
