from pathlib import Path

import cv2
import numpy as np
import pytest
from board_views import board_picture, board_poses

from fieldloc.camera import Camera, camera_of_view, camera_to_toml, load_camera
from fieldloc.cli import main
from fieldloc.vision.boards import Board

CAMERA = Camera("pinhole", 320, 240, 300.0, 300.0, 160.0, 118.0, (-0.2, 0.05, 0.0, 0.0, 0.0))
BOARD = Board("chessboard", 7, 5, 0.03)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    for n, pose in enumerate(board_poses(9, 0.42)):
        cv2.imwrite(str(folder / f"{n}.png"), board_picture(BOARD, CAMERA, pose))
    return folder


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def test_a_field_of_view_makes_a_camera_that_sees_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "camera.toml"
    for option, ends in ((), ([-0.5, 239.5], [639.5, 239.5])), (("--vertical",), ([319.5, -0.5], [319.5, 479.5])):
        assert run(capsys, "camera", "--fov-deg", 60.9, "--size", "640x480", *option, "-o", out)[0] == 0
        rays, _ = load_camera(out).ray(np.array(ends))
        assert np.degrees(np.arccos(rays[0] @ rays[1])) == pytest.approx(60.9, abs=1e-9)
    assert run(capsys, "camera", "--fov-deg", 72.6, "--size", "640x480", "--diagonal", "-o", out)[0] == 0
    rays, _ = load_camera(out).ray(np.array([[-0.5, -0.5], [639.5, 479.5]]))
    assert np.degrees(np.arccos(rays[0] @ rays[1])) == pytest.approx(72.6, abs=1e-9)


def test_a_camera_file_reads_back_digit_by_digit(tmp_path: Path) -> None:
    for camera in (
        CAMERA,
        camera_of_view(640, 480, 1.0),
        Camera("fisheye", 9, 9, 1 / 3, 1.0, -2.0, 0.0, (1e-17, 0, 0, 0)),
    ):
        path = tmp_path / "camera.toml"
        path.write_text(camera_to_toml(camera))
        assert load_camera(path) == camera


def test_pictures_of_a_board_make_a_camera_and_what_is_none_is_named(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blank, other = tmp_path / "blank.png", tmp_path / "other.png"
    cv2.imwrite(str(blank), np.full((240, 320, 3), 99, dtype=np.uint8))
    cv2.imwrite(str(other), cv2.resize(cv2.imread(str(pictures / "0.png")), (480, 360)))
    out = tmp_path / "camera.toml"
    images = [*sorted(pictures.iterdir()), blank, other, tmp_path / "missing.jpg"]
    options = "--board", "chessboard", "--corners", "7x5", "--square-m", 0.03, "-o", out
    code, told, warned = run(capsys, "camera", *images, *options)
    assert code == 0
    camera = load_camera(out)
    assert (camera.width_px, camera.height_px) == (320, 240)
    assert camera.fx_px == pytest.approx(300.0, rel=0.01)
    assert "fx_px = " in told
    assert f"{pictures / '0.png'}: 0." in told
    assert "blank.png: no chessboard of 7x5 inner corners is seen; left out" in warned
    assert "other.png: is 480x360, most are 320x240; left out" in warned
    assert "missing.jpg: no such picture" in warned


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give either images of a board, or --fov-deg and --size"),
        (("--fov-deg", "60"), "--fov-deg: needs --size"),
        (("--fov-deg", "190", "--size", "640x480"), "between 0 and 180"),
        (("--fov-deg", "60", "--size", "640"), "'640' is no size"),
        (("--fov-deg", "60", "--size", "640x480", "--fisheye"), "leave out"),
        (("0.png", "--size", "640x480"), "go with --fov-deg"),
        (("0.png", "--board", "chessboard"), "need --board, --corners and --square-m"),
        (("0.png", "--board", "charuco", "--corners", "7x5", "--square-m", "1"), "needs --marker-m"),
        (("0.png", "--board", "chessboard", "--corners", "2x5", "--square-m", "1"), "at least 3x3"),
        (
            ("0.png", "--board", "chessboard", "--corners", "6x4", "--square-m", "1"),
            "no board is seen in any of 1 images",
        ),
        (
            ("0.png", "1.png", "--board", "chessboard", "--corners", "7x5", "--square-m", "1"),
            "2 pictures with the board",
        ),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file(
    arguments: tuple[str, ...], message: str, pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camera.toml"
    given = [pictures / argument if argument.endswith(".png") else argument for argument in arguments]
    code, _, told = run(capsys, "camera", *given, "-o", out)
    assert code == 1
    assert message in told
    assert len([line for line in told.splitlines() if "warning" not in line]) == 1
    assert not list(tmp_path.iterdir())
