"""What the lines of an image say, in the one form in which its posts can be added to it.

An anchor is a pose with a whitening W (3, 3): W (R^T (position - its position), heading - its heading) is white noise
but for what the mount's errors do. Lines of both directions make W regular; those of one leave a row of it zero, no
lines all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_EDGE_RAD = 0.6173  # of one turn of a symmetry: where no field's lines run
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """poses: (a, 3). whitening: (a, 3, 3). by_mount: (a, 3, 4) change of the whitened error with the mount's whitened
    errors. log_weights: (a,) as of a SolutionMixture's stacks. log_norm: (a,) log density of the whitened noise at
    zero. whole: (a,) whether it is a whole pose. along_m: (a, 2) how far the robot can be along the free direction,
    which is `free` (a, 2) in field axes, zero where there is none. covariances: (a, 3, 3) of whole poses in the robot
    frame, with the mount's part; else of (heading, offset) and zeros. rank: (a,) of the whitening."""

    poses: FloatArray
    whitening: FloatArray
    by_mount: FloatArray
    log_weights: FloatArray
    log_norm: FloatArray
    whole: NDArray[np.bool_]
    along_m: FloatArray
    free: FloatArray
    covariances: FloatArray
    rank: IntArray

    def __len__(self) -> int:
        return len(self.poses)

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Anchors":
        return Anchors(
            self.poses[rows],
            self.whitening[rows],
            self.by_mount[rows],
            self.log_weights[rows],
            self.log_norm[rows],
            self.whole[rows],
            self.along_m[rows],
            self.free[rows],
            self.covariances[rows],
            self.rank[rows],
        )


def one_turn(headings_rad: FloatArray, turn_rad: float) -> NDArray[np.bool_]:
    """One each of headings that differ by whole turns of a symmetry."""
    return np.asarray((headings_rad - _EDGE_RAD) % (2 * np.pi) < turn_rad)


def nothing(log_weight: float) -> Anchors:
    """One that says nothing: for posts without lines."""
    return Anchors(
        np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 3, 4)), np.full(1, log_weight), np.zeros(1),
        np.zeros(1, dtype=np.bool_), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 3, 3)),
        np.zeros(1, dtype=np.intp),
    )  # fmt: skip


def whole_poses(
    poses: FloatArray, pixel_covariances: FloatArray, by_mount: FloatArray, root: FloatArray, log_weights: FloatArray
) -> Anchors:
    """Of poses (a, 3) with covariances (a, 3, 3) but for by_mount (a, 3, 4) times the mount's errors; root: (4, 4)."""
    count = len(poses)
    whitening = np.linalg.inv(np.linalg.cholesky(pixel_covariances))
    log_norm = np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1) - 1.5 * _LOG_2PI
    moved = by_mount @ root
    covariances = pixel_covariances + moved @ np.swapaxes(moved, -1, -2)
    return Anchors(
        poses, whitening, -whitening @ moved, log_weights, log_norm, np.ones(count, dtype=np.bool_),
        np.zeros((count, 2)), np.zeros((count, 2)), covariances,
        np.full(count, 3),
    )  # fmt: skip


def along_lines(
    heading_rad: FloatArray,
    normal_rad: FloatArray,
    offset_m: FloatArray,
    along_m: FloatArray,
    pixel_covariances: FloatArray,
    by_mount: FloatArray,
    root: FloatArray,
    log_weights: FloatArray,
) -> Anchors:
    """Of headings and distances along one direction, (a,) each as in LineStack, pixel_covariances (a, 2, 2) of both
    but for by_mount (a, 2, 4) times the mount's errors."""
    count = len(heading_rad)
    normal = np.stack([np.cos(normal_rad), np.sin(normal_rad)], axis=-1)
    free = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    poses = np.concatenate([offset_m[:, None] * normal, heading_rad[:, None]], axis=-1)
    own = np.linalg.inv(np.linalg.cholesky(pixel_covariances))
    between = normal_rad - heading_rad
    design = np.zeros((count, 2, 3))
    design[:, 0, 2] = 1.0
    design[:, 1, 0], design[:, 1, 1] = np.cos(between), np.sin(between)
    whitening, moved = np.zeros((count, 3, 3)), np.zeros((count, 3, 4))
    whitening[:, :2] = own @ design
    moved[:, :2] = -own @ by_mount @ root
    log_norm = np.log(np.diagonal(own, axis1=1, axis2=2)).sum(axis=1) - _LOG_2PI
    full = by_mount @ root
    covariances = np.zeros((count, 3, 3))
    covariances[:, :2, :2] = pixel_covariances + full @ np.swapaxes(full, -1, -2)
    return Anchors(
        poses,
        whitening,
        moved,
        log_weights,
        log_norm,
        np.zeros(count, dtype=np.bool_),
        along_m,
        free,
        covariances,
        np.full(count, 2),
    )


def joined(parts: list[Anchors]) -> Anchors:
    """In that order."""
    if len(parts) == 1:
        return parts[0]
    return Anchors(*(np.concatenate([getattr(part, name) for part in parts]) for name in Anchors.__slots__))
