"""Views drawn at random, the sensor, `fieldloc render`, and the paper's Figure 6."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from fieldloc.camera import Camera
from fieldloc.cli import main
from fieldloc.field import PRESETS, FieldMap, load_field
from fieldloc.ground import project_points, robot_ground_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.render import Scene, Sensor, Turf, render, render_with_truth
from fieldloc.render.random_views import random_view
from fieldloc.vision.picture import load_picture

SMALL = Camera("pinhole", 160, 120, 137.0, 137.0, 79.5, 59.5)
LEVEL = CameraMount(0.5, 0.0, 0.2, 0.0, np.zeros((4, 4)))


@pytest.mark.parametrize("name", PRESETS)
def test_a_random_view_is_the_same_for_the_same_seed_and_another_for_another(name: str) -> None:
    field = load_field(name)

    def picture(seed: int) -> FloatArray:
        random = np.random.default_rng(seed)
        view = random_view(field, random, SMALL)
        return render(view.scene, view.camera, field, view.mount, view.pose, random).astype(np.float64)

    assert np.array_equal(picture(3), picture(3))
    assert np.abs(picture(3) - picture(4)).mean() > 5.0


def test_random_views_are_on_the_field_and_mostly_show_lines() -> None:
    field, with_lines = load_field("kidsize"), 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        view = random_view(field, random, SMALL)
        xmin, ymin, xmax, ymax = field.bounds
        assert xmin - 0.31 < view.pose[0] < xmax + 0.31
        assert ymin - 0.31 < view.pose[1] < ymax + 0.31
        picture, truth = render_with_truth(view.scene, view.camera, field, view.mount, view.pose, random)
        assert picture.std() > 5.0
        with_lines += len(truth.lines) >= 2
    assert with_lines >= 6


def clean(sensor: Sensor) -> FloatArray:
    """A picture of the kidsize field, as floats."""
    scene = Scene(sensor=sensor)
    field = load_field("kidsize")
    return render(scene, SMALL, field, LEVEL, np.zeros(3), np.random.default_rng(5)).astype(np.float64)


def test_noise_has_the_variance_that_the_sensor_says() -> None:
    quiet, noisy = clean(Sensor()), clean(Sensor(read_noise=3.0, shot_noise=8.0))
    turf = quiet[..., 1] == 130.0
    assert (noisy - quiet)[turf, 1].var() == pytest.approx(9.0 + 64.0 * 130.0 / 255.0, rel=0.1)
    assert (noisy - quiet)[turf, 1].mean() == pytest.approx(0.0, abs=0.2)


def test_motion_smears_a_picture_and_leaves_its_middle_where_it_was() -> None:
    line = FieldMap("line", np.array([[[1.6, -3.0], [1.4, 3.0]]]), np.zeros((0, 3)), ())
    profiles = []
    for sensor in (Sensor(), Sensor(motion_px=(0.0, 6.0))):
        picture = render(
            Scene(turf=Turf(border_m=30.0), sensor=sensor), SMALL, line, LEVEL, np.zeros(3), np.random.default_rng(5)
        )
        profiles.append(picture[50:100, 40:120, 2].astype(np.float64) - 40.0)
    still, moved = (profile.sum(axis=0) for profile in profiles)
    assert moved == pytest.approx(still, rel=0.02)
    middles = [np.arange(50) @ profile / profile.sum(axis=0) for profile in profiles]
    assert middles[1] == pytest.approx(middles[0], abs=0.05)
    assert profiles[1].max() < 0.7 * profiles[0].max()


def test_vignetting_darkens_the_corners_and_rolling_exposure_whole_rows() -> None:
    plain = clean(Sensor())
    dark = clean(Sensor(vignetting=0.5)) / plain
    assert dark[60, 80, 1] == pytest.approx(1.0, abs=0.02)
    assert dark[119, 0, 1] == pytest.approx(0.5, abs=0.05)
    rolling = clean(Sensor(rolling=0.06, rolling_rows=60.0)) / plain
    assert np.ptp(rolling[..., 1], axis=1).max() < 0.015
    assert np.ptp(rolling[..., 1], axis=0).min() > 0.1


def test_gamma_leaves_colours_and_moves_the_middle_of_an_edge() -> None:
    plain, bent = clean(Sensor()), clean(Sensor(gamma=2.2))
    flat = ndimage.binary_erosion((plain == 130.0)[..., 1], iterations=4)
    assert bent[flat, 1] == pytest.approx(130.0, abs=1.0)
    assert (bent >= plain - 1.0).all()
    assert (bent > plain + 10.0).any()


# The paper's Figure 6 (see test_paper_figure_6): f / width = 0.428 / 0.454, z is our x, its x is our -y.
FIGURE_6 = Camera("pinhole", 640, 480, 640 * 0.428 / 0.454, 640 * 0.428 / 0.454, 319.5, 239.5)
MOUNT_6 = CameraMount(0.6, -np.radians(30.0), 0.0, 0.0, np.zeros((4, 4)))
POSE_6 = np.array([-2.0, 2.0, 0.0])
TABLE_1 = {
    "right touch line": ((3.0, -2.0), (0.50528, -2.0)),
    "far goal line": ((3.0, -2.0), (3.0, 1.820181)),
    "halfway line": ((0.0, -1.19326), (0.0, 1.9280722)),
    "right side of the far goal area": ((3.0, -1.1), (2.4, -1.1)),
    "its front": ((2.4, -1.1), (2.4, 1.1)),
    "its left side": ((2.4, 1.1), (3.0, 1.1)),
}


def test_figure_6_has_its_lines_where_table_1_says() -> None:
    """Both edges of each line half way up its profile, and their middle on the ground: within a centimetre."""
    field = replace(load_field("kidsize-2014"), landmarks=(), crossbars=())  # as the figure
    picture, truth = render_with_truth(Scene(), FIGURE_6, field, MOUNT_6, POSE_6, np.random.default_rng(0))
    white = (picture[..., 2].astype(np.float64) - 40.0) / (235.0 - 40.0)
    seen_ends = [np.sort(line.ends_m, axis=0) for line in truth.lines]
    across = np.arange(-12.0, 12.05, 0.1)
    for name, ends in TABLE_1.items():
        start, end = np.array(ends)
        gaps = [np.abs(seen - np.sort([start, end], axis=0)).max() for seen in seen_ends]
        assert min(gaps) < 6e-6, name  # printed are six digits of centimetres
        way = (end - start) / np.linalg.norm(end - start)
        points = start + np.linspace(0.05, 0.95, 40)[:, None] * (end - start)
        middles, ahead = (pixels_6(points + step * way) for step in (0.0, 0.01))
        aside = []
        for middle, (u, v) in zip(middles, ahead - middles, strict=True):
            normal = np.array([-v, u]) / np.hypot(u, v)
            profile_px = middle + across[:, None] * normal
            profile = ndimage.map_coordinates(white, profile_px[:, ::-1].T, order=1, mode="nearest")
            top = profile[np.abs(across) < 0.5].max()
            inside = profile > 0.5 * top
            centre = len(across) // 2
            low, high = centre - np.argmin(inside[centre::-1]), centre + np.argmin(inside[centre:])
            if not inside[centre] or inside[centre:].all() or inside[centre::-1].all():
                continue  # where another line meets it
            edges, _ = robot_ground_points(FIGURE_6, MOUNT_6, profile_px[[low, high]])
            x, y = apply(POSE_6, edges.mean(axis=0)) - start
            aside.append(way[0] * y - way[1] * x)
        assert len(aside) > 20, name
        for part in (aside[: len(aside) // 2], aside[len(aside) // 2 :]):
            assert np.median(part) == pytest.approx(0.0, abs=0.01), name


def pixels_6(points: FloatArray) -> FloatArray:
    in_robot = apply(inverse(POSE_6), points)
    return project_points(FIGURE_6, MOUNT_6, np.column_stack([in_robot, np.zeros(len(points))]))[0]


def test_render_writes_a_picture_and_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "view.png"
    assert main(["render", "--field", "spl", "--pose", "-2,0.5,20", "--tilt-deg", "-3", "-o", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    assert load_picture(out).shape == (480, 640, 3)
    truth = json.loads(out.with_suffix(".json").read_text())
    assert truth["pose"] == {"x_m": -2.0, "y_m": 0.5, "heading_rad": pytest.approx(np.radians(20.0))}
    assert truth["mount"]["tilt_rad"] == pytest.approx(np.radians(-3.0))
    again = tmp_path / "again.png"
    assert main(["render", "--field", "spl", "--pose", "-2,0.5,20", "--tilt-deg", "-3", "-o", str(again)]) == 0
    assert again.read_bytes() == out.read_bytes()
    assert main(["render", "--field", "spl", "--pose", "-2,0.5,20", "--tilt-deg", "-3", "--clean", "-o", str(out)]) == 0
    assert again.read_bytes() != out.read_bytes()


def test_render_draws_views_at_random(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text(
        'model = "fisheye"\nwidth_px = 160\nheight_px = 120\nfx_px = 70.0\nfy_px = 70.0\ncx_px = 79.5\ncy_px = 59.5\n'
    )
    many = tmp_path / "many"
    arguments = [
        "--random",
        "2",
        "--camera",
        str(camera),
        "--suffix",
        ".jpg",
        "--seed",
        "7",
        "-o",
        str(many),
    ]
    assert main(["render", *arguments]) == 0
    assert "2 pictures" in capsys.readouterr().out
    names = sorted(path.name for path in many.iterdir())
    assert names == ["000000.jpg", "000000.json", "000001.jpg", "000001.json"]
    truths = [json.loads((many / name).read_text()) for name in names[1::2]]
    assert truths[0]["pose"] != truths[1]["pose"]
    assert load_picture(many / "000001.jpg").shape == (120, 160, 3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "a.png"], "give --pose"),
        (["--pose", "1,2", "-o", "a.png"], "is not X,Y,HEADING_DEG"),
        (["--pose", "1,2,3", "-o", "a.xyz"], ".xyz"),
        (["--pose", "1,2,3", "-o", "a.json"], "the truth goes there"),
        (["--pose", "1,2,3", "--random", "2", "-o", "many"], "--random draws it"),
        (["--random", "2", "--pan-deg", "5", "-o", "many"], "--pan-deg"),
        (["--random", "0", "-o", "many"], "'0' is not a number of views"),
        (["--random", "2", "--suffix", "jpg", "-o", "many"], "jpg"),
        (["--pose", "1,2,3", "--height-m", "-1", "-o", "a.png"], "is not a number above 0"),
        (["--pose", "1,2,3", "--tilt-deg", "nan", "-o", "a.png"], "is not an angle"),
        (["--pose", "1,2,3", "--camera", "none.toml", "-o", "a.png"], "no such camera file"),
        (["--pose", "1,2,3", "--field", "none.toml", "-o", "a.png"], "no such field map"),
        (["--pose", "1,2,3", "--quality", "0", "-o", "a.jpg"], "from 1 to 100"),
    ],
)
def test_what_render_cannot_do_is_one_clear_line(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["render", *arguments]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("a.*"))
