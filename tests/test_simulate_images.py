"""simulate --images: what the camera of a simulated game truly shows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.cli import main
from fieldloc.field import load_field
from fieldloc.measurements import Compass, ImageFeatures, Odometry, Truth
from fieldloc.render import Scene, render
from fieldloc.vision.picture import decode
from logs.reader import LogFile
from logs.simulate import PictureSettings, Scenario, load_scenario, simulate, with_camera
from logs.simulate.game import play

FIELD = load_field("kidsize")
SECONDS, HZ = 0.9, 3.0
SMALL = with_camera(load_scenario("kidsize-game"), (160, 120), HZ)


def simulated(path: Path, pictures: PictureSettings | None, scenario: Scenario = SMALL) -> LogFile:
    simulate(path, scenario, 3, SECONDS, pictures=pictures)
    return LogFile(path)


@pytest.fixture(scope="module")
def with_pictures(tmp_path_factory: pytest.TempPathFactory) -> LogFile:
    return simulated(tmp_path_factory.mktemp("game") / "game.mcap", PictureSettings())


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> LogFile:
    return simulated(tmp_path_factory.mktemp("game") / "game.mcap", None)


def test_all_but_what_is_seen_is_as_without_pictures(with_pictures: LogFile, without: LogFile) -> None:
    for kind in (Odometry, Compass, Truth):
        one, other = (list(log.records(kind)) for log in (with_pictures, without))
        assert len(one) == len(other) > 0
        assert [each.stamp_ns for each in one] == [each.stamp_ns for each in other]
    assert [*with_pictures.records(Camera)] == [*without.records(Camera)] == [SMALL.vision.camera]
    assert not list(with_pictures.records(ImageFeatures))


def test_each_image_has_a_picture_and_the_mount_that_the_robot_believes(
    with_pictures: LogFile, without: LogFile
) -> None:
    seen = list(without.records(ImageFeatures))
    pictures = list(with_pictures.images())
    assert [part.stamp_ns for part in pictures] == [features.stamp_ns for features in seen]
    assert len(pictures) >= 2
    for part, features in zip(pictures, seen, strict=True):
        assert decode(part.data, "picture").shape == (120, 160, 3)
        mount = with_pictures.mount(part)
        assert mount is not None
        for name in ("x_m", "y_m", "height_m", "pan_rad", "tilt_rad", "roll_rad"):
            assert getattr(mount, name) == pytest.approx(getattr(features.mount, name), abs=1e-9), name


def test_a_picture_shows_the_field_from_where_the_camera_truly_was(with_pictures: LogFile) -> None:
    game = play(replace(SMALL, duration_s=SECONDS), FIELD, 3)
    shots = game.camera.shots(game.course)
    camera, random = SMALL.vision.camera, np.random.default_rng(0)
    turns = np.array([-0.06, -0.03, 0.0, 0.03, 0.06])
    for k, part in enumerate(with_pictures.images()):
        shot = shots.shot(k)
        assert part.stamp_ns == shot.stamp_ns
        whiteness = decode(part.data, "picture").min(axis=2).astype(np.float64)
        alike = []
        for turn in turns:
            drawn = render(Scene(), camera, FIELD, shot.mount, shot.pose + [0.0, 0.0, turn], random)
            below = drawn[..., 2] != 140  # not the ceiling: there is a hall there
            alike.append(np.corrcoef(drawn.min(axis=2)[below], whiteness[below])[0, 1])
        assert turns[int(np.argmax(alike))] == 0.0


def test_the_same_seed_makes_the_same_bytes_in_one_process_and_in_several(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    game = replace(SMALL, duration_s=1.7)
    simulate(tmp_path / "several.mcap", game, 4, pictures=PictureSettings())
    monkeypatch.setattr("logs.simulate.pictures._FEW", 1000)
    simulate(tmp_path / "one.mcap", game, 4, pictures=PictureSettings())
    assert (tmp_path / "several.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()
    assert len(list(LogFile(tmp_path / "one.mcap").images())) >= 4


def test_observations_stay_beside_the_pictures_when_asked_for(tmp_path: Path, without: LogFile) -> None:
    log = simulated(tmp_path / "both.mcap", PictureSettings(quality=60, observations=True))
    both, alone = (list(each.records(ImageFeatures)) for each in (log, without))
    assert [one.stamp_ns for one in both] == [one.stamp_ns for one in alone]
    assert len(both) == len(list(log.images()))


def test_a_smaller_camera_shows_the_same() -> None:
    scenario = load_scenario("kidsize-game")
    large, small = scenario.vision.camera, with_camera(scenario, (320, 240), None).vision.camera
    corners = np.array([[-0.5, -0.5], [large.width_px - 0.5, large.height_px - 0.5]])
    halved = np.array([[-0.5, -0.5], [319.5, 239.5]])
    np.testing.assert_allclose(large.ray(corners)[0], small.ray(halved)[0], atol=1e-12)
    assert with_camera(scenario, None, 2.5).vision.timing.images_hz == 2.5


def test_simulate_images_as_a_person_types_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "game.mcap"
    typed = f"simulate --scenario quiet --images --image-size 64x48 --image-hz 4 --duration-s 0.7 -o {out}"
    assert main(typed.split()) == 0
    assert "/image" in capsys.readouterr().out
    (camera,) = LogFile(out).records(Camera)
    assert (camera.width_px, camera.height_px) == (64, 48)
    assert 2 <= len(list(LogFile(out).images())) <= 3
