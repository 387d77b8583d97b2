"""Calibration boards in pictures: chessboards, and ChArUco boards, of which a part is enough."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array

Kind = Literal["chessboard", "charuco"]
DICTIONARIES = ("4X4_50", "4X4_100", "4X4_250", "5X5_50", "5X5_100", "5X5_250", "6X6_50", "6X6_250", "ARUCO_ORIGINAL")

_FEWEST_CORNERS = 8  # of a ChArUco board: fewer say little of where it is
_SEARCH_PX = 1600  # chessboards are sought in pictures no larger than this


@dataclass(frozen=True, slots=True)
class Board:
    """columns, rows: of inner corners, where four squares meet. square_m: the side of a square. marker_m: that of a
    ChArUco board's marker, of the dictionary. ValueError where this is no board."""

    kind: Kind
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 2:
            raise ValueError(f"a board of {self.columns}x{self.rows} inner corners; needs at least 2x2")
        if self.kind == "chessboard" and min(self.columns, self.rows) < 3:
            raise ValueError(f"a chessboard of {self.columns}x{self.rows} inner corners; needs at least 3x3")
        if self.square_m <= 0.0:
            raise ValueError(f"square_m is {self.square_m}, must be above 0")
        if self.kind == "charuco" and not 0.0 < self.marker_m < self.square_m:
            raise ValueError(f"marker_m is {self.marker_m}, must be above 0 and below the square's {self.square_m}")
        if self.dictionary not in DICTIONARIES:
            raise ValueError(f"dictionary is {self.dictionary!r}, must be one of: {', '.join(DICTIONARIES)}")
        squares = (self.columns + 1) * (self.rows + 1) // 2
        if self.kind == "charuco" and squares > self._markers().bytesList.shape[0]:
            raise ValueError(f"the dictionary {self.dictionary} has fewer markers than the board's {squares}")

    def corners_m(self) -> FloatArray:
        """(columns rows, 3) of the inner corners on the board, row by row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.asarray(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * self.square_m, dtype=np.float64)

    def charuco(self) -> cv2.aruco.CharucoBoard:
        return cv2.aruco.CharucoBoard((self.columns + 1, self.rows + 1), self.square_m, self.marker_m, self._markers())

    def _markers(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """points_m: (n, 3) corners on the board, pixels: (n, 2) where they are seen."""

    points_m: FloatArray
    pixels: FloatArray


def find_board(picture: UInt8Array, board: Board) -> BoardView | None:
    """The board's corners in a picture, to parts of a pixel; None where it is not seen, or a chessboard not whole."""
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return _chessboard(grey, board) if board.kind == "chessboard" else _charuco(grey, board)


def _chessboard(grey: UInt8Array, board: Board) -> BoardView | None:
    size = board.columns, board.rows
    factor = min(1.0, _SEARCH_PX / max(grey.shape))
    small = grey if factor == 1.0 else cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
    if not found:
        return None
    pixels = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / factor - 0.5
    return (
        BoardView(board.corners_m(), pixels) if factor == 1.0 else BoardView(board.corners_m(), _refined(grey, pixels))
    )


def _refined(grey: UInt8Array, pixels: FloatArray) -> FloatArray:
    """Corners found in a smaller picture, in the whole one; the window stays between neighbouring corners."""
    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    half = int(np.clip(0.3 * np.median(steps), 3, 15))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    refined = cv2.cornerSubPix(grey, pixels.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _charuco(grey: UInt8Array, board: Board) -> BoardView | None:
    found: tuple[object, ...] = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(grey)
    corners, numbers = found[:2]  # None where there are none, whatever the stubs say
    if corners is None or numbers is None or len(np.ravel(np.asarray(numbers))) < _FEWEST_CORNERS:
        return None
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    points = board.corners_m()[np.ravel(np.asarray(numbers)).astype(np.intp)]
    flat = np.linalg.matrix_rank(points[:, :2] - points[0, :2], tol=1e-9) < 2
    return None if flat else BoardView(points, pixels)
