"""A camera's inside from pictures of a board that are taken from several sides."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.lens import Model
from fieldloc.pose import FloatArray
from fieldloc.vision.boards import BoardView

FEWEST_VIEWS = 3
NAMES = ("fx_px", "fy_px", "cx_px", "cy_px")
_DISTORTION = {"pinhole": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}
_OUTLIER = 3.0  # times the views' median error, beyond which a view is left out
_OUTLIER_PX = 0.5  # views better than this are never
_LARGEST_ERROR_PX = 5.0  # of a whole calibration
_LOOSEST = 0.03  # standard deviation of a focal length, as a share of it
_SAME_SIDE_RAD = np.radians(8.0)  # boards that are turned less against the picture say nothing of the focal length
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """sigmas: standard deviation of each of the camera's numbers, by name. rms_px: (views,) reprojection error of each
    view, NaN where it was left out as not fitting the others."""

    camera: Camera
    sigmas: dict[str, float]
    rms_px: FloatArray


def calibrate(views: list[BoardView], size_px: tuple[int, int], model: Model) -> Calibration:
    """The camera that sees the boards so. size_px: width and height of all pictures.

    FieldlocError says why the views do not tell: too few of them, all from one side, or contradicting each other.
    """
    if len(views) < FEWEST_VIEWS:
        raise FieldlocError(f"{len(views)} pictures with the board; needs {FEWEST_VIEWS}, better 10 or more")
    used = np.arange(len(views))
    solution = _solve([views[n] for n in used], size_px, model)
    limit = max(_OUTLIER * float(np.median(solution.rms_px)), _OUTLIER_PX)
    if (solution.rms_px > limit).any() and np.count_nonzero(solution.rms_px <= limit) >= FEWEST_VIEWS:
        used = used[solution.rms_px <= limit]
        solution = _solve([views[n] for n in used], size_px, model)
    total = float(np.sqrt(np.mean(solution.rms_px**2)))
    if not total < _LARGEST_ERROR_PX:
        raise FieldlocError(
            f"the pictures contradict each other by {total:.1f} px; check --corners and the lens; is the board flat?"
        )
    loosest = max(solution.sigmas["fx_px"] / solution.camera.fx_px, solution.sigmas["fy_px"] / solution.camera.fy_px)
    if not loosest < _LOOSEST:
        raise FieldlocError(
            f"the focal length is left open by {100 * loosest:.0f} %; take pictures with the board tilted, at several "
            "distances and up to the picture's corners"
        )
    rms_px = np.full(len(views), np.nan)
    rms_px[used] = solution.rms_px
    return replace(solution, rms_px=rms_px)


def _solve(views: list[BoardView], size_px: tuple[int, int], model: Model) -> Calibration:
    points = [view.points_m.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        if model == "pinhole":
            _, matrix, distortion, turns, places = cv2.calibrateCamera(points, pixels, size_px, None, None)
        else:
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
            _, matrix, distortion, turns, places = cv2.fisheye.calibrate(
                [part.reshape(1, -1, 3).astype(np.float64) for part in points],
                [part.reshape(1, -1, 2).astype(np.float64) for part in pixels],
                size_px,
                np.eye(3),
                np.zeros((4, 1)),
                flags=flags,
                criteria=_CRITERIA,
            )
        camera = _camera(model, size_px, np.asarray(matrix), np.ravel(distortion))
    except (cv2.error, ValueError):
        raise FieldlocError(
            "the pictures do not determine a camera; take some with the board tilted to several sides"
        ) from None
    turned = [np.asarray(cv2.Rodrigues(turn)[0]) for turn in turns]
    if max(np.arccos(np.clip(abs(turn[2, 2]), 0.0, 1.0)) for turn in turned) < _SAME_SIDE_RAD:
        raise FieldlocError("the board faces the camera in every picture; take some with it tilted to several sides")
    poses = np.array([[*np.ravel(turn), *np.ravel(place)] for turn, place in zip(turns, places, strict=True)])
    return _with_errors(camera, poses, views)


def _camera(model: Model, size_px: tuple[int, int], matrix: FloatArray, distortion: FloatArray) -> Camera:
    count = len(_DISTORTION[model])
    numbers = [float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])]
    width_px, height_px = size_px
    fx_px, fy_px, cx_px, cy_px = numbers
    lens = tuple(float(part) for part in distortion[:count])
    return Camera(model, width_px, height_px, fx_px, fy_px, cx_px, cy_px, lens)


def _with_errors(camera: Camera, poses: FloatArray, views: list[BoardView]) -> Calibration:
    """Residuals at the solution, and what they leave open of each number, all boards' poses being unknown too."""
    numbers = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])
    scale = np.concatenate([np.full(4, 1e-2), np.full(len(numbers) - 4, 1e-6)])
    information = np.zeros((len(numbers), len(numbers)))
    squares, count, rms_px = 0.0, 0, []
    for pose, view in zip(poses, views, strict=True):
        residual = (_seen(camera, numbers, pose, view) - view.pixels).ravel()
        inner = _slopes(partial(_seen_by, camera, pose, view), numbers, scale)
        outer = _slopes(partial(_seen_from, camera, numbers, view), pose, np.full(6, 1e-6))
        if not (np.isfinite(outer).all() and np.isfinite(inner).all()):
            information[:] = np.nan
            break
        cross = outer.T @ inner
        information += inner.T @ inner - cross.T @ np.linalg.pinv(outer.T @ outer, hermitian=True) @ cross
        squares, count = squares + float(residual @ residual), count + residual.size
        rms_px.append(float(np.sqrt(2.0 * np.mean(residual**2))))
    if not np.isfinite(information).all():  # corners where the lens that was found has no image
        raise FieldlocError("the pictures do not determine a camera; take some with the board tilted to several sides")
    variance = squares / max(count - len(numbers) - 6 * len(views), 1)
    covariance = np.linalg.pinv(information, hermitian=True) * variance
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    names = NAMES + _DISTORTION[camera.model]
    return Calibration(camera, dict(zip(names, sigmas.tolist(), strict=True)), np.array(rms_px))


def _seen_by(camera: Camera, pose: FloatArray, view: BoardView, numbers: FloatArray) -> FloatArray:
    return _seen(camera, numbers, pose, view)


def _seen_from(camera: Camera, numbers: FloatArray, view: BoardView, pose: FloatArray) -> FloatArray:
    return _seen(camera, numbers, pose, view)


def _seen(camera: Camera, numbers: FloatArray, pose: FloatArray, view: BoardView) -> FloatArray:
    """(n, 2) pixels of a board's corners. numbers: of the camera; pose: (6,) the board's turn and place before it."""
    fx_px, fy_px, cx_px, cy_px, *lens = numbers.tolist()
    changed = Camera(camera.model, camera.width_px, camera.height_px, fx_px, fy_px, cx_px, cy_px, tuple(lens))
    pixels, _ = changed.project(view.points_m @ np.asarray(cv2.Rodrigues(pose[:3])[0]).T + pose[3:])
    return pixels


def _slopes(function: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """(m, n) of a function's m values with n numbers, by central differences."""
    columns = []
    for n, step in enumerate(steps):
        nudge = np.zeros_like(at)
        nudge[n] = step
        columns.append((function(at + nudge) - function(at - nudge)).ravel() / (2.0 * step))
    return np.stack(columns, axis=1)
