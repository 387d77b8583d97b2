"""fieldloc locate: pictures to poses, as text, JSON and overlay; what is no picture is one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from program import Call
from seen_scenes import NAO, Look

from fieldloc.field import load_field
from fieldloc.render import Scene, Sensor, render
from fieldloc.vision.picture import UInt8Array, encode, load_picture

LOOK = Look(np.array([-2.2, 0.6, 0.1]), 0.5, 0.18, 0.0)
TRUTH = LOOK.pose[:2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With nao.toml and photo.png, a rendered view of the circle."""
    folder = tmp_path_factory.mktemp("locate")
    numbers = {"width_px": 640, "height_px": 480, "fx_px": 610.0, "fy_px": 610.0, "cx_px": 320.0, "cy_px": 240.0}
    lines = ['model = "pinhole"', *(f"{key} = {value}" for key, value in numbers.items())]
    (folder / "nao.toml").write_text("\n".join(lines), encoding="utf-8")
    scene = Scene(sensor=Sensor(blur_px=0.7, read_noise=2.0))
    picture = render(scene, NAO, load_field("spl"), LOOK.mount, LOOK.pose, np.random.default_rng(0))
    (folder / "photo.png").write_bytes(encode(picture, ".png"))
    return folder


def options(folder: Path) -> list[object]:
    return ["--field", "spl", "--camera", folder / "nao.toml"]


def save(folder: Path, name: str, picture: UInt8Array) -> Path:
    path = folder / name
    path.write_bytes(encode(picture, ".png"))
    return path


def test_a_rendered_photograph_is_located_without_being_told_anything(call: Call, folder: Path) -> None:
    said = call("locate", folder / "photo.png", *options(folder), "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    first, twin = told["hypotheses"][:2]
    at = min((np.array([one["x_m"], one["y_m"]]) for one in (first, twin)), key=lambda p: float(np.hypot(*(p - TRUTH))))
    assert np.hypot(*(at - TRUTH)) < 0.05
    assert first["probability"] == twin["probability"] > 0.45
    assert np.shape(first["covariance"]) == (3, 3)
    assert np.shape(first["camera"]["covariance"]) == (6, 6)
    assert abs(first["camera"]["pitch_rad"] - LOOK.pitch_rad) < 0.01
    assert abs(first["camera"]["height_m"] - LOOK.height_m) < 0.02
    assert told["detections"]["lines"]
    assert all(np.shape(line["covariance_px2"]) == (4, 4) for line in told["detections"]["lines"])
    for post in told["detections"]["posts"]:
        left, upper, right, lower = post["box_px"]
        assert left < right
        assert upper < lower


def test_attitude_and_height_may_be_told(call: Call, folder: Path) -> None:
    told = ["--height-m", "0.52", "--pitch-deg", "9", "--roll-deg", "-1.5"]
    said = call("locate", folder / "photo.png", *options(folder), *told)
    assert said.code == 0, said.err
    assert "none of these" in said.out
    assert "50.0 %" in said.out or "49." in said.out


def test_the_overlay_is_the_photograph_with_a_plan_beside_it(call: Call, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "seen.png"
    assert call("locate", folder / "photo.png", *options(folder), "--overlay", out).code == 0
    drawn, photo = load_picture(out), load_picture(folder / "photo.png")
    assert drawn.shape[0] == photo.shape[0]
    assert drawn.shape[1] > photo.shape[1] + 100
    share = np.mean(np.any(drawn[:, : photo.shape[1]] != photo, axis=2))
    assert 0.001 < share < 0.2  # the map and what was found, and the rest as it was


def test_one_bad_image_does_not_stop_the_others(call: Call, folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "notes.png"
    bad.write_text("no picture")
    said = call("locate", bad, folder / "photo.png", *options(folder), "--json")
    assert said.code == 0
    first, second = json.loads(said.out)
    assert "notes.png" in first["error"]
    assert second["hypotheses"]
    assert said.err.count("notes.png") == 1


@pytest.mark.parametrize("kind", ["text", "empty", "narrow", "missing"])
def test_what_is_no_such_picture_is_one_line(call: Call, folder: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"{kind}.png"
    if kind == "text":
        path.write_text("no picture")
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "narrow":
        save(tmp_path, path.name, np.full((480, 1, 3), 90, dtype=np.uint8))
    said = call("locate", path, *options(folder))
    assert said.code == 1
    assert len(said.lines) == 1
    assert path.name in said.err


@pytest.mark.parametrize("kind", ["black", "white", "green", "noise", "upside down"])
def test_where_nothing_is_seen_there_is_no_pose(call: Call, folder: Path, tmp_path: Path, kind: str) -> None:
    random = np.random.default_rng(3)
    photo = load_picture(folder / "photo.png")
    pictures = {
        "black": np.zeros_like(photo),
        "white": np.full_like(photo, 255),
        "green": np.full_like(photo, (40, 130, 50)),
        "noise": random.integers(0, 256, photo.shape, dtype=np.uint8),
        "upside down": np.ascontiguousarray(photo[::-1, ::-1]),
    }
    path = save(tmp_path, "odd.png", pictures[kind])
    said = call("locate", path, *options(folder), "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    # no picture of this field: if there is an answer at all it is not a sure one
    assert sum(one["probability"] for one in told["hypotheses"][:2]) < 0.9


def test_numbers_that_are_none_are_refused(call: Call, folder: Path) -> None:
    for flag, value in (("--height-m", "-1"), ("--pitch-deg", "nan"), ("--sigma-height-m", "0")):
        said = call("locate", folder / "photo.png", *options(folder), flag, value)
        assert said.code == 1
        assert flag in said.err


def test_a_teams_own_detections_take_the_place_of_ours(call: Call, folder: Path, tmp_path: Path) -> None:
    ours = json.loads(call("locate", folder / "photo.png", *options(folder), "--json").out)
    seen = ours["detections"]
    mine = {
        "image": "photo.png",
        "width_px": 640,
        "height_px": 480,
        "lines": [{"ends_px": one["ends_px"], "sigma_px": 0.2} for one in seen["lines"]],
        "circles": [{"points_px": one["points_px"], "sigma_px": 0.3} for one in seen["circles"]],
    }
    path = tmp_path / "mine.jsonl"
    path.write_text(json.dumps(mine) + "\n", encoding="utf-8")
    told = json.loads(call("locate", folder / "photo.png", *options(folder), "--detections", path, "--json").out)
    assert len(told["detections"]["lines"]) == len(mine["lines"])
    at = [np.array([one["x_m"], one["y_m"]]) for one in told["hypotheses"][:2]]
    assert min(float(np.hypot(*(p - TRUTH))) for p in at) < 0.1
    path.write_text(json.dumps({**mine, "image": "other.png"}), encoding="utf-8")
    said = call("locate", folder / "photo.png", *options(folder), "--detections", path)
    assert (said.code, len(said.lines)) == (1, 1)
    assert "say nothing of it" in said.err
