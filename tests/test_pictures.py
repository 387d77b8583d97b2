"""A log with pictures: they are looked at, and what is seen in them localizes the robot."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from soccer_bag import CAMERA, Moment, header, write_bag, write_messages

from estimators.config import Config
from estimators.mixture.filter import MixtureFilter
from fieldloc import pose as se2
from fieldloc.cli import main
from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from fieldloc.measurements import CameraMount, ImageFeatures
from fieldloc.render import Scene, Sensor, render
from fieldloc.vision.picture import encode
from logs.edit.seen import with_features
from logs.pictures import picture_features
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay

FIELD = load_field("kidsize")
TOPIC = "/camera/image_raw/compressed"
FREE = np.diag([0.01, 0.02, 0.02, 0.02]) ** 2
SECONDS = 2.0


def mount(moment: Moment) -> CameraMount:
    """As pan, tilt and roll."""
    place, rotation = moment.footprint_from_camera
    ahead, right = rotation[:, 2], rotation[:, 0]  # the camera's z and x
    tilt = -np.arcsin(ahead[2])
    return CameraMount(
        float(place[2]),
        float(np.arctan2(ahead[1], ahead[0])),
        float(tilt),
        float(np.arcsin(-right[2] / np.cos(tilt))),
        FREE,
        float(place[0]),
        float(place[1]),
    )


def picture(moment: Moment, data: bytes | None = None) -> tuple[str, int, dict[str, object]]:
    if data is None:
        seen = render(
            Scene(sensor=Sensor(read_noise=2.0)), CAMERA, FIELD, mount(moment), moment.pose, np.random.default_rng(1)
        )
        data = encode(seen, ".jpg")
    said = {"header": header(moment.stamp_ns, "camera_optical_frame"), "format": "jpeg"}
    return TOPIC, moment.stamp_ns + 30_000_000, {**said, "data": np.frombuffer(data, np.uint8)}


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two files of one recording: the robot's, and five pictures."""
    folder = tmp_path_factory.mktemp("pictures")
    topics = ("/odom", "/tf", "/tf_static", "/camera/camera_info", "/mocap/robot")
    robot = write_bag(folder / "robot.mcap", FIELD, SECONDS, topics)
    times = (0.2, 0.6, 1.0, 1.4, 1.8)
    seen = write_messages(folder / "pictures.mcap", [picture(Moment(time_s)) for time_s in times])
    return [robot, seen]


def test_what_is_seen_in_pictures_localizes(paths: list[Path]) -> None:
    recording = load_recording(LogFile(paths), FIELD)
    seen = [one for one in recording.measurements if isinstance(one, ImageFeatures)]
    assert len(seen) == 5
    assert all(len(one.lines) >= 2 for one in seen)
    begin = Moment(0.0).pose + [0.1, -0.1, 0.03]
    done = replay(recording, MixtureFilter(Config()), begin)
    last = done.estimates[-1]
    error = se2.local(last.pose, Moment((last.stamp_ns - Moment(0.0).stamp_ns) * 1e-9).pose)
    # a line's place is known to a few centimetres where its tilt is to a degree
    assert np.hypot(*error[:2]) < 0.15
    assert abs(error[2]) < 0.04


def test_several_processes_see_what_one_sees(paths: list[Path]) -> None:
    one, two = (list(picture_features(LogFile(paths), FIELD, processes=count)) for count in (1, 2))
    assert [features.stamp_ns for features in one] == [features.stamp_ns for features in two]
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal([line.ends_px for line in a.lines], [line.ends_px for line in b.lines])


def test_detect_writes_what_is_seen_beside_the_pictures(
    paths: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "seen.mcap"
    assert main(["detect", *map(str, paths), "--field", "kidsize", "-o", str(out)]) == 0
    assert "/image_features: 5 pictures" in capsys.readouterr().out
    written = list(LogFile(out).records(ImageFeatures))
    direct = list(picture_features(LogFile(paths), FIELD, processes=1))
    assert [one.stamp_ns for one in written] == [one.stamp_ns for one in direct]
    np.testing.assert_array_equal(written[2].lines[0].ends_px, direct[2].lines[0].ends_px)
    counts = {source.topic: count for source, count in LogFile(out).sources}
    assert counts[TOPIC] == 5
    times = [time_ns for _, time_ns in LogFile(out).log_times()]
    assert times == sorted(times)
    again = tmp_path / "again.mcap"
    done = with_features(LogFile(out), again, FIELD)
    assert any("left out" in note for note in done.notes)
    assert len(list(LogFile(again).records(ImageFeatures))) == 5


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda moment: picture(moment, b"\xff\xd8 not a picture"), "picture"),
        (lambda moment: picture(moment, encode(np.zeros((24, 32, 3), np.uint8), ".png")), "it is 32 by 24"),
        (lambda moment: picture(Moment(99.0), encode(np.zeros((480, 640, 3), np.uint8), ".png")), "no transform"),
    ],
)
def test_a_picture_that_cannot_be_used_is_counted(
    paths: list[Path],
    tmp_path: Path,
    spoil: Callable[[Moment], tuple[str, int, dict[str, object]]],
    said: str,
) -> None:
    bad = write_messages(tmp_path / "bad.mcap", [spoil(Moment(0.1))])
    log = LogFile([*paths, bad])
    assert len(list(picture_features(log, FIELD, processes=1))) == 5
    assert any(said in warning and TOPIC in warning for warning in log.warnings)


def test_pictures_without_a_camera_are_a_clear_mistake(paths: list[Path]) -> None:
    with pytest.raises(FieldlocError, match="camera = FILE in a --mapping"):
        list(picture_features(LogFile(paths[1]), FIELD))


def test_detect_says_what_is_missing(paths: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "seen.mcap"
    assert main(["detect", str(paths[0]), "--field", "kidsize", "-o", str(out)]) == 1
    assert "holds no images" in capsys.readouterr().err
    assert main(["detect", *map(str, paths), "-o", str(out)]) == 1
    assert "--field" in capsys.readouterr().err
    assert not out.exists()
