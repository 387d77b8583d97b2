"""Reading and decoding a simulated game: fieldloc beside mcap's own decoded iteration.

mcap reads the same file with json.loads as its decoder and so gets dicts that nobody has checked, where fieldloc gets
checked records. Where mcap-protobuf-support and foxglove-schemas-protobuf are installed, mcap also reads the true poses
as foxglove.PoseInFrame, which is smaller and faster to decode than JSON.
"""

import argparse
import json
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path

from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.records import Schema as SchemaRecord

from benchmarks.timing import fastest_s, table
from fieldloc.measurements import Truth
from logs.reader import LogFile
from logs.reader.container import open_container
from logs.schema import BY_NAME, decode_many
from logs.simulate import load_scenario, simulate

_TOPICS = ("/odometry", "/image_features", "/compass", "/truth")
_WINDOW = 2000  # messages that are decoded together


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(prog="python -m benchmarks reading", description=__doc__)
    parser.add_argument("--duration", type=float, default=600.0, metavar="S", help="length of the game (600)")
    parser.add_argument("--scenario", default="kidsize-game", help="a scenario of fieldloc simulate (kidsize-game)")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="the fastest of N runs counts (3)")
    parser.add_argument("--log", type=Path, help="read this log instead")
    chosen = parser.parse_args(options)
    with tempfile.TemporaryDirectory() as folder:
        log = chosen.log
        if log is None:
            log = Path(folder) / "game.mcap"
            simulate(log, load_scenario(chosen.scenario), seed=0, duration_s=chosen.duration)
        return measure(log, Path(folder), chosen.repeats)


def measure(log: Path, folder: Path, repeats: int = 1) -> str:
    """The table. folder: for files that are needed on the way."""
    counts: dict[str, int] = {}
    for source, count in LogFile(log).sources:
        counts[source.topic] = counts.get(source.topic, 0) + count
    said = [topic for topic in _TOPICS if counts.get(topic)]
    rows = [
        _row(" ".join(topics), sum(counts[t] for t in topics), log, topics, log, _Json(), repeats)
        for topics in (said, *([topic] for topic in said))
    ]
    if counts.get("/truth") and (poses := _as_protobuf(log, folder / "poses.mcap")):
        rows.append(_row("/truth, protobuf", counts["/truth"], log, ["/truth"], *poses, repeats))
    head = ("topics", "messages", "mcap us", "LogFile us", "bare us", "LogFile x", "bare x")
    return "\n".join(
        [
            f"{sum(counts.values())} messages, {log.stat().st_size / 1e6:.1f} MB; us a message, how many times as fast",
            table(head, rows),
        ]
    )


def _row(
    name: str, count: int, log: Path, topics: list[str], other: Path, factory: DecoderFactory, repeats: int
) -> tuple[str, ...]:
    ways: tuple[Callable[[], Iterable[object]], ...] = (
        lambda: _by_mcap(other, topics, factory),
        lambda: LogFile(log).messages(topics),
        lambda: _decoded(log, topics),
    )
    times = fastest_s([partial(_drain, way) for way in ways], repeats)
    theirs, ours, bare = (time / count * 1e6 for time in times)
    return (
        name,
        str(count),
        f"{theirs:.2f}",
        f"{ours:.2f}",
        f"{bare:.2f}",
        f"{theirs / ours:.1f}",
        f"{theirs / bare:.1f}",
    )


def _drain(messages: Callable[[], Iterable[object]]) -> None:
    deque(messages(), maxlen=0)


def _decoded(log: Path, topics: list[str]) -> Iterator[object]:
    """What LogFile is made of: raw messages in windows, each channel's decoded together."""
    container = open_container(log)
    channels = {i: source for i, source in container.sources.items() if source.topic in topics}
    messages = container.messages(channels.keys())
    while window := [*islice(messages, _WINDOW)]:
        datas: dict[int, list[bytes]] = {i: [] for i in channels}
        for message in window:
            datas[message.channel].append(message.data)
        for i, source in channels.items():
            yield from decode_many(BY_NAME[source.schema_name], source.topic, datas[i])


def _by_mcap(log: Path, topics: list[str], factory: DecoderFactory) -> Iterator[object]:
    with log.open("rb") as file:
        yield from make_reader(file, decoder_factories=[factory]).iter_decoded_messages(topics=topics)


class _Json(DecoderFactory):
    def decoder_for(self, message_encoding: str, schema: SchemaRecord | None) -> Callable[[bytes], object] | None:
        return json.loads if message_encoding == "json" else None


def _as_protobuf(log: Path, path: Path) -> tuple[Path, DecoderFactory] | None:
    """The true poses as foxglove.PoseInFrame, and what decodes them; None where that is not installed."""
    try:
        from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
        from mcap_protobuf.decoder import DecoderFactory as Protobuf
        from mcap_protobuf.writer import Writer
    except ImportError:
        return None
    with path.open("wb") as file, Writer(file) as writer:
        for truth in LogFile(log).records(Truth):
            message = PoseInFrame(frame_id="field")
            message.timestamp.FromNanoseconds(truth.stamp_ns)
            message.pose.position.x, message.pose.position.y = truth.pose[:2].tolist()
            message.pose.orientation.w = 1.0
            writer.write_message("/truth", message, truth.stamp_ns, truth.stamp_ns)
    return path, Protobuf()
