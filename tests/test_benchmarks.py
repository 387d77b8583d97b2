"""The benchmarks run; how fast things are is for people to read."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import pareto
from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.timing import fastest_s, table
from estimators.ekf import Ekf
from fieldloc import pose as se2
from fieldloc.field import load_field
from logs.samples import sample_path
from logs.trajectory import Trajectory


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("reading", ["--duration", "3", "--repeats", "1"], ["/odometry", "/image_features", "/truth", "mcap us"]),
        ("writing", ["--messages", "50", "--repeats", "1"], ["LogWriter.write_raw", "mcap.writer.Writer"]),
        ("mixtures", ["--count", "2", "--repeats", "1"], ["image", "scan", "asked", "100 products"]),
        ("vision", ["--what", "views", "--count", "2", "--fields", "spl"], ["telling", "ANEES", "posts recall"]),
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


class Told(Ekf):
    """Takes any solution, the nearest to where it is."""

    def start_in(self, region, stamp_ns):
        pass

    def observe(self, mixture):
        solutions = mixture.solutions()
        if len(solutions.poses):
            for factor in mixture.chosen(int(solutions.ids[np.argmax(solutions.log_weights)])):
                self.update(factor)


@pytest.fixture
def told(monkeypatch):
    monkeypatch.setattr(pareto, "ALL", {"mixture": Told, "particles": Told})


def test_what_accuracy_costs_is_told_and_drawn(told, tmp_path, capsys):
    options = ["--duration", "3", "--after", "1", "--caps", "1,2", "--counts", "100", "--seeds", "2"]
    assert main(["pareto", *options, str(sample_path("woods")), "--out", str(tmp_path / "cost.png")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines[2:]] == [
        "mixture 1", "mixture 2", "particles 100", "particles, adaptive 100",
    ]  # fmt: skip
    whole_us, alone_us, error_m, first_s = map(float, lines[2].split()[2:6])
    assert whole_us > alone_us > 0
    assert error_m < 0.2
    assert first_s == pytest.approx(0.0, abs=1.0)
    assert (tmp_path / "cost.png").read_bytes().startswith(b"\x89PNG")


def test_which_of_two_sides_that_look_the_same_is_no_error():
    soccer = load_field("kidsize")
    yard = replace(soccer, landmarks=soccer.landmarks[:1], crossbars=())  # one post: no half turn of it is the same
    stamps_ns = 10**8 * np.arange(100)
    truth = np.random.default_rng(0).normal(size=(100, 3))
    turned = se2.compose(np.array([0.0, 0.0, np.pi]), truth)
    flipping = np.where((stamps_ns > 5 * 10**9)[:, None], turned, truth) + [0.03, 0.04, 0.0]
    poses = Trajectory(stamps_ns, flipping), Trajectory(stamps_ns, truth)
    assert pareto.error_m(*poses, soccer) == pytest.approx(0.05)
    assert pareto.error_m(*poses, yard) > 1.0


def test_a_mixture_costs_as_many_times_less_as_the_cheapest_particles_that_are_as_good():
    sizes = pareto.all_sizes([8], [10, 1000], 1)
    assert [(size.series, size.label) for size in sizes] == [
        ("mixture", "8"),
        *[(series, count) for series in ("particles", "particles, adaptive") for count in ("10", "1000")],
    ]
    counts = [(size.configs[0].particles.count, size.configs[0].particles.max_count) for size in sizes[1:]]
    assert counts == [(10, 10), (1000, 1000), (1, 10), (100, 1000)]
    outcomes = [
        pareto.Outcome(whole_s, alone_s, error_m, 0.0)
        for whole_s, alone_s, error_m in [
            (2e-3, 1e-3, 0.10), (1e-3, 1e-4, 0.20), (9e-3, 8e-3, 0.104), (1e-3, 1e-4, 0.20), (6e-3, 5e-3, 0.09),
        ]
    ]  # fmt: skip
    best = pareto.told(sizes, outcomes).splitlines()[1].split()
    assert best == ["mixture", "8", "2000", "1000", "0.1000", "0.0", "3.0", "5.0"]
    worse = [outcomes[0], *[replace(one, error_m=1.0) for one in outcomes[1:]]]
    assert pareto.told(sizes, worse).splitlines()[1].split()[-4:] == [">", "4.5", ">", "8.0"]


def test_works_take_turns_and_the_fastest_of_each_counts():
    turns = []
    times = fastest_s([lambda: turns.append("a"), lambda: turns.append("b")], 3)
    assert turns == ["a", "b"] * 3
    assert len(times) == 2
    assert all(0 <= time < 1 for time in times)


def test_a_table_has_its_columns_in_line():
    assert table(("x", "long"), [("name", "1")]) == "x     long\nname     1"
