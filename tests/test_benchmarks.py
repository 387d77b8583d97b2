"""The benchmarks run; how fast things are is for people to read."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.timing import fastest_s, table


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("reading", ["--duration", "3", "--repeats", "1"], ["/odometry", "/image_features", "/truth", "mcap us"]),
        ("writing", ["--messages", "50", "--repeats", "1"], ["LogWriter.write_raw", "mcap.writer.Writer"]),
    ],
)
def test_a_benchmark_prints_its_table(capsys, name, options, said):
    assert main([name, *options]) == 0
    text = capsys.readouterr().out
    assert [word for word in said if word not in text] == []
    assert {"reading", "writing"} <= set(BENCHMARKS)


def test_without_a_name_they_are_listed(capsys):
    assert main([]) == 0
    assert main(["nonsense"]) == 2
    assert capsys.readouterr().out.count("reading: Reading and decoding") == 2


def test_they_run_from_the_top_of_the_repository():
    root = Path(__file__).parents[1]
    done = subprocess.run([sys.executable, "-m", "benchmarks"], cwd=root, capture_output=True, text=True, check=True)
    assert "writing" in done.stdout


def test_works_take_turns_and_the_fastest_of_each_counts():
    turns = []
    times = fastest_s([lambda: turns.append("a"), lambda: turns.append("b")], 3)
    assert turns == ["a", "b"] * 3
    assert len(times) == 2
    assert all(0 <= time < 1 for time in times)


def test_a_table_has_its_columns_in_line():
    assert table(("x", "long"), [("name", "1")]) == "x     long\nname     1"
