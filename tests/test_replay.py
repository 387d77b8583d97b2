from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from real_logs import sample_messages, without, write
from two_minds import InTwoMinds

from estimators.base import Estimate, Innovation
from estimators.config import Config
from estimators.ekf import Ekf
from estimators.registry import ALL
from estimators.smoother import Smoother
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.factors import Factor, HeadingFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.measurements import Compass, InitialPose, LandmarkScan, Odometry, Truth
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from logs.reader import LogFile
from logs.recording import Recording, load_recording
from logs.replay import Replay, replay
from logs.schema import Record, topic_of
from logs.writer import LogWriter

SECOND = 10**9
# what others published always has an estimate and may need long to find the robot: test_particles_published
HELD = {name: make for name, make in ALL.items() if not name.endswith("-style")}
MARKS = {"a": (3.0, 0.0), "b": (0.0, 2.0), "c": (-1.0, -2.5)}  # no symmetry
FIELD = FieldMap(
    "three",
    np.zeros((0, 2, 2)),
    np.zeros((0, 3)),
    tuple(Landmark(label, np.array(place), 0.0, np.zeros((2, 2))) for label, place in MARKS.items()),
)


def odometry(stamp_ns: int, forward_mps: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, np.array([forward_mps, 0.0, 0.0]), np.diag([0.01, 0.01, 0.01]) ** 2)


def scan(
    stamp_ns: int, pose: Sequence[float] = (0.0, 0.0, 0.0), labels: Sequence[str | None] = tuple(MARKS)
) -> LandmarkScan:
    """What is seen of the landmarks from a pose, exactly; a label that is not on the map stands where "a" does."""
    offsets = np.array([MARKS.get(label or "a", MARKS["a"]) for label in labels]).reshape(-1, 2) - pose[:2]
    ranges, bearings = np.hypot(*offsets.T), np.arctan2(offsets[:, 1], offsets[:, 0]) - pose[2]
    covariance = np.tile(np.diag([0.05, 0.02]) ** 2, (len(labels), 1, 1))
    return LandmarkScan(stamp_ns, tuple(labels), np.stack([ranges, bearings], axis=-1), covariance)


def compass(stamp_ns: int, heading_rad: float = 0.0) -> Compass:
    return Compass(stamp_ns, heading_rad, 0.1)


def told(stamp_ns: int, pose: Sequence[float] = (0.0, 0.0, 0.0)) -> InitialPose:
    return InitialPose(stamp_ns, np.array(pose), np.diag([0.1, 0.1, 0.1]) ** 2)


def log_of(path: Path, records: Sequence[Record], times_ns: Sequence[int] | None = None) -> LogFile:
    """The map and the records, logged at times_ns, at their stamps if there are none."""
    with LogWriter(path) as log:
        log.write(topic_of(FieldMap), FIELD, 0)
        for i, record in enumerate(records):
            log.write(topic_of(type(record)), record, None if times_ns is None else times_ns[i])
    return LogFile(path)


@dataclass
class Diary:
    """An estimator that writes down what it is fed and always thinks to be where it was told or seen last."""

    entries: list[tuple[str, int]] = field(default_factory=list)
    now: Estimate | None = None

    def start(self, estimate: Estimate) -> None:
        self.entries.append(("start", estimate.stamp_ns))
        self.now = estimate

    def predict(self, odometry: Odometry) -> None:
        self.entries.append(("predict", odometry.stamp_ns))
        self.advance(odometry.stamp_ns)

    def advance(self, stamp_ns: int) -> None:
        self.now = self.now and replace(self.now, stamp_ns=max(stamp_ns, self.now.stamp_ns))

    def update(self, factor: Factor) -> Innovation | None:
        kinds = {PoseFactor: "pose", HeadingFactor: "heading"}
        self.entries.append((kinds.get(type(factor), "other"), factor.stamp_ns))
        if isinstance(factor, PoseFactor):
            self.now = Estimate(factor.stamp_ns, factor.pose, np.eye(3))
        return None

    def estimate(self) -> Estimate | None:
        return self.now


def same(one: Replay, other: Replay) -> bool:
    return len(one.estimates) == len(other.estimates) and all(
        a.stamp_ns == b.stamp_ns and np.array_equal(a.pose, b.pose) and np.array_equal(a.covariance, b.covariance)
        for a, b in zip(one.estimates, other.estimates, strict=True)
    )


# -- order and time ----------------------------------------------------------------------------------------------------


def test_measurements_are_fed_in_the_order_of_their_own_stamps_however_late_they_were_logged(tmp_path: Path) -> None:
    late = [odometry(1000), odometry(2000), scan(1200), odometry(3000), told(2200), compass(500), compass(1500)]
    recording = load_recording(log_of(tmp_path / "log.mcap", late, [1000, 2000, 2100, 3000, 3100, 3200, 3300]))
    diary = Diary()
    replay(recording, diary)
    # the first compass is of no use to an estimator of one place that has none yet
    kinds = ["predict", "pose", "heading", "predict", "pose", "predict"]
    assert diary.entries == list(zip(kinds, [1000, 1200, 1500, 2000, 2200, 3000], strict=True))
    assert recording.warnings == ()


def test_at_one_stamp_comes_first_how_the_robot_moves_then_what_it_is_told_then_what_it_sees(tmp_path: Path) -> None:
    seen_first = [scan(7, (1.0, 0.0, 0.0)), compass(7), told(7), odometry(7)]
    recording = load_recording(log_of(tmp_path / "log.mcap", seen_first))
    assert [type(m) for m in recording.measurements] == [Odometry, InitialPose, Compass, LandmarkScan]
    done = replay(recording, Diary())
    assert [e.stamp_ns for e in done.estimates] == [7]
    assert done.estimates[0].pose == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)  # the last of the stamp is its estimate


def test_when_messages_were_logged_changes_nothing(tmp_path: Path) -> None:
    records = [m.record for m in sample_messages(20.0)]
    stamps = [0 if isinstance(r, FieldMap | Camera) else r.stamp_ns for r in records]
    random = np.random.default_rng(4)
    bursts = [SECOND * (1 + stamp // SECOND) for stamp in stamps]  # a network that delivers once a second
    delays = [stamp + int(random.integers(0, SECOND // 2)) for stamp in stamps]
    results = []
    for name, times in (("live", stamps), ("bursts", bursts), ("delays", delays)):
        with LogWriter(tmp_path / f"{name}.mcap") as log:
            for record, time_ns in zip(records, times, strict=True):
                log.write(topic_of(type(record)), record, time_ns)
        results.append(replay(load_recording(LogFile(tmp_path / f"{name}.mcap")), Ekf(Config())))
    assert len(results[0].estimates) == 201
    assert all(same(results[0], other) for other in results[1:])


def test_a_stamp_that_comes_again_gives_one_estimate_with_all_that_was_said_at_it(tmp_path: Path) -> None:
    records = [told(10), scan(10), scan(10), odometry(10), odometry(20), scan(20), scan(20), odometry(20)]
    done = replay(load_recording(log_of(tmp_path / "log.mcap", records)), Ekf(Config()))
    assert [e.stamp_ns for e in done.estimates] == [10, 20]
    once = replay(load_recording(log_of(tmp_path / "once.mcap", records[:2])), Ekf(Config()))
    assert np.trace(done.estimates[0].covariance) < np.trace(once.estimates[0].covariance)


@pytest.mark.parametrize("name", HELD)
def test_a_clock_that_jumps_is_told_and_survived(tmp_path: Path, name: str) -> None:
    seconds = [100.0, 100.1, 100.2, 5000.0, 5000.1, 60.0, 60.1, 100.3]
    records: list[Record] = []
    for stamp_s in seconds:
        records += [odometry(int(stamp_s * 1e9)), scan(int(stamp_s * 1e9))]
    log = log_of(tmp_path / "log.mcap", records, [i * SECOND for i in range(len(records))])
    recording = load_recording(log)
    done = replay(recording, ALL[name](Config()))
    assert len(recording.warnings) == 1
    assert "6 measurements were logged after others" in recording.warnings[0]
    assert "up to 4940.1 s later" in recording.warnings[0]
    stamps = [e.stamp_ns for e in done.estimates]
    assert stamps[0] == 60 * SECOND
    assert stamps == sorted(set(stamps))
    assert all(np.hypot(*e.pose[:2]) < 0.1 for e in done.estimates)


def test_a_measurement_is_late_only_beside_those_of_its_own_topic(tmp_path: Path) -> None:
    records = [odometry(30 * SECOND), scan(10 * SECOND), odometry(31 * SECOND), scan(11 * SECOND)]
    log = log_of(tmp_path / "log.mcap", records, [30 * SECOND, 30 * SECOND, 31 * SECOND, 31 * SECOND])
    assert load_recording(log).warnings == ()


def test_time_goes_on_also_where_nothing_is_seen(tmp_path: Path) -> None:
    records = [told(0), odometry(0, 1.0), scan(SECOND, labels=[])]
    done = replay(load_recording(log_of(tmp_path / "log.mcap", records)), Ekf(Config()))
    assert [e.stamp_ns for e in done.estimates] == [0, SECOND]
    assert done.estimates[-1].pose == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


def test_the_duration_is_that_of_the_stamps(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.mcap", [scan(2 * SECOND), odometry(5 * SECOND)], [0, 100 * SECOND])
    assert load_recording(log).duration_s == 3.0


# -- the start ---------------------------------------------------------------------------------------------------------


def test_a_given_start_is_believed_at_the_first_measurement(tmp_path: Path) -> None:
    recording = load_recording(log_of(tmp_path / "log.mcap", [odometry(40), compass(50)]))
    diary = Diary()
    done = replay(recording, diary, np.array([-2.5, 1.0, 0.5]))
    assert diary.entries[0] == ("start", 40)
    assert done.estimates[0].pose.tolist() == [-2.5, 1.0, 0.5]
    assert np.sqrt(np.diag(done.estimates[0].covariance)) == pytest.approx([0.1, 0.1, np.radians(5.0)])


def test_an_initial_pose_in_the_log_is_a_start(tmp_path: Path) -> None:
    records = [odometry(0), scan(0, labels=[None, None]), told(SECOND, (2.0, 0.0, 0.0)), odometry(2 * SECOND)]
    done = replay(load_recording(log_of(tmp_path / "log.mcap", records)), Ekf(Config()))
    assert done.estimates[0].stamp_ns == SECOND
    assert done.estimates[0].pose == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(("field_map", "why"), [("kidsize", "looks the same from several poses"), (None, "whole pose")])
@pytest.mark.parametrize("name", HELD)
def test_no_start_says_why_and_the_way_out(tmp_path: Path, field_map: str | None, why: str, name: str) -> None:
    log = log_of(tmp_path / "log.mcap", [odometry(0), compass(1)])
    recording = load_recording(log, None if field_map is None else load_field(field_map))
    with pytest.raises(FieldlocError, match=f"^log: .*{why}.*--start X,Y,HEADING_DEG$"):
        replay(recording, ALL[name](Config()))


# -- what is in a recording --------------------------------------------------------------------------------------------


def test_a_recording_holds_everything_but_the_truth(tmp_path: Path) -> None:
    records = [odometry(1), told(1), compass(2), scan(3), Truth(3, np.zeros(3)), Estimate(3, np.zeros(3), np.eye(3))]
    recording = load_recording(log_of(tmp_path / "log.mcap", records))
    assert [type(m) for m in recording.measurements] == [Odometry, InitialPose, Compass, LandmarkScan]
    assert (recording.name, recording.field.labels, recording.camera) == ("log", ("a", "b", "c"), None)


@pytest.mark.parametrize("name", ALL)
def test_the_truth_changes_no_estimate(tmp_path: Path, name: str) -> None:
    messages = sample_messages(6.0)

    def falsified(record: Record) -> Record:
        return replace(record, pose=record.pose + [1.0, -2.0, 0.5]) if isinstance(record, Truth) else record

    logs = [
        write(tmp_path / "as_it_is.mcap", messages),
        write(tmp_path / "none.mcap", messages, without(Truth)),
        write(tmp_path / "false.mcap", messages, falsified),
    ]
    results = [replay(load_recording(LogFile(log)), ALL[name](Config())) for log in logs]
    assert len(results[0].estimates) == 61
    assert same(results[0], results[1])
    assert same(results[0], results[2])


def test_a_log_without_a_map_or_without_observations_is_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "nomap.mcap") as log:
        log.write("/landmarks", scan(1))
    with pytest.raises(FieldlocError, match=r"nomap.mcap: holds no map; name one with --field, for example"):
        load_recording(LogFile(tmp_path / "nomap.mcap"))
    assert load_recording(LogFile(tmp_path / "nomap.mcap"), FIELD).field is FIELD
    blind = log_of(tmp_path / "blind.mcap", [odometry(1), Truth(1, np.zeros(3))])
    with pytest.raises(
        FieldlocError, match=r"blind.mcap: .*no usable message on /landmarks, /image_features, /compass, /initial_pose"
    ):
        load_recording(blind)


def test_a_log_without_odometry_is_usable_with_a_warning(tmp_path: Path) -> None:
    recording = load_recording(log_of(tmp_path / "log.mcap", [scan(0), scan(SECOND, (0.2, 0.0, 0.0))]))
    assert len(recording.warnings) == 1
    assert "log.mcap: no usable message on /odometry" in recording.warnings[0]
    done = replay(recording, Ekf(Config()))
    assert done.estimates[-1].pose == pytest.approx([0.2, 0.0, 0.0], abs=0.05)


def test_a_camera_that_changes_is_told(tmp_path: Path) -> None:
    camera = Camera("pinhole", 640, 480, 610.0, 610.0, 319.5, 239.5)
    paths = []
    for name, other in (("same", camera), ("other", replace(camera, fx_px=600.0))):
        paths.append(tmp_path / f"{name}.mcap")
        with LogWriter(paths[-1]) as log:
            log.write("/field", FIELD, 0)
            log.write("/landmarks", scan(1))
            log.write("/odometry", odometry(1))
            for i, one in enumerate((camera, other)):
                log.write("/camera", one, i)
    recordings = [load_recording(LogFile(path)) for path in paths]
    assert [r.camera for r in recordings] == [camera, camera]
    assert recordings[0].warnings == ()
    assert "/camera changes" in recordings[1].warnings[0]


# -- what cannot be used -----------------------------------------------------------------------------------------------


def test_landmarks_that_are_not_on_the_map_are_counted_by_label(tmp_path: Path) -> None:
    records = [odometry(0), scan(0), scan(10, labels=["a", "b", "x"]), scan(20, labels=["x", "b", "y"])]
    done = replay(load_recording(log_of(tmp_path / "log.mcap", records)), Ekf(Config()))
    assert done.warnings == ("log: 3 observations left out: landmark x, y is not on the map three",)
    assert [e.stamp_ns for e in done.estimates] == [0, 10, 20]


def test_a_measurement_that_no_arithmetic_can_use_is_counted_and_the_rest_used(tmp_path: Path) -> None:
    absurd = [replace(scan(stamp), range_bearing=np.array([[1e300, 0.0]] * 3)) for stamp in (10, 20)]
    recording = load_recording(log_of(tmp_path / "log.mcap", [odometry(0), scan(0), *absurd, scan(30)]))
    done = replay(recording, Ekf(Config()))
    assert len(done.warnings) == 1
    assert done.warnings[0].startswith("log: 2 measurements left out, the first: LandmarkScan at 0.00000001 s")
    assert "range of 1e+300 is no measurement" in done.warnings[0]
    assert done.estimates[-1].stamp_ns == 30
    assert done.estimates[-1].pose == pytest.approx(np.zeros(3), abs=0.05)


@dataclass
class Broken(Diary):
    """Fails in one way from a stamp on."""

    way: str = ""
    from_ns: int = 0

    def update(self, factor: Factor) -> Innovation | None:
        super().update(factor)
        if factor.stamp_ns < self.from_ns or self.now is None:
            return None
        match self.way:
            case "nan":
                self.now = replace(self.now, pose=np.array([0.0, np.nan, 0.0]))
            case "singular":
                np.linalg.inv(np.zeros((2, 2)))
            case "division":
                1 / (factor.stamp_ns - factor.stamp_ns)
            case "gtsam":
                raise RuntimeError("\nIndeterminant linear system\nSee the documentation for a page of advice")
        return None


@pytest.mark.parametrize(
    ("way", "said"),
    [("nan", "not finite"), ("singular", "Singular matrix"), ("division", "by zero"), ("gtsam", "linear system")],
)
def test_an_estimator_that_fails_is_named_with_the_stamp(tmp_path: Path, way: str, said: str) -> None:
    recording = load_recording(log_of(tmp_path / "log.mcap", [odometry(0), scan(0), scan(SECOND), scan(2 * SECOND)]))
    with pytest.raises(FieldlocError, match=rf"^log: Broken failed at 1\.0 s: [^\n]*{said}[^\n]*$"):
        replay(recording, Broken(way=way, from_ns=SECOND))


class BrokenSmoother(Smoother):
    def trajectory(self) -> tuple[Estimate, ...]:
        raise RuntimeError("no solution")


def test_a_smoother_that_cannot_solve_says_so(tmp_path: Path) -> None:
    recording = load_recording(log_of(tmp_path / "log.mcap", [odometry(0), scan(0)]))
    with pytest.raises(FieldlocError, match=r"^log: BrokenSmoother failed solving: no solution$"):
        replay(recording, BrokenSmoother(Config()))


def test_how_long_errors_stay_alike_decides_what_a_second_sight_is_worth() -> None:
    sure, unsure = (
        replay(drive(), Ekf(Config()), config=Config(correlation=ErrorCorrelation(s, s, s))) for s in (0.0, 10.0)
    )
    for one, other in zip(sure.estimates[4:], unsure.estimates[4:], strict=True):
        assert np.linalg.det(one.covariance) < 0.1 * np.linalg.det(other.covariance)


# -- what comes out ----------------------------------------------------------------------------------------------------


def drive() -> Recording:
    """Two metres straight on, seen three times a second."""
    stamps = np.arange(0, 10) * SECOND // 3
    poses = [(0.6 * stamp / SECOND, 0.0, 0.0) for stamp in stamps]
    measurements = []
    for stamp, pose in zip(stamps.tolist(), poses, strict=True):
        measurements += [odometry(stamp, 0.6), scan(stamp, pose)]
    return Recording("drive", FIELD, None, tuple(measurements))


@pytest.mark.parametrize("name", HELD)
def test_each_measurement_other_than_odometry_is_timed(name: str) -> None:
    done = replay(drive(), ALL[name](Config()))
    assert done.update_s.shape == (10,)
    assert (done.update_s > 0.0).all()
    assert done.update_s.sum() < done.total_s
    assert done.estimates[-1].pose == pytest.approx([1.8, 0.0, 0.0], abs=0.1)


def test_a_smoother_answers_with_the_past_in_the_light_of_all() -> None:
    smoothed, filtered = replay(drive(), Smoother(Config())), replay(drive(), Ekf(Config()))
    first = [done.estimates[0] for done in (smoothed, filtered)]
    assert first[0].stamp_ns == first[1].stamp_ns
    assert np.linalg.det(first[0].covariance) < np.linalg.det(first[1].covariance)


def test_progress_tells_of_reading_estimating_and_solving(tmp_path: Path) -> None:
    told: list[tuple[int, int, str]] = []

    def progress(done: int, total: int, doing: str = "") -> None:
        told.append((done, total, doing))

    log = LogFile(write(tmp_path / "log.mcap", sample_messages(60.0)))
    recording = load_recording(log, progress=progress)
    replay(recording, Smoother(Config()), progress=progress)
    phases = list(dict.fromkeys(doing for _, _, doing in told))
    assert phases == ["reading", "", "solving"]
    counted = [(done, total) for done, total, doing in told if not doing]
    assert counted == [(done, len(recording.measurements)) for done in range(0, len(recording.measurements), 500)]
    assert all(0 < done <= total for done, total, doing in told if doing == "reading")


def test_poses_stay_what_they_were_when_they_were_given(tmp_path: Path) -> None:
    """An estimator that goes on in the arrays it handed out would rewrite the past."""
    recording = load_recording(LogFile(write(tmp_path / "log.mcap", sample_messages(5.0))))
    for make in ALL.values():
        whole = replay(recording, make(Config())).estimates
        if make is Smoother:
            continue
        half = Recording(
            recording.name, recording.field, None, recording.measurements[: len(recording.measurements) // 2]
        )
        first = replay(half, make(Config())).estimates[:-1]
        poses: list[FloatArray] = [e.pose for e in whole[: len(first)]]
        assert np.array_equal(poses, [e.pose for e in first])


# -- hypotheses --------------------------------------------------------------------------------------------------------


def test_what_an_estimator_says_of_its_hypotheses_comes_with_its_estimates() -> None:
    done = replay(drive(), InTwoMinds(Config()))
    stamps = [one.stamp_ns for one in done.ambiguities]
    assert stamps == sorted(set(stamps))
    assert set(stamps) <= {e.stamp_ns for e in done.estimates}
    assert (done.ambiguities[0].mirrored, done.ambiguities[-1].mirrored) == (0.5, 0.01)
    assert [event.kind for event in done.events] == ["start", "decision"]
    decided_ns = done.events[1].stamp_ns
    assert {one.mirrored for one in done.ambiguities if one.stamp_ns < decided_ns} == {0.5}
    assert decided_ns in stamps  # a change is kept when it comes


def test_an_estimator_that_is_always_sure_has_no_ambiguities() -> None:
    done = replay(drive(), Ekf(Config()))
    assert (done.ambiguities, done.events) == ((), ())
