import numpy as np
import pytest
from board_views import board_picture, board_poses

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.vision.boards import Board, BoardView, find_board
from fieldloc.vision.calibrate import calibrate

CHESS = Board("chessboard", 8, 5, 0.03)
CHARUCO = Board("charuco", 7, 5, 0.04, 0.03)
PINHOLE = Camera("pinhole", 480, 360, 420.0, 415.0, 235.0, 183.0, (-0.25, 0.08, 0.001, -0.002, 0.0))
FISHEYE = Camera("fisheye", 480, 360, 190.0, 190.0, 243.0, 176.0, (0.02, -0.01, 0.003, 0.0))
SIZE = 480, 360


def views(board: Board, camera: Camera, count: int, distance_m: float) -> list[BoardView]:
    found = [find_board(board_picture(board, camera, pose), board) for pose in board_poses(count, distance_m)]
    return [view for view in found if view is not None]


def numbers(camera: Camera) -> list[float]:
    return [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion]


@pytest.mark.parametrize(
    ("board", "camera", "distance_m"),
    [(CHESS, PINHOLE, 0.45), (CHARUCO, PINHOLE, 0.5), (CHESS, FISHEYE, 0.22), (CHARUCO, FISHEYE, 0.25)],
)
def test_boards_seen_through_a_camera_tell_its_inside_within_what_they_say(
    board: Board, camera: Camera, distance_m: float
) -> None:
    seen = views(board, camera, 9, distance_m)
    assert len(seen) >= 7
    done = calibrate(seen, SIZE, camera.model)
    assert np.nanmax(done.rms_px) < 0.25  # blur, noise and a drawing of 40 px a square
    assert list(done.sigmas)[:4] == ["fx_px", "fy_px", "cx_px", "cy_px"]
    errors = np.array(numbers(done.camera)) - numbers(camera)
    sigmas = np.array(list(done.sigmas.values()))
    # corners share the drawing's and the detector's own errors, of which the residuals know half at best
    assert (np.abs(errors[:4]) < 6.0 * sigmas[:4] + 0.2).all()
    assert sigmas[0] < 0.01 * camera.fx_px


def test_a_charuco_board_is_found_when_a_part_of_it_is_hidden() -> None:
    picture = board_picture(CHARUCO, PINHOLE, board_poses(1, 0.5)[0])
    whole = find_board(picture, CHARUCO)
    picture[:, 300:] = 90
    part = find_board(picture, CHARUCO)
    assert whole is not None
    assert part is not None
    assert 8 <= len(part.pixels) < len(whole.pixels)


def test_no_board_is_no_view() -> None:
    blank = np.full((360, 480, 3), 120, dtype=np.uint8)
    assert find_board(blank, CHESS) is None
    assert find_board(blank, CHARUCO) is None


def exact_views(poses: list[np.ndarray]) -> list[BoardView]:
    import cv2

    points = CHESS.corners_m()
    out = []
    for pose in poses:
        pixels, _ = PINHOLE.project(points @ np.asarray(cv2.Rodrigues(pose[:3])[0]).T + pose[3:])
        out.append(BoardView(points, pixels))
    return out


def test_a_view_that_does_not_fit_the_others_is_left_out_and_the_camera_is_exact() -> None:
    good = exact_views(board_poses(8, 0.45))
    bent = BoardView(good[2].points_m, good[2].pixels + 6.0 * np.random.default_rng(1).normal(size=(40, 2)))
    done = calibrate([*good[:2], bent, *good[3:]], SIZE, "pinhole")
    assert np.flatnonzero(np.isnan(done.rms_px)).tolist() == [2]
    assert np.allclose(numbers(done.camera)[:4], numbers(PINHOLE)[:4], atol=0.05)


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (board_poses(2, 0.45), "2 pictures with the board; needs 3"),
        (
            [np.array([0.0, 0.0, 0.1 * n, 0.01 * n, 0.0, 0.5]) for n in range(6)],
            "faces the camera in every picture|determine",
        ),
    ],
)
def test_too_few_views_or_all_from_one_side_are_refused(poses: list[np.ndarray], message: str) -> None:
    with pytest.raises(FieldlocError, match=message):
        calibrate(exact_views(poses), SIZE, "pinhole")


def test_views_that_contradict_each_other_are_refused() -> None:
    rng = np.random.default_rng(5)
    wild = [BoardView(view.points_m, rng.uniform(0, 400, (40, 2))) for view in exact_views(board_poses(5, 0.45))]
    with pytest.raises(FieldlocError):
        calibrate(wild, SIZE, "pinhole")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("chessboard", 2, 5, 0.03), "at least 3x3"),
        (("charuco", 1, 5, 0.03, 0.02), "at least 2x2"),
        (("chessboard", 8, 5, 0.0), "square_m"),
        (("charuco", 8, 5, 0.03, 0.03), "marker_m"),
        (("charuco", 8, 5, 0.03, 0.02, "9X9"), "dictionary"),
        (("charuco", 15, 12, 0.03, 0.02), "fewer markers"),
    ],
)
def test_what_is_no_board_is_a_value_error(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Board(*arguments)
