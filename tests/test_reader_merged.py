"""Several recordings as one, and any recording by its content."""

import random
from pathlib import Path

import pytest
from mcap_files import DEFINED, END, HEADER, SHARED, channel, chunk_of, message, metadata, put, schema, written

from fieldloc.errors import FieldlocError
from logs.reader.container import open_container
from logs.reader.mcap_container import McapContainer
from logs.reader.merged import Merged


def merged(*paths):
    return Merged([McapContainer(path) for path in paths])


def test_messages_of_all_files_come_in_the_order_of_log_time_and_equal_ones_in_that_of_the_files(tmp_path):
    rng = random.Random(0)
    paths = [
        written(tmp_path / f"{i}.mcap", rng, times=lambda i: rng.randrange(100), count=count)
        for i, count in enumerate([50, 1, 80])
    ]
    both = merged(*paths)
    expected = [
        (both.sources[raw.channel].topic, *raw[1:]) for path in paths for raw in McapContainer(path).messages([1, 2, 3])
    ]
    read = [(both.sources[raw.channel].topic, *raw[1:]) for raw in both.messages(both.sources)]
    assert read == sorted(expected, key=lambda raw: raw[1])
    assert sum(both.counts.values()) == len(read) == 131
    assert both.span_ns == (read[0][1], read[-1][1])
    assert [raw[1] for raw in both.messages(both.sources, 20, 30)] == [t for _, t, *_ in read if 20 <= t < 30]
    assert both.path == paths[0]
    assert len(list(both.attachments())) == 3


def test_the_same_source_in_two_files_is_one_channel_and_a_different_one_is_another(tmp_path):
    first = put(
        tmp_path / "a.mcap", HEADER, schema(1), channel(1, "/t"), channel(2, "/u"), message(1), message(2, 2), END
    )
    second = put(tmp_path / "b.mcap", HEADER, schema(9), channel(7, "/u", 9), channel(2, "/v", 9), message(3, 7), END)
    third = put(tmp_path / "c.mcap", HEADER, schema(1, "other"), channel(1, "/t"), message(4), END)
    both = merged(first, second, third)
    assert [(source.topic, source.schema_name) for source in both.sources.values()] == [
        ("/t", "s"),
        ("/u", "s"),
        ("/v", "s"),
        ("/t", "other"),
    ]
    number = {(source.topic, source.schema_name): number for number, source in both.sources.items()}
    assert both.counts == {number["/t", "s"]: 1, number["/u", "s"]: 2, number["/t", "other"]: 1}
    assert [raw.log_time_ns for raw in both.messages([number["/u", "s"]])] == [2, 3]
    assert [raw.channel for raw in both.messages([number["/t", "other"]])] == [number["/t", "other"]]


def test_metadata_and_damage_say_which_file_they_are_from(tmp_path):
    (tmp_path / "x").mkdir()
    first = put(tmp_path / "a.mcap", DEFINED, metadata("m", a="1"), END)
    second = put(tmp_path / "b.mcap", DEFINED, metadata("m", a="2"), metadata("n", a="3"), message(1))
    third = put(tmp_path / "x" / "b.mcap", DEFINED, metadata("m", a="4"), END)
    both = merged(first, second, third)
    assert both.metadata == {"m": {"a": "1"}, "m (b.mcap)": {"a": "2"}, "n": {"a": "3"}, f"m ({third})": {"a": "4"}}
    (sentence,) = both.damage
    assert sentence.startswith("b.mcap: cut off")


def test_the_parts_of_a_split_recording_are_opened_one_after_the_other(tmp_path):
    class Watched(McapContainer):
        def messages(self, *arguments):
            opened.append(self.path.name)
            yield from super().messages(*arguments)

    opened = []
    parts = [
        Watched(put(tmp_path / f"{i}.mcap", DEFINED, chunk_of(range(10 * i, 10 * i + 10)), END)) for i in (2, 0, 1)
    ]
    read = Merged(parts).messages([1])
    assert [next(read).log_time_ns for _ in range(11)] == list(range(11))
    assert opened == ["0.mcap", "1.mcap"]
    assert [raw.log_time_ns for raw in read] == list(range(11, 30))


def test_at_an_instant_that_two_parts_share_the_order_is_that_of_the_files(tmp_path):
    early = put(tmp_path / "early.mcap", DEFINED, message(1), message(5, sequence=1), END)
    late = put(tmp_path / "late.mcap", DEFINED, message(5, sequence=2), message(9), END)
    assert [raw.sequence for raw in merged(early, late).messages([1])] == [0, 1, 2, 0]
    assert [raw.sequence for raw in merged(late, early).messages([1])] == [0, 2, 1, 0]


def test_files_without_messages_and_no_files_at_all(tmp_path):
    empty = put(tmp_path / "a.mcap", DEFINED, END)
    both = merged(empty, empty)
    assert both.span_ns is None
    assert list(both.messages(both.sources)) == []
    with pytest.raises(ValueError, match="nothing to merge"):
        Merged([])


def test_an_mcap_file_is_known_by_its_content_not_its_name(tmp_path):
    container = open_container(put(tmp_path / "log.bag", DEFINED, message(1), END))
    assert isinstance(container, McapContainer)
    with pytest.raises(FieldlocError, match="not an MCAP file"):
        McapContainer(Path(__file__))


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"{SHARED} is missing: other people's bags")
def test_a_ros_1_bag_is_a_container_too():
    container = open_container(SHARED / "sparkfun_razor.bag")
    assert not isinstance(container, McapContainer)
    assert len(list(container.messages(container.sources))) == sum(container.counts.values()) > 0


def test_a_folder_is_a_bag_only_with_its_metadata(tmp_path):
    with pytest.raises(FieldlocError, match="is a directory; give"):
        open_container(tmp_path)
    (tmp_path / "metadata.yaml").write_text("nonsense: [")
    with pytest.raises(FieldlocError):
        open_container(tmp_path)
