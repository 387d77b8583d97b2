"""Poses from what lines say and which of the map's landmarks the posts are, many readings of one image at a time.

The unknowns are the pose and the mount's four errors, which lines and posts share. Everything is linear in them near a
solution, so a reading's likelihood is one Gaussian integral over all seven.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.image_anchors import Anchors
from fieldloc.image_map import ImageMap
from fieldloc.image_posts import NUMBERS, PostsSeen
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LOG_2PI = float(np.log(2.0 * np.pi))
_LONGEST_STEP = np.array([1.0, 1.0, 0.3])  # a linearisation is good for no more
_WEAK = np.diag([1e-9, 1e-9, 1e-9, 1.0, 1.0, 1.0, 1.0])  # of the mount's whitened errors; the pose is free but finite
_ROWS = 4  # of an anchor and a window


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Which part of a bent likelihood is meant: where a polar coordinate of the robot about `centre` (k, 2), its
    direction or, where by_distance (k,) is set, its log distance, is `middle` (k,) up to a standard deviation `width`.
    """

    centre: FloatArray
    middle: FloatArray
    by_distance: NDArray[np.bool_]
    width: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """k ways to read an image: `anchors` (k,) rows, `matched` (k, p) landmark of each post or -1, `poses` (k, 3)."""

    anchors: IntArray
    matched: IntArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.poses)

    @staticmethod
    def none(posts: int) -> "Readings":
        return Readings(np.zeros(0, dtype=np.intp), np.zeros((0, posts), dtype=np.intp), np.zeros((0, 3)))

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Readings":
        return Readings(self.anchors[rows], self.matched[rows], self.poses[rows])

    def beside(self, other: "Readings") -> "Readings":
        return Readings(
            np.concatenate([self.anchors, other.anchors]),
            np.concatenate([self.matched, other.matched]),
            np.concatenate([self.poses, other.poses]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Readings at their best poses. covariances: (k, 3, 3) robot frame. log_integrals: (k,) of the density of all that
    is matched over poses and mount errors, the anchor's weight included. misfit: (k,) chi-square of `degrees` (k,)."""

    readings: Readings
    covariances: FloatArray
    log_integrals: FloatArray
    misfit: FloatArray
    degrees: IntArray

    def __len__(self) -> int:
        return len(self.misfit)

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Solved":
        return Solved(
            self.readings.take(rows),
            self.covariances[rows],
            self.log_integrals[rows],
            self.misfit[rows],
            self.degrees[rows],
        )

    def beside(self, other: "Solved") -> "Solved":
        return Solved(
            self.readings.beside(other.readings),
            np.concatenate([self.covariances, other.covariances]),
            np.concatenate([self.log_integrals, other.log_integrals]),
            np.concatenate([self.misfit, other.misfit]),
            np.concatenate([self.degrees, other.degrees]),
        )


def solve(
    readings: Readings, anchors: Anchors, posts: PostsSeen, field: ImageMap, steps: int, windows: Windows | None = None
) -> Solved:
    """So many steps of Gauss and Newton from the readings' poses; all else is as the last of them sees it."""
    count, size = readings.matched.shape
    rows, poses = readings.anchors, readings.poses
    is_matched = readings.matched >= 0
    at, of_anchor = anchors.poses[rows], anchors.whitening[rows]
    marks = field.landmarks[readings.matched] if size else np.zeros((count, 0, 2))
    of_posts = posts.whitening_both * is_matched[..., None, None]
    offset = posts.white_offset * is_matched[..., None]
    error = np.zeros((count, _ROWS + NUMBERS * size))
    jacobian = np.zeros((count, _ROWS + NUMBERS * size, 7))
    error_p, jacobian_p = error[:, _ROWS:].reshape(count, size, -1), jacobian[:, _ROWS:].reshape(count, size, -1, 7)
    jacobian[:, :3, 3:] = -anchors.by_mount[rows]
    jacobian_p[..., 3:] = -posts.whitened_by_mount * is_matched[..., None, None]
    by_mount = jacobian_p[..., 3:].copy()
    log_norm = anchors.log_norm[rows] + is_matched @ posts.log_norm
    log_survey = np.zeros(count)
    for step in range(steps):
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        _linearise_anchors(error, jacobian, of_anchor, at, poses)
        if windows is not None:
            _linearise_windows(error, jacobian, windows, poses, c, s)
        if size:
            value, slope = posts.predicted(poses[:, None], marks)
            value -= posts.fused
            value[..., 0] = se2.wrap(value[..., 0])
            error_p[...] = (of_posts @ value[..., None])[..., 0] + offset
            jacobian_p[..., :3] = of_posts @ slope
            if field.surveyed is not None:
                log_survey = _add_survey(error_p, jacobian_p, by_mount, field.surveyed[readings.matched], poses)
                log_survey = np.where(is_matched, log_survey, 0.0).sum(axis=1)
        back = np.ascontiguousarray(np.swapaxes(jacobian, 1, 2))
        information = back @ jacobian + _WEAK
        gradient = back @ error[:, :, None]
        last = step == steps - 1
        covariance = np.linalg.inv(information) if last else None
        full_step = np.linalg.solve(information, gradient) if covariance is None else covariance @ gradient
        move = np.clip(full_step[:, :3, 0], -_LONGEST_STEP, _LONGEST_STEP)
        moved = poses - move
        moved[:, 0] = poses[:, 0] - c * move[:, 0] + s * move[:, 1]
        moved[:, 1] = poses[:, 1] - s * move[:, 0] - c * move[:, 1]
        poses = moved
    assert covariance is not None
    poses[:, 2] = se2.wrap(poses[:, 2])
    misfit = (error * error).sum(axis=1) - (gradient * full_step).sum(axis=(1, 2))
    log_volume = 1.5 * _LOG_2PI - 0.5 * np.linalg.slogdet(information)[1]
    degrees = is_matched @ (2 * posts.seen.sum(axis=1)) + anchors.rank[rows] - 3
    log_integrals = anchors.log_weights[rows] + log_norm + log_survey + log_volume - 0.5 * misfit
    own = covariance[:, :3, :3]
    found = Readings(rows, readings.matched, poses)
    return Solved(found, np.asarray(0.5 * (own + np.swapaxes(own, -1, -2))), log_integrals, misfit, degrees)


def _linearise_anchors(
    error: FloatArray, jacobian: FloatArray, whitening: FloatArray, at: FloatArray, poses: FloatArray
) -> None:
    """Whitened errors and Jacobians of poses (k, 3) against anchors at (k, 3), into the first three rows."""
    away = poses - at
    turn = se2.wrap(away[:, 2])
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    local = np.empty_like(away)
    local[:, 0], local[:, 1] = c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]
    local[:, 2] = turn
    error[:, :3] = (whitening @ local[:, :, None])[..., 0]
    jacobian[:, :3, :3] = whitening @ se2.rotation3(turn)


def _linearise_windows(
    error: FloatArray, jacobian: FloatArray, windows: Windows, poses: FloatArray, c: FloatArray, s: FloatArray
) -> None:
    """The same of the windows, into the row behind the anchors'."""
    away = poses[:, :2] - windows.centre
    x, y = away[:, 0], away[:, 1]
    far2 = np.maximum(x * x + y * y, 1e-6)
    value = np.where(windows.by_distance, 0.5 * np.log(far2), np.arctan2(y, x)) - windows.middle
    error[:, 3] = np.where(windows.by_distance, value, se2.wrap(value)) / windows.width
    along = np.where(windows.by_distance, x, -y) / (far2 * windows.width)
    across = np.where(windows.by_distance, y, x) / (far2 * windows.width)
    jacobian[:, 3, 0], jacobian[:, 3, 1] = c * along + s * across, c * across - s * along


def _add_survey(
    error: FloatArray, jacobian: FloatArray, by_mount: FloatArray, surveyed: FloatArray, poses: FloatArray
) -> FloatArray:
    """Whiten (k, p, 4) errors once more for a map that is not exact either (Krotkov); log of what that does to the
    density at zero (k, p)."""
    turned = se2.rotation(poses[:, None, 2])
    in_robot = np.swapaxes(turned, -1, -2) @ surveyed @ turned
    to_position = jacobian[..., :2]
    noise = np.eye(NUMBERS) + to_position @ in_robot @ np.swapaxes(to_position, -1, -2)
    again = np.linalg.inv(np.linalg.cholesky(noise))
    error[...] = (again @ error[..., None])[..., 0]
    jacobian[..., :3], jacobian[..., 3:] = again @ jacobian[..., :3], again @ by_mount
    return np.asarray(np.log(np.diagonal(again, axis1=-2, axis2=-1)).sum(axis=-1))
