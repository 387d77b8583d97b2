"""Poses from what lines say and which of the map's landmarks the posts are, many readings of one image at a time.

The unknowns are the pose and the mount's four errors, which lines and posts share. Everything is linear in them near a
solution, so a reading's likelihood is one Gaussian integral over all seven.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.field import FieldMap
from fieldloc.image_anchors import Anchors
from fieldloc.image_posts import NUMBERS, PostsSeen
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LOG_2PI = float(np.log(2.0 * np.pi))
_LONGEST_STEP = np.array([1.0, 1.0, 0.3])  # a linearisation is good for no more
_WEAK = 1e-9  # information that no observation has: keeps free directions from being infinite


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """k ways to read an image: `anchors` (k,) rows, `matched` (k, p) landmark of each post or -1, `poses` (k, 3)."""

    anchors: IntArray
    matched: IntArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.poses)

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

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Solved":
        return Solved(
            self.readings.take(rows),
            self.covariances[rows],
            self.log_integrals[rows],
            self.misfit[rows],
            self.degrees[rows],
        )


def solve(readings: Readings, anchors: Anchors, posts: PostsSeen, field: FieldMap, steps: int) -> Solved:
    """Gauss-Newton from the readings' poses, of which the last step tells the rest."""
    poses, count = readings.poses, len(readings)
    is_matched = readings.matched >= 0
    for _ in range(steps):
        error, jacobian = anchors.linearised(readings.anchors, poses)
        log_norm = anchors.log_norm[readings.anchors]
        if len(posts):
            error_p, jacobian_p, log_norm_p = _posts(readings.matched, is_matched, poses, posts, field)
            error = np.concatenate([error, error_p], axis=1)
            jacobian = np.concatenate([jacobian, jacobian_p], axis=1)
            log_norm = log_norm + log_norm_p
        back = np.swapaxes(jacobian, -1, -2)
        information = back @ jacobian
        information[:, range(3), range(3)] += _WEAK
        information[:, range(3, 7), range(3, 7)] += 1.0
        covariance = np.linalg.inv(information)
        gradient = back @ error[:, :, None]
        full_step = covariance @ gradient
        misfit = (error * error).sum(axis=1) - (gradient * full_step).sum(axis=(1, 2))
        step = np.clip(full_step[:, :3, 0], -_LONGEST_STEP, _LONGEST_STEP)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        moved = np.empty_like(poses)
        moved[:, 0] = poses[:, 0] - c * step[:, 0] + s * step[:, 1]
        moved[:, 1] = poses[:, 1] - s * step[:, 0] - c * step[:, 1]
        moved[:, 2] = se2.wrap(poses[:, 2] - step[:, 2])
        poses = moved
    log_volume = 1.5 * _LOG_2PI - 0.5 * np.linalg.slogdet(information)[1]
    numbers = is_matched @ (2 * posts.seen.sum(axis=1)) if len(posts) else np.zeros(count, dtype=np.intp)
    degrees = numbers + anchors.rank[readings.anchors] - 3
    log_integrals = anchors.log_weights[readings.anchors] + log_norm + log_volume - 0.5 * misfit
    found = Readings(readings.anchors, readings.matched, poses)
    own = covariance[:, :3, :3]
    return Solved(found, np.asarray(0.5 * (own + np.swapaxes(own, -1, -2))), log_integrals, misfit, degrees)


def _posts(
    matched: IntArray, is_matched: NDArray[np.bool_], poses: FloatArray, posts: PostsSeen, field: FieldMap
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened errors (k, 4 p) of matched posts, zero for others, Jacobians (k, 4 p, 7), log densities at zero (k,)."""
    count, size = matched.shape
    value, slope = posts.predicted(poses[:, None], field.positions[matched])
    error = posts.errors(value)
    whitening = np.broadcast_to(posts.whitening, (count, size, NUMBERS, NUMBERS))
    by_mount, log_norm = posts.whitened_by_mount, posts.log_norm
    jacobian = np.empty((count, size, NUMBERS, 7))
    jacobian[..., :3] = whitening @ np.concatenate([slope, slope], axis=-2)
    jacobian[..., 3:] = -by_mount
    error = (whitening @ error[..., None])[..., 0]
    if field.positions_covariance.any():
        # Krotkov: the map is not exact either
        turned = se2.rotation(poses[:, None, 2])
        surveyed = np.swapaxes(turned, -1, -2) @ field.positions_covariance[matched] @ turned
        to_position = jacobian[..., :2]
        noise = np.eye(NUMBERS) + to_position @ surveyed @ np.swapaxes(to_position, -1, -2)
        again = np.linalg.inv(np.linalg.cholesky(noise))
        jacobian, error = again @ jacobian, (again @ error[..., None])[..., 0]
        log_norm = log_norm + np.log(np.diagonal(again, axis1=-2, axis2=-1)).sum(axis=-1)
    jacobian *= is_matched[..., None, None]
    error = error * is_matched[..., None]
    total = np.where(is_matched, log_norm, 0.0).sum(axis=1)
    return error.reshape(count, -1), jacobian.reshape(count, -1, 7), total
