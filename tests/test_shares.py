"""The hypotheses of a run as arrays to be drawn, and the report's picture of them."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from real_logs import sample_messages, write
from two_minds import InTwoMinds, ambiguity

from estimators.base import Ambiguity, Event
from estimators.config import Config
from estimators.ekf import Ekf
from logs.comparison import compare
from logs.estimates import write_estimates
from logs.one_run import score_runs
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.report import write_report
from logs.report.hypotheses_picture import hypotheses_picture
from logs.report.moments import moments, span_ns
from logs.results import RunResult, metrics_document
from logs.shares import COLOURS, shares
from logs.table import log_table
from logs.table_text import format_table
from logs.trajectory import Trajectory

SECOND = 10**9
TENTH = SECOND // 10


def drawn(figure: Figure, axes: int) -> list[PolyCollection]:
    return [one for one in figure.axes[axes].collections if isinstance(one, PolyCollection)]


def area(collection: PolyCollection) -> float:
    """Of all its polygons, by the shoelace formula."""
    out = 0.0
    for path in collection.get_paths():
        x, y = np.asarray(path.vertices)[:-1].T
        out += 0.5 * abs(float(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))))
    return out


def test_shares_add_up_to_one() -> None:
    said = [ambiguity(0, {1: 0.5, 2: 0.2, 3: 0.01}, lost=0.2), ambiguity(1, {2: 0.3}, lost=0.7), ambiguity(2, {}, 0, 1)]
    found = shares(said)
    assert found.tracks.tolist() == [1, 2]
    np.testing.assert_allclose(found.weights, [[0.5, 0.2], [0.0, 0.3], [0.0, 0.0]])
    np.testing.assert_allclose(found.rest, [0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(found.weights.sum(axis=1) + found.rest + found.lost, 1.0)
    assert found.lives() == [(0, 0), (0, 1)]


def test_tracks_stand_in_the_order_of_their_beginnings() -> None:
    said = [ambiguity(0, {9: 1.0}), ambiguity(1, {9: 0.5, 4: 0.3, 7: 0.2}), ambiguity(2, {4: 0.6, 1: 0.4})]
    assert shares(said).tracks.tolist() == [9, 4, 7, 1]


def test_tracks_that_live_at_the_same_time_have_different_colours() -> None:
    random = np.random.default_rng(0)
    said = []
    for i in range(300):  # each begins ten steps after the last and lives for at most 70: no more than 7 at a time
        alive = [t for t in range(30) if 10 * t <= i < 10 * t + 20 + (37 * t) % 50]
        weights = random.dirichlet(np.ones(len(alive))) if alive else []
        said.append(ambiguity(i, dict(zip(alive, 0.06 + 0.5 * np.asarray(weights), strict=True))))
    found = shares(said)
    assert len(found.tracks) == 30
    assert set(found.colours.tolist()) == set(range(COLOURS))
    for row in found.weights:
        colours = found.colours[row > 0]
        assert len(set(colours.tolist())) == len(colours)


def test_of_a_long_run_no_flip_is_left_out() -> None:
    said = [ambiguity(i * TENTH, {1: 1.0}, 1.0 if i == 7777 else 0.0) for i in range(36_000)]
    found = shares(said)
    assert len(found.stamps_ns) <= 1502
    assert found.mirrored.max() == 1.0
    assert (found.stamps_ns[0], found.stamps_ns[-1]) == (0, 35_999 * TENTH)
    assert (np.diff(found.stamps_ns) > 0).all()


def test_many_tracks_are_not_all_drawn_and_still_add_up() -> None:
    said = [ambiguity(i, {3 * i + k: 0.3 for k in range(3)}, lost=0.1) for i in range(400)]
    found = shares(said)
    assert len(found.tracks) == 150
    np.testing.assert_allclose(found.weights.sum(axis=1) + found.rest + found.lost, 1.0)


def story() -> list[Ambiguity]:
    """Ten seconds: two sides, from the fifth second on one."""
    return [ambiguity(i * TENTH, {1: 0.5, 2: 0.5} if i < 50 else {1: 1.0}, 0.5 if i < 50 else 0.0) for i in range(101)]


EVENTS = (
    Event(0, "start", "found"),
    Event(TENTH, "split", "in two"),
    Event(2 * TENTH, "split", "in two again"),
    Event(3 * TENTH, "merge", "one less"),
    Event(5 * SECOND, "decision", "one side"),
    Event(8 * SECOND, "recovery", "elsewhere"),
)


def test_the_picture_shows_each_weight_as_long_as_it_held() -> None:
    figure = hypotheses_picture("mixture", story(), EVENTS, 0, 10 * SECOND)
    one, two, others, lost = drawn(figure, 1)
    assert area(one) == pytest.approx(0.5 * 5 + 1.0 * 5, rel=1e-6)
    assert area(two) == pytest.approx(0.5 * 5, rel=1e-6)
    for polygon, span_s in ((one, (0.0, 10.0)), (two, (0.0, 5.0))):
        x = np.concatenate([np.asarray(path.vertices)[:, 0] for path in polygon.get_paths()])
        assert (x.min(), x.max()) == pytest.approx(span_s, abs=1e-6)
    assert area(others) == area(lost) == pytest.approx(0.0, abs=1e-12)
    (mirrored,) = drawn(figure, 2)
    assert area(mirrored) == pytest.approx(0.5 * 5, rel=1e-6)


def test_events_are_marked_where_they_happened() -> None:
    figure = hypotheses_picture("mixture", story(), EVENTS, 0, 10 * SECOND)
    marks = [np.asarray(line.get_xdata()).tolist() for line in figure.axes[0].lines]
    assert marks == [[0.0], [0.1, 0.2], [0.3], [5.0], [8.0]]  # by kind
    through = sorted(float(np.asarray(line.get_xdata())[0]) for line in figure.axes[1].lines)
    assert through == [0.0, 5.0, 8.0]  # those that matter go through the panels
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["start", "split (2)", "merge", "decision", "recovery"]


def test_where_nothing_looks_the_same_there_is_no_panel_for_it() -> None:
    asymmetric = [replace(one, mirrored=0.0) for one in story()]
    assert len(hypotheses_picture("mixture", asymmetric, (), 0, 10 * SECOND).axes) == 2
    assert len(hypotheses_picture("mixture", story(), (), 0, 10 * SECOND).axes) == 3


def test_one_ambiguity_is_a_picture_too() -> None:
    figure = hypotheses_picture("mixture", [ambiguity(5, {}, lost=1.0)], (), 5, 5)
    assert area(drawn(figure, 1)[-1]) > 0.0


def test_hypotheses_are_in_the_report_of_a_comparison_and_of_its_file(tmp_path: Path) -> None:
    log = LogFile(write(tmp_path / "yard.mcap", sample_messages(20.0)))
    compared = compare(log, {"ekf": Ekf, "minds": InTwoMinds}, Config()).scored
    recording = load_recording(log)
    metadata = {"estimator": "minds", "log": "yard.mcap"}
    write_estimates(tmp_path / "result.mcap", recording, replay(recording, InTwoMinds(Config())), metadata)
    reported = score_runs([LogFile(tmp_path / "result.mcap")], truth=log)
    for name, scored in (("compared", compared), ("reported", reported)):
        page = write_report(tmp_path / name, [scored]).read_text()
        assert (tmp_path / name / "yard-minds-hypotheses.png").exists()
        assert not (tmp_path / name / "yard-ekf-hypotheses.png").exists()
        assert page.count("minds: hypotheses over time") == 2  # alt text and caption
        assert page.count("<summary>minds: 2 moments</summary>") == page.count("<summary>") == 1
        assert re.search(r"<dt>\d+\.\d\d s decision</dt><dd>it is not the half turn</dd>", page)
        document = json.loads((tmp_path / name / "metrics.json").read_text())
        runs = document["logs"][0]["estimators"]
        assert runs["minds"]["mirrored"] == 0.01
    assert "mirrored" not in metrics_document([compared])["logs"][0]["estimators"]["ekf"]  # type: ignore[index,call-overload]


def test_moments_are_told_on_the_time_axis_of_the_pictures() -> None:
    run = RunResult("m <1>", Trajectory(np.zeros(0, np.int64), np.zeros((0, 3))), np.zeros(0), 0.0, (*story(),), EVENTS)
    truth = Trajectory(np.array([-SECOND, SECOND]), np.zeros((2, 3)))
    assert (span_ns(run, truth), span_ns(run, None)) == ((-SECOND, SECOND), (0, 10 * SECOND))
    assert "<summary>m &lt;1&gt;: 3 moments</summary>" in moments(run, truth)
    for truth_, told in ((truth, "9.00 s recovery"), (None, "8.00 s recovery")):
        assert f"<dt>{told}</dt><dd>elsewhere</dd>" in moments(run, truth_)
    assert moments(replace(run, events=EVENTS[1:4]), truth) == ""


def test_the_last_column_of_a_comparison_is_how_likely_the_other_side_is(tmp_path: Path) -> None:
    log = LogFile(write(tmp_path / "yard.mcap", sample_messages(20.0)))
    both = compare(log, {"ekf": Ekf, "minds": InTwoMinds}, Config()).scored
    table = log_table(both)
    assert table.headings[-1] == ("mirrored", "at end")
    assert [row[-1].text for row in table.rows] == ["-", "0.010"]
    sure = compare(log, {"ekf": Ekf}, Config()).scored
    assert log_table(sure).headings == table.headings[:-1]  # nothing to say, no column
    assert "mirrored" not in format_table([sure])
