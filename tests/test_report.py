import json
import re
import subprocess
import sys
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from fieldloc.covariance import squared_mahalanobis
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark
from fieldloc.pose import FloatArray
from logs.report import write_report
from logs.report.error_picture import error_picture
from logs.report.field_picture import field_picture
from logs.results import LogResult, RunResult, ScoredLog, metrics_document, score
from logs.table import log_table, summary_table
from logs.table_text import format_columns, format_metrics, format_table
from logs.thinning import breaks, extremes, path
from logs.trajectory import Trajectory

FIELD = FieldMap(
    "yard",
    np.array([[[-4.0, -3.0], [4.0, -3.0]], [[-4.0, 3.0], [4.0, 3.0]]]),
    np.array([[0.0, 0.0, 0.75]]),
    (Landmark("a", np.array([4.0, 1.0]), 0.1, np.zeros((2, 2))), Landmark("b", np.array([-4.0, 1.0]), 0.1, np.eye(2))),
)
COLOURS = {"good": "#0072B2", "poor": "#D55E00", "lost": "#009E73"}


def circle(n: int = 400, gap: slice | None = None) -> Trajectory:
    angle = np.linspace(0, 4 * np.pi, n)
    poses = np.column_stack([2 * np.cos(angle), 2 * np.sin(angle), (angle + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi])
    stamps_ns = 1_700_000_000_000_000_000 + 100_000_000 * np.arange(n, dtype=np.int64)
    kept = np.ones(n, dtype=bool)
    if gap is not None:
        kept[gap] = False
    return Trajectory(stamps_ns[kept], poses[kept])


def off_by(truth: Trajectory, sigma: float, claimed: float, seed: int = 0) -> Trajectory:
    error = np.random.default_rng(seed).normal(0, sigma, truth.poses.shape)
    return Trajectory(truth.stamps_ns, truth.poses + error, np.tile(claimed**2 * np.eye(3), (len(truth), 1, 1)))


def nothing() -> Trajectory:
    return Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def example(name: str = "yard", truth: Trajectory | None = None, lost: bool = True) -> LogResult:
    truth = circle() if truth is None else truth
    runs = [
        RunResult("good", off_by(truth, 0.02, 0.02), np.array([0.001, 0.002, 0.003]), 2.0),
        RunResult("poor", off_by(truth, 0.2, 0.05, seed=1), np.zeros(0), 0.5),
    ]
    if lost:
        runs.append(RunResult("lost", nothing(), np.zeros(0), 0.1))
    return LogResult(name, 40.0, FIELD, truth, tuple(runs))


# -- metrics.json ------------------------------------------------------------------------------------------------------


def test_the_document_holds_every_metric_the_timings_and_why_a_run_has_none() -> None:
    scored = score(example())
    (log,) = json.loads(json.dumps(metrics_document([scored]), allow_nan=False))["logs"]
    assert (log["log"], log["duration_s"], list(log["estimators"])) == ("yard", 40.0, ["good", "poor", "lost"])
    good, poor, lost = log["estimators"].values()
    metrics = scored.runs[0].metrics
    assert metrics is not None
    assert metrics.to_dict().items() <= good.items()
    assert (good["updates"], good["update_median_s"], good["log_time_per_total_time"]) == (3, 0.002, 20.0)
    assert good["update_p99_s"] == pytest.approx(0.00298)
    assert (poor["update_median_s"], poor["update_p99_s"]) == (None, None)
    assert "no estimates" in lost["note"]
    assert "ate_rmse_m" not in lost


def test_every_key_of_the_document_is_in_the_documentation() -> None:
    documented = set(re.findall(r"`(\w+)`", (Path(__file__).parents[1] / "docs" / "metrics.md").read_text("utf-8")))
    (log,) = json.loads(json.dumps(metrics_document([score(example())])))["logs"]
    keys = set(log) | set(log["estimators"]["good"]) | set(log["estimators"]["lost"])
    assert keys - documented == set()


# -- tables ------------------------------------------------------------------------------------------------------------


def test_the_best_of_a_column_is_the_most_honest_or_the_smallest_and_a_run_without_metrics_is_a_dash() -> None:
    table = log_table(score(example()))
    titles = [" ".join(heading).strip() for heading in table.headings]
    good, poor, lost = (dict(zip(titles, row, strict=True)) for row in table.rows)
    for title in ("ATE [m] RMSE", "heading [deg] RMSE", "ANEES (95 % band) mean", "3 sigma [%]"):
        assert good[title].is_best, title
        assert not poor[title].is_best, title
    assert lost["ATE [m] max"].text == "-"
    assert lost["total [s]"].text == "0.10"
    assert [good["update [ms] median"].text, good["update [ms] p99"].text, good["log time / total"].text] == [
        "2.00",
        "2.98",
        "20",
    ]


def test_text_columns_are_aligned_under_their_headings() -> None:
    lines = format_columns(log_table(score(example()))).splitlines()
    assert len(lines) == 5
    assert len({len(line) for line in lines[1:]}) == 1
    end = lines[1].index("RMSE") + len("RMSE")
    for line in lines[2:]:
        assert line[end - 1] != " "
        assert line[end : end + 2] == "  "
    assert lines[0].index("ATE [m]") + len("ATE [m]") == lines[1].index("max") + len("max")


def test_the_terminal_table_names_every_log_and_says_why_a_run_is_missing() -> None:
    text = format_table([score(example("first")), score(example("second", lost=False))])
    assert "first: 40.0 s, 400 true poses" in text
    assert "lost: no estimates to compare" in text
    assert "all 2 logs" in text
    assert text.isascii()  # also a terminal without UTF-8 shows it


def test_the_table_over_all_logs_averages_what_could_be_compared() -> None:
    logs = [score(example("first")), score(example("second", circle(200), lost=False))]
    table = summary_table(logs)
    assert table is not None
    titles = [" ".join(heading).strip() for heading in table.headings]
    rows = {row[0].text: dict(zip(titles, (cell.text for cell in row), strict=True)) for row in table.rows}
    rmse = [m.ate_m.rmse for log in logs if (m := log.runs[0].metrics)]
    assert rows["good"]["ATE RMSE [m] mean"] == f"{np.mean(rmse):.3f}"
    assert rows["good"]["ATE RMSE [m] worst"] == f"{max(rmse):.3f}"
    assert (rows["lost"]["logs compared"], rows["lost"]["logs of"], rows["lost"]["ATE [m] max"]) == ("0", "1", "-")
    assert summary_table(logs[:1]) is None


def test_an_estimator_that_failed_on_a_log_is_never_the_best_over_all() -> None:
    truth = circle()
    first = LogResult("first", 40.0, None, truth, (RunResult("good", nothing(), np.zeros(0), 1.0), *example().runs[1:]))
    table = summary_table([score(example("second")), score(first)])
    assert table is not None
    best = {row[0].text: any(cell.is_best for cell in row) for row in table.rows}
    assert best == {"good": False, "poor": True, "lost": False}


def test_one_evaluation_reads_as_lines() -> None:
    metrics = score(example()).runs[1].metrics
    assert metrics is not None
    text = format_metrics(metrics)
    assert f"RMSE {metrics.ate_m.rmse:.4f} m" in text
    assert "400 pairs of 400 estimates and 400 true poses; 100.0 % of the truth's time" in text
    assert text.isascii()


# -- thinning ----------------------------------------------------------------------------------------------------------


def test_thinned_values_keep_every_stretch_s_extremes_and_both_ends_of_time() -> None:
    values = np.random.default_rng(3).normal(size=10_007)
    values[[17, 5003]] = [40.0, -50.0]
    kept = extremes(values, 100)
    assert len(kept) <= 2 * 100 + 7
    assert {17, 5003} <= set(kept.tolist())
    assert np.all(np.diff(kept) > 0)
    for start in range(0, 10_000, 100):
        inside = kept[(kept >= start) & (kept < start + 100)]
        assert values[inside].max() == values[start : start + 100].max()
        assert values[inside].min() == values[start : start + 100].min()


def test_few_values_stay_as_they_are() -> None:
    assert extremes(np.arange(150.0), 100).tolist() == list(range(150))
    assert extremes(np.zeros(0), 100).tolist() == []


def test_a_thinned_path_stays_within_a_cell_of_every_position() -> None:
    positions = np.cumsum(np.random.default_rng(4).normal(0, 0.002, (5000, 2)), axis=0)
    kept = path(positions, 0.05)
    assert len(kept) < 1000
    assert (kept[0], kept[-1]) == (0, 4999)
    last_kept = kept[np.searchsorted(kept, np.arange(5000), side="right") - 1]
    assert np.abs(positions - positions[last_kept]).max() < 0.05
    assert path(np.zeros((0, 2)), 0.05).tolist() == []


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [([0, 1, 2, 3], []), ([0, 1, 2, 60, 61], [3]), ([0, 30, 60, 90], []), ([5], []), ([], [])],
)
def test_a_line_breaks_where_poses_are_missing_not_where_they_are_sparse(
    seconds: list[int], expected: list[int]
) -> None:
    assert breaks(np.array(seconds, dtype=np.int64) * 10**9).tolist() == expected


# -- pictures ----------------------------------------------------------------------------------------------------------


def covariance_example() -> tuple[FloatArray, Trajectory]:
    covariance = np.array([[0.04, 0.03, 0.0], [0.03, 0.09, 0.0], [0.0, 0.0, 0.01]])
    truth = circle(5)
    return covariance, Trajectory(truth.stamps_ns, truth.poses, np.tile(covariance, (5, 1, 1)))


def test_ellipses_are_where_the_mahalanobis_distance_is_three() -> None:
    covariance, estimate = covariance_example()
    log = LogResult("yard", 1.0, FIELD, circle(5), (RunResult("good", estimate, np.zeros(0), 1.0),))
    (axes,) = field_picture(score(log), COLOURS).axes
    outlines: list[NDArray[np.float64]] = []
    for collection in axes.collections:
        if isinstance(collection, PolyCollection):
            outlines += [np.asarray(p.vertices)[:-1] for p in collection.get_paths()]
    assert len(outlines) == 5
    for vertices in outlines:
        centre = estimate.poses[
            np.argmin(np.linalg.norm(estimate.poses[:, :2] - vertices[:-1].mean(axis=0), axis=1)), :2
        ]
        distance = squared_mahalanobis(vertices - centre, np.broadcast_to(covariance[:2, :2], (len(vertices), 2, 2)))
        np.testing.assert_allclose(distance, 9.0, rtol=1e-9)


def test_the_field_is_drawn_to_scale_with_units_and_every_run_has_a_panel() -> None:
    figure = field_picture(score(example()), COLOURS)
    assert [axes.get_title(loc="left").split(":")[0] for axes in figure.axes] == ["good", "poor", "lost"]
    assert figure.axes[0].get_ylabel() == "y [m]"
    assert figure.axes[-1].get_xlabel() == "x [m]"
    for axes in figure.axes:
        box, (x0, x1), (y0, y1) = axes.get_window_extent(), axes.get_xlim(), axes.get_ylim()
        assert box.width / (x1 - x0) == pytest.approx(box.height / (y1 - y0), rel=1e-6)
        assert x0 < -4 < 4 < x1
        assert y0 < -3 < 3 < y1


def test_an_estimate_far_astray_does_not_shrink_the_field_to_a_dot() -> None:
    truth = circle()
    astray = Trajectory(truth.stamps_ns, truth.poses + [500.0, 0.0, 0.0])
    log = LogResult("yard", 40.0, FIELD, truth, (RunResult("good", astray, np.zeros(0), 1.0),))
    (axes,) = field_picture(score(log), COLOURS).axes
    assert axes.get_xlim()[1] < 10


def test_the_error_picture_shows_the_largest_error_and_says_its_units() -> None:
    truth = circle()
    estimate = off_by(truth, 0.02, 0.02)
    estimate.poses[123] += [0.0, 7.0, 0.0]
    run = score(LogResult("yard", 40.0, None, truth, (RunResult("good", estimate, np.zeros(0), 1.0),))).runs[0]
    assert run.errors is not None
    assert run.metrics is not None
    x, y, heading, nees = error_picture("good", run.errors, run.metrics, truth, "#0072B2").axes
    assert [axes.get_ylabel() for axes in (x, y, heading, nees)] == [
        "x error [m]",
        "y error [m]",
        "heading error [°]",
        "NEES",
    ]
    assert nees.get_xlabel() == "time since the first true pose [s]"
    assert max(np.max(np.asarray(line.get_ydata(), dtype=float)) for line in y.lines) == pytest.approx(7.0, abs=0.1)
    assert y.get_ylim()[1] > 7.0
    assert x.get_ylim()[1] < 0.5
    assert nees.get_ylim()[1] > run.metrics.consistency.anees if run.metrics.consistency else False


def test_bands_are_three_claimed_sigmas_and_headings_are_in_degrees() -> None:
    truth = circle()
    sigmas = np.array([0.1, 0.2, 0.3])
    poses = truth.poses + np.array([0.05, -0.1, 0.15])
    estimate = Trajectory(truth.stamps_ns, poses, np.tile(np.diag(sigmas**2), (len(truth), 1, 1)))
    run = only(RunResult("good", estimate, np.zeros(0), 1.0), truth).runs[0]
    assert run.errors is not None
    assert run.metrics is not None
    axes = error_picture("good", run.errors, run.metrics, truth, "#0072B2").axes
    for panel, sigma, unit in zip(axes, sigmas, (1.0, 1.0, np.degrees(1.0)), strict=False):
        (band,) = [c for c in panel.collections if isinstance(c, PolyCollection)]
        outline = np.asarray(band.get_paths()[0].vertices)[:, 1]
        assert (outline.min(), outline.max()) == pytest.approx((-3 * sigma * unit, 3 * sigma * unit))
        drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in panel.lines])
        assert np.abs(drawn).max() == pytest.approx(0.5 * sigma * unit)


# -- the report --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", autouse=True)
def coarse_pictures() -> Iterator[None]:
    """Drawn in a tenth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("logs.report.DPI", 30)
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory, coarse_pictures: None) -> Path:
    directory = tmp_path_factory.mktemp("report") / "out"
    write_report(directory, [score(example("first")), score(example("second", circle(400, slice(100, 200))))])
    return directory


def test_the_report_has_its_page_its_numbers_and_its_pictures(report: Path) -> None:
    assert sorted(p.name for p in report.iterdir()) == [
        *("first-field.png", "first-good-errors.png", "first-poor-errors.png"),
        *("metrics.json", "report.html"),
        *("second-field.png", "second-good-errors.png", "second-poor-errors.png"),
    ]
    assert [log["log"] for log in json.loads((report / "metrics.json").read_text("utf-8"))["logs"]] == [
        "first",
        "second",
    ]


def test_the_page_holds_every_picture_and_loads_nothing(report: Path) -> None:
    page = (report / "report.html").read_text("utf-8")
    for picture in report.glob("*.png"):
        data = picture.read_bytes()
        assert data.startswith(b"\x89PNG")
        assert b64encode(data).decode("ascii") in page
    assert page.count("<img") == 6
    assert page.count('src="data:image/png;base64,') == page.count("src=") == 6
    for loader in ("http:", "https:", "<script", "<link", "@import", "url("):
        assert loader not in page


def test_names_from_outside_stay_text_and_stay_inside_the_directory(tmp_path: Path) -> None:
    log = example("../../<script>alert(1)</script>&")
    write_report(tmp_path / "out", [score(log)])
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "<script>" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;&amp;" in page
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "script-alert-1-script-field.png").exists()


def test_logs_of_equal_name_keep_their_own_pictures(tmp_path: Path) -> None:
    logs = [score(example("log.mcap", truth, lost=False)) for truth in (circle(), circle(100))]
    write_report(tmp_path, logs)
    fields = sorted(tmp_path.glob("*-field.png"))
    assert [p.name for p in fields] == ["1-log.mcap-field.png", "2-log.mcap-field.png"]
    assert fields[0].read_bytes() != fields[1].read_bytes()


def test_a_log_without_truth_shows_trajectories_and_timings_only(tmp_path: Path) -> None:
    with_truth = example(lost=False)
    log = LogResult("blind", 40.0, None, None, with_truth.runs)
    scored = score(log)
    write_report(tmp_path, [scored])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blind-field.png", "metrics.json", "report.html"]
    assert "no truth: trajectories only" in (tmp_path / "report.html").read_text("utf-8")
    assert "blind: 40.0 s, no truth" in format_table([scored])
    assert "ATE" not in format_table([scored])


def only(run: RunResult, truth: Trajectory | None, field: FieldMap | None = None) -> ScoredLog:
    return score(LogResult("odd", 0.0, field, truth, (run,)))


def with_covariance(value: float) -> Trajectory:
    truth = circle(20)
    covariances = np.tile(0.01 * np.eye(3), (20, 1, 1))
    covariances[7] = np.diag([value] * 3)
    return Trajectory(truth.stamps_ns, truth.poses + 0.01, covariances)


@pytest.mark.parametrize(
    "scored",
    [
        ScoredLog(LogResult("odd", 0.0, None, None, ()), ()),
        only(RunResult("good", nothing(), np.zeros(0), 0.0), None),
        only(RunResult("good", nothing(), np.zeros(0), 0.0), circle(10), FIELD),
        only(RunResult("good", circle(1), np.zeros(0), 0.0), circle(1)),
        only(RunResult("good", circle(10), np.zeros(0), 0.0), circle(10)),  # no covariances, no errors
        only(RunResult("good", with_covariance(np.inf), np.zeros(0), 0.0), circle(20)),
        only(RunResult("good", with_covariance(0.0), np.zeros(0), 0.0), circle(20)),
        only(RunResult("good", with_covariance(-1.0), np.zeros(0), 0.0), circle(20)),
        only(RunResult("good", with_covariance(1e9), np.zeros(0), 0.0), circle(20)),
    ],
)
def test_odd_results_still_make_a_report(scored: ScoredLog, tmp_path: Path) -> None:
    page = write_report(tmp_path, [scored])
    assert "odd" in page.read_text("utf-8")
    assert "odd: 0.0 s" in format_table([scored])


def test_covariances_that_are_none_are_told_on_the_page(tmp_path: Path) -> None:
    page = write_report(tmp_path, [only(RunResult("good", with_covariance(0.0), np.zeros(0), 0.0), circle(20))])
    assert "good: covariances that are not positive definite, and count as outside 3σ: 1" in page.read_text("utf-8")


def test_an_interrupted_report_leaves_nothing_behind(tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        assert total == 3
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_report(tmp_path / "out", [score(example())], interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_is_a_file_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(FieldlocError, match=r"cannot write to .*out"):
        write_report(tmp_path / "out", [])
    assert (tmp_path / "out").read_text() == "mine"


def test_drawing_leaves_the_settings_of_the_program_around_it_alone(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    write_report(tmp_path, [score(example(lost=False))])
    assert dict(mpl.rcParams) == before


def test_tables_load_no_matplotlib_and_the_report_no_pyplot() -> None:
    program = (
        "import sys, logs.table_text; assert 'matplotlib' not in sys.modules; "
        "import logs.report; assert 'matplotlib.pyplot' not in sys.modules"
    )
    root = Path(__file__).parents[1]
    subprocess.run([sys.executable, "-c", program], check=True, cwd=root)
