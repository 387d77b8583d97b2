"""Pictures of calibration boards through known cameras, by asking of each pixel where on the board it looks."""

import cv2
import numpy as np

from fieldloc.camera import Camera
from fieldloc.pose import FloatArray
from fieldloc.vision.boards import Board
from fieldloc.vision.picture import UInt8Array

_PX_PER_SQUARE = 40
_FINER = 3  # rays a pixel, each way


def board_poses(count: int, distance_m: float, seed: int = 3) -> list[FloatArray]:
    """(6,) turns and places of a board before the camera, tilted to several sides and all over the picture."""
    rng = np.random.default_rng(seed)
    poses = []
    for n in range(count):
        turn = 0.55 * np.array([np.cos(2.4 * n), np.sin(2.4 * n), 0.3 * rng.uniform(-1, 1)])
        place = distance_m * np.array([0.22 * np.cos(1.1 * n), 0.16 * np.sin(1.7 * n), rng.uniform(0.85, 1.3)])
        poses.append(np.concatenate([turn, place]))
    return poses


def board_picture(board: Board, camera: Camera, pose: FloatArray, noise: float = 1.5) -> UInt8Array:
    """pose: of the board's middle."""
    texture, corner_px = _texture(board)
    turn = np.asarray(cv2.Rodrigues(pose[:3])[0])
    u, v = np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px, dtype=np.float64)
    rays, _ = camera.ray(np.stack(np.meshgrid(u, v), axis=-1))
    inward = rays @ turn  # in the board's axes
    eye = -turn.T @ pose[3:]
    with np.errstate(all="ignore"):
        reach = -eye[2] / inward[..., 2]
        at = eye[:2] + reach[..., None] * inward[..., :2]
    middle = 0.5 * board.square_m * np.array([board.columns - 1, board.rows - 1])
    at = np.where((reach > 0.0)[..., None], (at + middle) / board.square_m * _PX_PER_SQUARE + corner_px, -1e4)
    # between pixels' middles the board is as good as flat
    at = cv2.resize(at.astype(np.float32), None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_LINEAR)
    seen = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=130.0)
    grey = cv2.resize(seen, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA).astype(np.float64)
    grey = cv2.GaussianBlur(grey, (0, 0), 0.6)
    grey += np.random.default_rng(7).normal(0.0, noise, grey.shape)
    return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _texture(board: Board) -> tuple[UInt8Array, float]:
    """The board's drawing with a white border, and the place of its first inner corner in it."""
    columns, rows = board.columns + 1, board.rows + 1
    size = columns * _PX_PER_SQUARE, rows * _PX_PER_SQUARE
    if board.kind == "charuco":
        drawing = np.asarray(board.charuco().generateImage(size), dtype=np.uint8)
    else:
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        squares = np.where((x + y) % 2 == 0, 0, 255).astype(np.uint8)
        drawing = np.kron(squares, np.ones((_PX_PER_SQUARE, _PX_PER_SQUARE), dtype=np.uint8))
    drawing = np.clip(drawing, 20, 235)
    bordered = cv2.copyMakeBorder(drawing, *[_PX_PER_SQUARE] * 4, cv2.BORDER_CONSTANT, value=235.0)
    return np.asarray(bordered, dtype=np.uint8), 2.0 * _PX_PER_SQUARE - 0.5
