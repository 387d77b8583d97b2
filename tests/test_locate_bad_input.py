"""Whatever is given as a photograph, there is an answer within seconds: a pose, none, or one clear line."""

import json
from collections.abc import Callable
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import pytest
from program import Call
from seen_scenes import NAO, Look

from fieldloc.camera import Camera
from fieldloc.field import load_field
from fieldloc.locate import CameraPrior, Located, locate, mixture
from fieldloc.render import Scene, Sensor, render
from fieldloc.vision.detect import detect
from fieldloc.vision.picture import UInt8Array, encode

FIELD = load_field("spl")
LOOK = Look(np.array([-2.2, 0.6, 0.1]), 0.5, 0.18, 0.0)
TURF = (40, 140, 50)
LIMIT_S = 6.0  # of the processor, whatever else it does


@pytest.fixture(scope="module")
def photo() -> UInt8Array:
    scene = Scene(sensor=Sensor(blur_px=0.7, read_noise=2.0))
    return render(scene, NAO, FIELD, LOOK.mount, LOOK.pose, np.random.default_rng(0))


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("camera") / "nao.toml"
    numbers = {"width_px": 640, "height_px": 480, "fx_px": 610.0, "fy_px": 610.0, "cx_px": 320.0, "cy_px": 240.0}
    path.write_text("\n".join(['model = "pinhole"', *(f"{key} = {value}" for key, value in numbers.items())]))
    return path


def salted(height: int, width: int) -> UInt8Array:
    white = np.random.default_rng(1).random((height, width, 1)) < 0.02
    return np.where(white, 255, TURF).astype(np.uint8)


def striped(height: int, width: int) -> UInt8Array:
    white = (np.arange(width) // 6 % 2 > 0)[None, :, None]
    return np.repeat(np.where(white, 240, TURF), height, axis=0).astype(np.uint8)


def noise(height: int, width: int) -> UInt8Array:
    return np.random.default_rng(2).integers(0, 256, (height, width, 3), dtype=np.uint8)


def answer(picture: UInt8Array) -> Located:
    """Told nothing, by a camera of that size, in time."""
    height, width = picture.shape[:2]
    focal = 610.0 * width / 640.0
    camera = Camera("pinhole", width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    start = process_time()
    located = locate(detect(picture, FIELD.colours, camera), camera, FIELD)
    mixture(located, FIELD, 0)
    assert process_time() - start < LIMIT_S
    return located


def sure(located: Located) -> float:
    """The probability of the first place, with its twin."""
    return sum(one.probability for one in located.hypotheses[:2])


@pytest.mark.parametrize("size", [(1, 1), (1, 640), (480, 1), (2, 2), (9, 7), (40, 30)])
def test_a_picture_of_hardly_a_pixel_has_no_pose(photo: UInt8Array, size: tuple[int, int]) -> None:
    assert not answer(np.ascontiguousarray(photo[: size[0], : size[1]])).hypotheses


@pytest.mark.parametrize("make", [salted, striped, noise])
@pytest.mark.parametrize("size", [(480, 640), (4320, 7680)])
def test_what_is_no_field_gives_no_sure_answer(make: Callable[[int, int], UInt8Array], size: tuple[int, int]) -> None:
    assert sure(answer(make(*size))) < 0.5


@pytest.mark.parametrize("seed", range(12))
def test_specks_that_line_up_by_chance_are_hardly_ever_a_pose(seed: int) -> None:
    random = np.random.default_rng(seed)
    specks = random.random((480, 640, 1)) < 0.02
    located = answer(np.where(specks, 255, TURF).astype(np.uint8))
    assert sure(located) < 0.25
    assert not located.hypotheses or located.none < 0.99


def test_a_huge_photograph_is_located_as_the_small_one(photo: UInt8Array) -> None:
    located = answer(np.asarray(cv2.resize(photo, (7680, 5760), interpolation=cv2.INTER_CUBIC), dtype=np.uint8))
    away = [float(np.hypot(*(one.pose[:2] - LOOK.pose[:2]))) for one in located.hypotheses[:2]]
    assert min(away) < 0.1
    assert sure(located) > 0.9


def test_a_photograph_on_its_head_is_not_taken_for_one_of_the_field(photo: UInt8Array) -> None:
    turned = np.ascontiguousarray(photo[::-1, ::-1])
    told = CameraPrior.told(LOOK.height_m, LOOK.pitch_rad, LOOK.roll_rad)
    for prior in (None, told):
        assert sure(locate(detect(turned, FIELD.colours, NAO), NAO, FIELD, prior)) < 0.9


def files(photo: UInt8Array) -> dict[str, bytes]:
    """The same photograph in other ways of writing pixels."""
    alpha = np.dstack([photo, np.full(photo.shape[:2], 200, np.uint8)])
    return {
        "deep.png": encode(photo.astype(np.uint16) * 257, ".png"),  # type: ignore[arg-type]  # 16 bit
        "alpha.png": encode(alpha, ".png"),
        "photo.jpg": encode(photo, ".jpg", 90),
    }


@pytest.mark.parametrize("name", ["deep.png", "alpha.png", "photo.jpg"])
def test_however_its_pixels_are_written_a_photograph_is_located(
    call: Call, photo: UInt8Array, camera_file: Path, tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(files(photo)[name])
    said = call("locate", path, "--field", "spl", "--camera", camera_file, "--json")
    assert said.code == 0, said.err
    places = [np.array([one["x_m"], one["y_m"]]) for one in json.loads(said.out)["hypotheses"][:2]]
    assert min(float(np.hypot(*(place - LOOK.pose[:2]))) for place in places) < 0.05


def test_a_grey_photograph_gives_no_wrong_answer(
    call: Call, photo: UInt8Array, camera_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "grey.png"
    path.write_bytes(encode(np.asarray(cv2.cvtColor(photo, cv2.COLOR_BGR2GRAY), dtype=np.uint8), ".png"))
    said = call("locate", path, "--field", "spl", "--camera", camera_file)
    assert said.code == 0, said.err
    assert "no pose" in said.out


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
def test_a_photograph_that_was_cut_off_is_located_or_refused(
    call: Call, photo: UInt8Array, camera_file: Path, tmp_path: Path, share: float
) -> None:
    data = encode(photo, ".jpg", 90)
    path = tmp_path / "cut.jpg"
    path.write_bytes(data[: int(share * len(data))])
    said = call("locate", path, "--field", "spl", "--camera", camera_file, "--json")
    if said.code:
        assert len(said.lines) == 1
        assert "cut.jpg" in said.err
        return
    for one in json.loads(said.out)["hypotheses"][:2]:
        off = min(float(np.hypot(one["x_m"] - x, one["y_m"] - y)) for x, y in (LOOK.pose[:2], -LOOK.pose[:2]))
        assert off < 0.1 or one["probability"] < 0.45


def test_a_folder_is_no_photograph(call: Call, camera_file: Path, tmp_path: Path) -> None:
    said = call("locate", tmp_path, "--field", "spl", "--camera", camera_file)
    assert said.code == 1
    assert len(said.lines) == 1
    assert tmp_path.name in said.err
