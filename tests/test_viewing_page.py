"""The page that plays a result: what is in it, and that a browser plays it."""

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from two_minds import ambiguity

from estimators.base import Ambiguity, Estimate, Event
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.ground import project_points
from fieldloc.measurements import (
    CameraMount,
    ImageFeatures,
    LandmarkScan,
    LineObservation,
    Odometry,
    PostObservation,
    Truth,
)
from logs.reader import LogFile
from logs.results import LogResult, RunResult
from logs.schema import Record, topic_of
from logs.trajectory import Trajectory
from logs.viewing.observations import Seen, SegmentKind, load_seen, seen
from logs.viewing.page import load_view, open_in_browser, write_page
from logs.viewing.page_data import Limits
from logs.writer import LogWriter

SECOND = 10**9
EPOCH_NS = 1_700_000_000_123_456_789  # more digits than a double holds
FIELD = FieldMap(
    "yard </script> & co",
    np.array([[[-4.0, -3.0], [4.0, -3.0]]]),
    np.array([[0.0, 0.0, 0.75]]),
    (Landmark("a", np.array([4.0, 1.0]), 0.1, np.zeros((2, 2))),),
)
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
MOUNT = CameraMount(0.5, 0.2, 0.3, 0.05, np.zeros((4, 4)), 0.05, -0.02)


def circle(n: int = 400, step_ns: int = SECOND // 10) -> Trajectory:
    angle = np.linspace(0, 4 * np.pi, n)
    poses = np.column_stack([2 * np.cos(angle), 2 * np.sin(angle), (angle + 3 * np.pi / 2) % (2 * np.pi) - np.pi])
    return Trajectory(EPOCH_NS + step_ns * np.arange(n, dtype=np.int64), poses)


def off_by(truth: Trajectory, sigma: float, claimed: float = 0.1) -> Trajectory:
    error = np.random.default_rng(1).normal(0, sigma, truth.poses.shape)
    covariance = claimed**2 * np.array([[1.0, 0.3, 0.0], [0.3, 2.0, 0.0], [0.0, 0.0, 0.25]])
    return Trajectory(truth.stamps_ns, truth.poses + error, np.tile(covariance, (len(truth), 1, 1)))


def result(runs: dict[str, Trajectory], truth: Trajectory | None, name: str = "yard") -> LogResult:
    made = tuple(RunResult(key, trajectory, np.zeros(0), 0.0) for key, trajectory in runs.items())
    return LogResult(name, 40.0, FIELD, truth, made)


def unsure(n: int = 400, hypotheses: int = 2) -> tuple[tuple[Ambiguity, ...], tuple[Event, ...]]:
    """Ten a second, half of the time undecided."""
    weights = dict.fromkeys(range(1, hypotheses + 1), 0.9 / hypotheses)
    said = tuple(
        ambiguity(EPOCH_NS + SECOND // 10 * i, weights if i < n // 2 else {1: 0.9}, 0.45 if i < n // 2 else 0.0, 0.1)
        for i in range(n)
    )
    events = (Event(EPOCH_NS, "start", "found </script>"), Event(EPOCH_NS + SECOND // 10 * n // 2, "decision", "one"))
    return said, events


def doubting(name: str, trajectory: Trajectory, **options: int) -> RunResult:
    return RunResult(name, trajectory, np.zeros(0), 0.0, *unsure(**options))


def written(path: Path, *arguments: object) -> str:
    write_page(path, *arguments)  # type: ignore[arg-type]
    return path.read_text(encoding="utf-8")


def document(page: str) -> dict:
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def array(packed: dict, width: int | None = None) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(packed["data"]), dtype=f"<{packed['type']}")
    return values if width is None else values.reshape(-1, width)


# -- what is in it -----------------------------------------------------------------------------------------------------


def test_trajectories_come_back_from_the_page_to_the_precision_of_what_is_drawn(tmp_path: Path) -> None:
    truth = circle()
    estimate = off_by(truth, 0.05)
    data = document(written(tmp_path / "page.html", result({"ekf": estimate}, truth)))
    assert (data["log"], data["origin_ns"]) == ("yard", str(EPOCH_NS))
    assert data["duration_s"] == pytest.approx(39.9, abs=1e-12)
    (run,) = data["runs"]
    for packed, trajectory in ((run["trajectory"], estimate), (data["truth"], truth)):
        np.testing.assert_allclose(array(packed["t"]), (trajectory.stamps_ns - EPOCH_NS) / 1e9, rtol=0, atol=1e-12)
        np.testing.assert_allclose(array(packed["pose"], 3), trajectory.poses, rtol=1e-7, atol=1e-7)
    rows = array(run["trajectory"]["covariance"], 4)
    np.testing.assert_allclose(rows, np.tile([0.01, 0.003, 0.02, 0.0025], (400, 1)), rtol=1e-6)


def test_the_errors_in_the_page_are_those_of_the_evaluation(tmp_path: Path) -> None:
    truth = circle()
    estimate = off_by(truth, 0.05)
    data = document(written(tmp_path / "page.html", result({"ekf": estimate}, truth)))
    errors = data["runs"][0]["errors"]
    rows = array(errors["columns"], errors["width"])
    difference = estimate.poses - truth.poses
    np.testing.assert_allclose(rows[:, 0], np.hypot(difference[:, 0], difference[:, 1]), atol=1e-6)
    np.testing.assert_allclose(rows[:, 1], np.abs((difference[:, 2] + np.pi) % (2 * np.pi) - np.pi), atol=1e-6)
    assert estimate.covariances is not None
    information = np.linalg.inv(estimate.covariances[0])
    difference[:, 2] = (difference[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(rows[:, 2], np.einsum("ni,ij,nj->n", difference, information, difference), rtol=1e-5)
    largest = np.sqrt(np.linalg.eigvalsh(estimate.covariances[0, :2, :2])[1])
    np.testing.assert_allclose(rows[:, 3:], np.tile([largest, 0.05], (400, 1)), rtol=1e-6)


def test_the_map_is_the_logs_own(tmp_path: Path) -> None:
    data = document(written(tmp_path / "page.html", result({}, circle())))
    assert data["field"]["name"] == FIELD.name
    assert data["field"]["lines"] == [[-4.0, -3.0, 4.0, -3.0]]
    assert data["field"]["circles"] == [[0.0, 0.0, 0.75]]
    assert data["field"]["landmarks"] == [[4.0, 1.0, 0.1, "a"]]
    assert data["runs"] == []


def test_of_a_long_log_the_spikes_stay_and_the_page_stays_below_five_megabytes(tmp_path: Path) -> None:
    truth = circle(120_000, SECOND // 100)  # twenty minutes at 100 Hz
    poses = truth.poses.copy()
    poses[77_777, 0] += 3.0
    spiked = Trajectory(truth.stamps_ns, poses, np.tile(np.eye(3) * 0.01, (len(truth), 1, 1)))
    many = Seen(
        truth.stamps_ns[::6],
        np.arange(1, 20_001) * 3,
        np.random.default_rng(0).normal(size=(60_000, 4)),
        np.zeros(60_000, dtype=np.uint8),
    )
    runs = tuple(doubting(name, spiked, n=12_000) for name in "abcd")
    page = written(tmp_path / "page.html", LogResult("yard", 1200.0, FIELD, truth, runs), many)
    assert len(page.encode()) < 5_000_000
    data = document(page)
    for run in data["runs"]:
        assert array(run["errors"]["columns"], 5)[:, 0].max() == pytest.approx(3.0)
        t = array(run["trajectory"]["t"])
        assert (t[0], t[-1]) == (0.0, pytest.approx(1199.99))
        assert len(t) <= Limits().poses
        assert np.diff(t).max() < 0.2


def test_spikes_stay_also_without_covariances(tmp_path: Path) -> None:
    truth = circle(20_000)
    poses = truth.poses.copy()
    poses[7_777, 1] -= 2.0
    poses[8_888, 2] += 1.0
    data = document(written(tmp_path / "page.html", result({"a": Trajectory(truth.stamps_ns, poses)}, truth)))
    errors = data["runs"][0]["errors"]
    assert errors["width"] == 2
    assert array(errors["columns"], 2).max(axis=0) == pytest.approx([2.0, 1.0], rel=1e-6)
    assert len(array(errors["t"])) <= Limits().errors


def test_a_covariance_that_is_none_does_not_break_the_page(tmp_path: Path) -> None:
    truth = circle(10)
    estimate = off_by(truth, 0.01)
    assert estimate.covariances is not None
    estimate.covariances[3] = np.nan
    estimate.covariances[4] = -np.eye(3)
    data = document(written(tmp_path / "page.html", result({"ekf": estimate}, truth)))
    rows = array(data["runs"][0]["trajectory"]["covariance"], 4)
    assert np.isnan(rows).all(axis=1).tolist() == [False] * 3 + [True] + [False] * 6


def test_a_run_without_estimates_and_a_log_without_a_map_have_a_page_too(tmp_path: Path) -> None:
    nothing = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    lost = LogResult("lost", 0.0, None, None, (RunResult("ekf", nothing, np.zeros(0), 0.0),))
    data = document(written(tmp_path / "page.html", lost))
    assert (data["field"], data["truth"], data["duration_s"]) == (None, None, 0.0)
    assert data["runs"][0]["summary"] == "no estimate"


def test_hypotheses_come_back_from_the_page_in_the_order_in_which_they_are_stacked(tmp_path: Path) -> None:
    sure = RunResult("ekf", circle(), np.zeros(0), 0.0)
    view = LogResult("yard", 40.0, FIELD, circle(), (doubting("mixture", circle(), hypotheses=3), sure))
    data = document(written(tmp_path / "page.html", view))
    assert data["runs"][1]["hypotheses"] is None
    packed = data["runs"][0]["hypotheses"]
    ends = array(packed["ends"])
    assert ends.tolist() == [*range(3, 603, 3), *range(601, 801)]
    np.testing.assert_allclose(array(packed["t"]), np.arange(400) / 10, atol=1e-9)
    np.testing.assert_allclose(array(packed["mirrored"]), np.repeat([0.45, 0.0], 200), atol=1e-7)
    np.testing.assert_allclose(array(packed["lost"]), 0.1, atol=1e-7)
    np.testing.assert_allclose(array(packed["weight"])[:3], 0.3, atol=1e-7)
    assert array(packed["pose"], 3)[:3, 0].tolist() == [1.0, 2.0, 3.0]
    assert array(packed["colour"])[:3].tolist() == [0, 1, 2]
    assert packed["events"] == [[0.0, "start", "found </script>"], [20.0, "decision", "one"]]


def test_hypotheses_keep_their_place_in_the_stack_when_another_one_becomes_the_likeliest(tmp_path: Path) -> None:
    said = (ambiguity(EPOCH_NS, {4: 0.6, 2: 0.4}), ambiguity(EPOCH_NS + SECOND, {2: 0.9, 4: 0.07, 1: 0.03}))
    view = LogResult("yard", 40.0, FIELD, None, (RunResult("mixture", circle(), np.zeros(0), 0.0, said),))
    packed = document(written(tmp_path / "page.html", view))["runs"][0]["hypotheses"]
    assert array(packed["weight"]).tolist() == pytest.approx([0.4, 0.6, 0.9, 0.07, 0.03])  # oldest first, then others
    assert array(packed["colour"]).tolist() == [0, 1, 0, 1, 255]


def test_of_too_many_hypotheses_and_events_the_page_has_fewer(tmp_path: Path) -> None:
    said, _ = unsure(12_000, 32)
    events = tuple(Event(EPOCH_NS + i, "split" if i % 100 else "decision", "") for i in range(50_000))
    runs = tuple(RunResult(name, circle(), np.zeros(0), 0.0, said, events) for name in "ab")
    data = document(written(tmp_path / "page.html", LogResult("yard", 40.0, FIELD, None, runs)))
    for run in data["runs"]:
        packed = run["hypotheses"]
        assert 3_000 <= len(array(packed["weight"])) == array(packed["ends"])[-1] <= 12_000
        assert array(packed["t"])[[0, -1]].tolist() == pytest.approx([0.0, 1199.9])
        kinds = [kind for _, kind, _ in packed["events"]]
        assert (kinds.count("decision"), kinds.count("split")) == (500, 990)


# -- what was seen -----------------------------------------------------------------------------------------------------


def test_a_scan_is_drawn_from_its_sensor_to_the_landmarks() -> None:
    mount = np.array([0.2, 0.1, np.pi / 2])
    scan = LandmarkScan(7, ("a", None), np.array([[2.0, 0.0], [1.0, np.pi / 2]]), np.tile(np.eye(2), (2, 1, 1)), mount)
    drawn = seen([scan], None)
    np.testing.assert_allclose(drawn.segments, [[0.2, 0.1, 0.2, 2.1], [0.2, 0.1, -0.8, 0.1]], atol=1e-12)
    assert drawn.kinds.tolist() == [SegmentKind.LANDMARK] * 2


def test_an_image_is_drawn_where_its_features_stand_on_the_ground() -> None:
    points = np.array([[2.0, 0.5], [3.0, -0.5], [2.5, 0.9]])
    pixels, visible = project_points(CAMERA, MOUNT, np.pad(points, ((0, 0), (0, 1))))
    assert visible.all()
    edges = np.array([[300.0, 100.0], [310.0, 100.0]])
    standing = PostObservation(edges, np.eye(4), pixels[0], np.eye(2))
    line = LineObservation(pixels[1:], np.eye(4))
    footless = PostObservation(edges, np.eye(4))
    above = LineObservation(np.array([[10.0, 10.0], [600.0, 400.0]]), np.eye(4))  # one end is in the sky
    drawn = seen([ImageFeatures(7, MOUNT, (standing, footless), (line, above))], CAMERA)
    assert drawn.kinds.tolist() == [SegmentKind.LANDMARK, SegmentKind.BEARING, SegmentKind.LINE]
    np.testing.assert_allclose(drawn.segments[0], [0.05, -0.02, 2.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(drawn.segments[2], [3.0, -0.5, 2.5, 0.9], atol=1e-9)
    start, end = drawn.segments[1].reshape(2, 2)
    toward, _ = project_points(CAMERA, MOUNT, np.array([[*(start + 0.2 * (end - start)), 1.0]]))
    assert toward[0, 0] == pytest.approx(305.0, abs=8.0)  # straight above the ray, but for the camera's roll


def test_a_post_that_the_lens_cannot_show_is_left_out() -> None:
    fisheye = Camera("fisheye", 640, 480, 100.0, 100.0, 319.5, 239.5)
    beyond = PostObservation(np.array([[2000.0, 200.0], [2010.0, 200.0]]), np.eye(4))  # 16 radians off the axis
    assert len(seen([ImageFeatures(7, MOUNT, (beyond,), ())], fisheye).segments) == 0


def test_images_without_a_camera_show_nothing() -> None:
    line = LineObservation(np.array([[100.0, 400.0], [500.0, 400.0]]), np.eye(4))
    assert len(seen([ImageFeatures(7, MOUNT, (), (line,))], None).segments) == 0


def test_of_too_much_that_was_seen_every_so_many_scans_are_kept(tmp_path: Path) -> None:
    scans = [
        LandmarkScan(SECOND * k, ("a", "b"), np.array([[1.0 + k, 0.0], [2.0, 1.0]]), np.tile(np.eye(2), (2, 1, 1)))
        for k in range(10)
    ]
    log = log_of(tmp_path / "log.mcap", scans)
    assert len(load_seen(log, 20).segments) == 20
    few = load_seen(log, 9)
    assert few.stamps_ns.tolist() == [0, 3 * SECOND, 6 * SECOND, 9 * SECOND]
    assert few.ends.tolist() == [2, 4, 6, 8]
    assert few.segments[2, 2] == pytest.approx(4.0)


# -- what goes in ------------------------------------------------------------------------------------------------------


def log_of(path: Path, records: list, metadata: dict[str, str] | None = None) -> LogFile:
    with LogWriter(path, metadata) as log:
        for record in records:
            log.write(topic_of(type(record)), record, 0 if isinstance(record, FieldMap | Camera) else None)
    return LogFile(path)


def estimates(n: int = 3) -> list[Record]:
    return [Estimate(SECOND * k, np.array([0.1 * k, 0.0, 0.0]), 0.01 * np.eye(3)) for k in range(n)]


def truths(n: int = 3) -> list[Record]:
    return [Truth(SECOND * k, np.array([0.1 * k, 0.1, 0.0])) for k in range(n)]


def test_results_and_the_log_they_came_from_make_one_view(tmp_path: Path) -> None:
    first = log_of(tmp_path / "a.mcap", estimates(), {"estimator": "ekf"})
    second = log_of(tmp_path / "b.mcap", estimates(), {"estimator": "smooth"})
    source = log_of(tmp_path / "log.mcap", [FIELD, *truths()])
    view = load_view([first, second, source])
    assert [run.name for run in view.runs] == ["ekf", "smooth"]
    assert view.truth is not None
    assert view.field is not None
    assert load_view([first], truth=source).truth is not None
    other = load_field("kidsize")
    assert load_view([first, source], field=other).field is other


def test_a_log_without_estimates_shows_its_truth(tmp_path: Path) -> None:
    view = load_view([log_of(tmp_path / "log.mcap", [FIELD, *truths()])])
    assert view.runs == ()
    assert view.truth is not None
    assert (len(view.truth), view.duration_s) == (3, 2.0)


def test_where_there_is_nothing_to_draw_the_way_out_is_named(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.mcap", [Odometry(0, np.zeros(3))])
    with pytest.raises(FieldlocError, match=r"log\.mcap: neither estimates nor truth to draw; .* --estimator"):
        load_view([log])


# -- the page as such --------------------------------------------------------------------------------------------------

_VOID = {"meta", "input", "br", "img", "link", "hr"}


class _Checker(HTMLParser):
    """Every tag closed in its turn; collects what would be loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loaded += [str(value) for key, value in attrs if key in ("src", "href", "srcset", "action", "data")]
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_well_formed_and_loads_nothing(tmp_path: Path) -> None:
    evil = '</script><script>alert("x")</script>&<b>{{player}}'
    page = written(tmp_path / "page.html", result({evil: off_by(circle(), 0.1)}, circle(), evil))
    checker = _Checker()
    checker.feed(page)
    assert checker.open == []
    assert checker.loaded == []
    assert not re.search(r"https?://|url\(|@import|import\(|fetch\(|XMLHttpRequest|WebSocket|new Image", page)
    assert "default-src 'none'" in page
    assert document(page)["runs"][0]["name"] == evil
    assert document(page)["field"]["name"] == FIELD.name
    assert page.count("<script") == 2
    assert page.count('"use strict"') == 1


def test_a_page_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "page.html").mkdir()
    with pytest.raises(FieldlocError, match="cannot write"):
        write_page(tmp_path / "page.html", result({}, circle()))
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_the_folder_of_the_page_is_made(tmp_path: Path) -> None:
    write_page(tmp_path / "runs" / "new" / "page.html", result({}, circle()))
    assert (tmp_path / "runs" / "new" / "page.html").exists()


def test_a_browser_is_asked_for_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: asked.append(address) or True)
    assert open_in_browser(tmp_path / "a page.html")
    assert asked == [f"file://{tmp_path}/a%20page.html"]


# -- in a browser ------------------------------------------------------------------------------------------------------

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--window-size=1200,900",
    "--virtual-time-budget=3000",
]
WATCH = """<script>
addEventListener("error", (event) => { document.title = "ERROR " + event.message + " " + event.lineno; });
addEventListener("securitypolicyviolation", (event) => { document.title = "BLOCKED " + event.violatedDirective; });
</script>"""
USE = """<script>
const press = (key) => dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
setTimeout(() => {
  const said = [];
  const at = () => byId("clock").textContent.split(" ")[0];
  try {
    frame(0); said.push(at());
    press("ArrowRight"); frame(10); said.push(at());
    press("End"); frame(20); said.push(at());
    press("Home"); press(" "); frame(30); frame(230); press(" "); frame(300); said.push(at());
    press("."); frame(310); said.push(at());
    for (const key of ["+", "-", "f", "t", "o", "h", "h", "1", "1", "2", "?", "r"]) { press(key); frame(320); }
    const middle = { bubbles: true, clientX: strips.getBoundingClientRect().left + LEFT
      + (strips.clientWidth - LEFT - RIGHT) / 2, clientY: strips.getBoundingClientRect().top + 40, pointerId: 1 };
    strips.setPointerCapture = () => {};
    strips.dispatchEvent(new PointerEvent("pointerdown", middle)); frame(330); said.push(at());
    field.dispatchEvent(new WheelEvent("wheel", { deltaY: -200, bubbles: true, cancelable: true })); frame(340);
    const pen = field.getContext("2d").getImageData(0, 0, field.width, field.height).data;
    const colours = new Set();
    for (let i = 0; i < pen.length; i += 4) colours.add(pen[i] << 16 | pen[i + 1] << 8 | pen[i + 2]);
    said.push(colours.size > 20 ? "drawn" : "empty");
    said.push(document.querySelectorAll("#readout tr").length > 4 ? "told" : "silent");
    document.body.dataset.said = said.join("|");
  } catch (error) { document.body.dataset.said = "THROWN " + error; }
}, 50);
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium to open the page in")
def test_a_browser_plays_the_page_without_an_error(tmp_path: Path) -> None:
    scan = LandmarkScan(EPOCH_NS, ("a",), np.array([[2.0, 0.5]]), np.eye(2)[None])
    two = (doubting("m", circle()), doubting("n", circle()))
    pages = {
        "full": (result({"ekf": off_by(circle(), 0.1), "poor": off_by(circle(), 0.4)}, circle()), seen([scan], None)),
        "hypotheses": (LogResult("yard", 40.0, FIELD, circle(), two), None),
        "only hypotheses": (LogResult("yard", 40.0, FIELD, None, two), None),
        "no truth": (result({"ekf": off_by(circle(), 0.1), "b": off_by(circle(), 0.2)}, None), None),
    }
    for name, arguments in pages.items():
        page = written(tmp_path / "page.html", *arguments)
        page = page.replace("<title>", WATCH + "<title>", 1).replace("</body>", USE + "</body>")
        (tmp_path / "page.html").write_text(page)
        profile = f"--user-data-dir={tmp_path / 'profile'}"
        command = [str(CHROMIUM), *QUIET, profile, "--dump-dom", (tmp_path / "page.html").as_uri()]
        dom = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
        (title,) = re.findall(r"<title>(.*?)</title>", dom)
        assert title.startswith("fieldloc: "), title
        (said,) = re.findall(r'data-said="(.*?)"', dom)
        assert said == "0:00.000|0:01.000|0:39.900|0:00.210|0:00.300|0:19.950|drawn|told", (name, said)
