"""Poses from what lines say and which of the map's landmarks the posts are, many readings of one image at a time.

The unknowns are the pose and the mount's four errors, which lines and posts share. Everything is linear in them near a
solution, so a reading's likelihood is one Gaussian integral over all seven.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.covariance import chi_square_bounds, cholesky_factors, inverse_of_lower
from fieldloc.image_anchors import Anchors
from fieldloc.image_map import ImageMap
from fieldloc.image_post_numbers import NUMBERS
from fieldloc.image_posts import PostsSeen
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LOG_2PI = float(np.log(2.0 * np.pi))
_LONGEST_STEP = np.array([1.0, 1.0, 0.3])  # a linearisation is good for no more
# of the mount's whitened errors; the pose is free but finite; one for the error keeps what is left of it above zero
_WEAK = np.diag([1.0, 1.0, 1.0, 1.0, 1e-9, 1e-9, 1e-9, 1.0])
_SIGMAS = 4.0  # by how much a misfit may exceed its mean, as a normal variable does by as many sigmas
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
    is matched over poses and mount errors, the anchor's weight included; -inf for what geometry rules out."""

    readings: Readings
    covariances: FloatArray
    log_integrals: FloatArray

    def __len__(self) -> int:
        return len(self.log_integrals)

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Solved":
        return Solved(self.readings.take(rows), self.covariances[rows], self.log_integrals[rows])

    def beside(self, other: "Solved") -> "Solved":
        return Solved(
            self.readings.beside(other.readings),
            np.concatenate([self.covariances, other.covariances]),
            np.concatenate([self.log_integrals, other.log_integrals]),
        )


def solve(
    readings: Readings,
    anchors: Anchors,
    posts: PostsSeen,
    field: ImageMap,
    steps: int,
    windows: Windows | None = None,
    predicted: FloatArray | None = None,
) -> Solved:
    """So many steps of Gauss and Newton from the readings' poses; all else is as the last of them sees it.

    predicted: (k, p, 2, 4) what the posts are from there, as PostsSeen says, where that is known.
    Ruled out is what fits worse than noise can make it, beside the field, or where the lines are not long enough.
    """
    count, size = readings.matched.shape
    rows, poses = readings.anchors, readings.poses
    is_matched = (readings.matched >= 0).astype(np.float64)
    at, of_anchor = anchors.poses[rows], anchors.whitening[rows]
    marks = field.landmarks[readings.matched]
    # Jacobian by mount and pose, and the error last
    model = np.zeros((count, _ROWS + NUMBERS * size, 8))
    of_lines, by_posts = model[:, :3], model[:, _ROWS:].reshape(count, size, NUMBERS, 8)
    of_lines[..., :4] = anchors.by_mount[rows]
    by_posts[..., :4] = posts.whitened_by_mount
    log_norm = anchors.log_weights[rows] + anchors.log_norm[rows] + is_matched @ posts.log_norm
    for _ in range(steps):
        _linearise_anchors(of_lines, of_anchor, at, poses)
        if windows is not None:
            _linearise_windows(model[:, 3], windows, poses)
        if size:
            if predicted is None:
                predicted = posts.predicted(poses[:, None], marks)
            predicted[..., 3] -= posts.fused
            predicted[..., 0, 3] = se2.wrap(predicted[..., 0, 3])
            by_posts[..., 4:] = posts.whitening_both @ predicted
            by_posts[..., 7] += posts.white_offset
            by_posts *= is_matched[..., None, None]
            predicted = None
        log_survey: FloatArray | float = 0.0
        whole = model
        if field.surveyed is not None:
            whole = model.copy()
            surveyed = field.surveyed[readings.matched]
            log_survey = _add_survey(whole[:, _ROWS:].reshape(by_posts.shape), surveyed, poses)
        # the factor of mount, pose and error, in this order, has in it what is left when those before are eliminated
        root = cholesky_factors(np.ascontiguousarray(whole.swapaxes(1, 2)) @ whole + _WEAK)
        by_pose = inverse_of_lower(root[:, 4:7, 4:7])
        poses = _moved(poses, (root[:, 7:, 4:7] @ by_pose)[:, 0])
    covariances = by_pose.swapaxes(1, 2) @ by_pose
    diagonal = root.diagonal(axis1=1, axis2=2)
    misfit = diagonal[:, 7] ** 2 - 1.0
    log_volume = 1.5 * _LOG_2PI - np.log(diagonal[:, :7]).sum(axis=1)
    degrees = (is_matched @ posts.numbers).astype(np.intp) + anchors.rank[rows] - 3 + (windows is not None)
    degrees = np.maximum(degrees, 1)
    possible = misfit < chi_square_bounds(len(model[0]), _SIGMAS)[degrees]
    possible &= inside(poses, field)
    if (free := anchors.free[rows]).any():
        possible &= _long_enough(poses, covariances, free, anchors.along_m[rows])
    log_integrals = np.where(possible, log_norm + log_survey + log_volume - 0.5 * misfit, -np.inf)
    return Solved(Readings(rows, readings.matched, poses), covariances, log_integrals)


def _linearise_anchors(model: FloatArray, whitening: FloatArray, at: FloatArray, poses: FloatArray) -> None:
    """Whitened Jacobians and errors of poses (k, 3) against anchors at (k, 3), into (k, 3, 8)."""
    away = poses - at
    if not away.any():
        model[..., 4:7], model[..., 7] = whitening, 0.0
        return
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    x, y, turn = away[:, 0], away[:, 1], se2.wrap(away[:, 2])
    turned = np.zeros((len(at), 3, 4))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(turn)
    turned[:, 1, 0] = np.sin(turn)
    turned[:, 0, 1] = -turned[:, 1, 0]
    turned[:, 2, 2] = 1.0
    turned[:, 0, 3], turned[:, 1, 3], turned[:, 2, 3] = c * x + s * y, c * y - s * x, turn
    np.matmul(whitening, turned, out=model[..., 4:])


def _linearise_windows(model: FloatArray, windows: Windows, poses: FloatArray) -> None:
    """The same of the windows, into (k, 8)."""
    away = poses[:, :2] - windows.centre
    x, y = away[:, 0], away[:, 1]
    far2 = np.maximum(x * x + y * y, 1e-6)
    value = np.where(windows.by_distance, 0.5 * np.log(far2), np.arctan2(y, x)) - windows.middle
    model[:, 7] = np.where(windows.by_distance, value, se2.wrap(value)) / windows.width
    along = np.where(windows.by_distance, x, -y) / (far2 * windows.width)
    across = np.where(windows.by_distance, y, x) / (far2 * windows.width)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    model[:, 4], model[:, 5] = c * along + s * across, c * across - s * along


def _add_survey(by_posts: FloatArray, surveyed: FloatArray, poses: FloatArray) -> FloatArray:
    """Whiten (k, p, 4, 8) once more for a map that is not exact either (Krotkov); log of what that does to the density
    at zero (k,)."""
    turned = se2.rotation(poses[:, None, 2])
    in_robot = np.swapaxes(turned, -1, -2) @ surveyed @ turned
    to_position = by_posts[..., 4:6]
    noise = np.eye(NUMBERS) + to_position @ in_robot @ np.swapaxes(to_position, -1, -2)
    again = np.linalg.inv(np.linalg.cholesky(noise))
    by_posts[...] = again @ by_posts
    return np.asarray(np.log(np.diagonal(again, axis1=-2, axis2=-1)).sum(axis=(1, 2)))


def _moved(poses: FloatArray, step: FloatArray) -> FloatArray:
    """Poses less a tangent step, no longer than a linearisation is good for."""
    x, y, turn = np.minimum(np.maximum(step, -_LONGEST_STEP), _LONGEST_STEP).T
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    out = np.empty_like(poses)
    out[:, 0], out[:, 1] = poses[:, 0] - c * x + s * y, poses[:, 1] - s * x - c * y
    out[:, 2] = se2.wrap(poses[:, 2] - turn)
    return out


def inside(poses: FloatArray, field: ImageMap, slack_m: float = 0.0) -> NDArray[np.bool_]:
    """(k,) whether a robot can be there, or nearly so."""
    xy = poses[:, :2]
    return np.asarray(((xy > field.box[:2] - slack_m) & (xy < field.box[2:] + slack_m)).all(axis=1))


def _long_enough(
    poses: FloatArray, covariances: FloatArray, free: FloatArray, along_m: FloatArray
) -> NDArray[np.bool_]:
    """Whether the lines of one direction are long enough to be seen from there; true of others, which are nowhere
    free."""
    at = free[:, 0] * poses[:, 0] + free[:, 1] * poses[:, 1]
    reach = _SIGMAS * np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    return np.asarray((along_m[:, 0] - reach <= at) & (at <= along_m[:, 1] + reach))
