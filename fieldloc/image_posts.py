"""The posts of one image as numbers that are linear in what disturbs them: for weighing many poses at once.

A post's foot on the ground gives a bearing and an inverse distance, its two edges give both once more (see
`fieldloc.fixes.post_feet`). All four move with their own pixels and with the errors of the camera's height, pan, tilt
and roll, which everything in the image shares; so they are kept apart from each other until a pose explains them.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite, log, log1p, pi

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.covariance import cholesky_factors, inverse_of_lower
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.image_map import image_map
from fieldloc.image_post_numbers import NUMBERS, PostNumbers, post_numbers
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap

# What is no post of the map's but passes for one: anywhere in the image, its inverse distance anywhere in half of
# 1 / m; its foot and edges are one thing within 0.02 rad, and its width is a post's within 0.3 / m of inverse distance.
_LOG_ANYWHERE = log(0.5)
_LOG_ONE_THING = log(0.02 * 0.3)
_MOST_MISFIT = 22.0  # chi-square of two degrees that a post exceeds once in fifty thousand times
_HALF_LOG_2PI = 0.5 * log(2.0 * pi)
# of the mount's whitened errors, nothing of a post's own numbers, and one that keeps what is left of errors above zero
_KNOWN = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0])
_BOTH = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class PostsSeen:
    """p posts of use, seen from the point `below_camera` of the robot.

    Four numbers each: bearing and inverse distance of the axis by the foot, then by the edges. Predicted (bearing,
    inverse distance) - fused, by whitening_both (p, 4, 2), plus white_offset (p, 4), is the error that the pixels'
    noise makes white; zero for what was not seen. whitened_by_mount: (p, 4, 4) change of the whitened numbers with the
    mount's whitened errors. log_clutter: (p,) log density of what is no post of the map's; log_norm: (p,) of the noise
    at zero, with the odds that it is one. allowed: (p, m) whether it can be that landmark.
    fused: (p, 2) the best bearing and inverse distance, fused_covariance (p, 2, 2) with the mount's part; log_fused:
    (p,) log of the factor that turns the normal density of those two into that of all numbers.
    numbers: (p,) how many of the four were seen. labelled: whether any has a name.
    """

    below_camera: tuple[float, float]
    whitening_both: FloatArray
    white_offset: FloatArray
    whitened_by_mount: FloatArray
    log_norm: FloatArray
    log_clutter: FloatArray
    allowed: NDArray[np.bool_]
    fused: FloatArray
    fused_covariance: FloatArray
    log_fused: FloatArray
    numbers: IntArray
    labelled: bool

    def __len__(self) -> int:
        return len(self.fused)

    def predicted(self, poses: FloatArray, landmarks: FloatArray) -> FloatArray:
        """Landmarks (..., 2) from poses (..., 3), as (..., 2, 4): of bearing and inverse distance, the change with the
        robot's tangent (3), and last they themselves."""
        heading = poses[..., 2]
        c, s = np.cos(heading), np.sin(heading)
        away_x, away_y = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        ahead, left = self.below_camera
        u, v = c * away_x + s * away_y - ahead, c * away_y - s * away_x - left
        inverse2 = 1.0 / np.maximum(u * u + v * v, 1e-6)
        inverse = np.sqrt(inverse2)
        # a step of the robot moves the landmark, at (u + ahead, v + left), by (-dx + y turn, -dy - x turn)
        across, along = v * inverse2, u * inverse2
        out = np.empty((*u.shape, 2, 4))
        bearing, size = out[..., 0, :], out[..., 1, :]
        bearing[..., 0], bearing[..., 1], bearing[..., 3] = across, -along, np.arctan2(v, u)
        bearing[..., 2] = -1.0 - across * left - along * ahead
        size[..., 0], size[..., 1], size[..., 3] = along * inverse, across * inverse, inverse
        size[..., 2] = size[..., 1] * ahead - size[..., 0] * left
        return out


def seen_together(posts: PostsSeen, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Bearing and inverse distance of posts i and j (n,) as (n, 4), and covariance (n, 4, 4): what two posts say of the
    mount's errors, which they share, included."""
    design = np.zeros((len(i), 2 * NUMBERS, 8))
    design[:, :NUMBERS, :2], design[:, NUMBERS:, 2:4] = posts.whitening_both[i], posts.whitening_both[j]
    design[:, :NUMBERS, 4:], design[:, NUMBERS:, 4:] = posts.whitened_by_mount[i], posts.whitened_by_mount[j]
    offset = np.concatenate([posts.white_offset[i], posts.white_offset[j]], axis=1)
    back = np.swapaxes(design, 1, 2)
    information = back @ design
    information[:, range(4, 8), range(4, 8)] += 1.0
    covariance = np.linalg.inv(information)
    correction = (covariance @ back @ offset[..., None])[:, :4, 0]
    together = np.concatenate([posts.fused[i], posts.fused[j]], axis=1) - correction
    return together, np.asarray(covariance[:, :4, :4])


def posts_seen(
    posts: tuple[PostObservation, ...],
    camera: Camera,
    mount: CameraMount,
    root: FloatArray,
    field: FieldMap,
    detection: Detection,
) -> PostsSeen:
    """Those of use: with a foot on the ground or, where the landmarks have a width, with two edges in their order.

    Posts with a label that is not on the map are left out. root: (4, 4), times its transpose the mount's covariance.
    ValueError for a foot without a covariance.
    """
    indices = [None if post.label is None else field.index_of(post.label) for post in posts]
    rows = [
        k for k, (post, index) in enumerate(zip(posts, indices, strict=True)) if post.label is None or index is not None
    ]
    where = [mount.x_m, mount.y_m, mount.height_m, mount.pan_rad, mount.tilt_rad, mount.roll_rad]
    if not rows or not field.landmarks or not all(map(isfinite, where)) or mount.height_m <= 0:
        return _none(len(field.landmarks))
    numbers = post_numbers([posts[k] for k in rows], camera, mount, image_map(field).radius_m)
    kept = [any(row) for row in numbers.seen.tolist()]
    if not all(kept):
        rows = [k for k, is_kept in zip(rows, kept, strict=True) if is_kept]
        if not rows:
            return _none(len(field.landmarks))
        numbers = PostNumbers(
            numbers.values[kept], numbers.by_mount[kept], numbers.covariance[kept], numbers.seen[kept]
        )
    return _weighed(numbers, root, camera, mount, field, [indices[k] for k in rows], detection)


def _weighed(
    numbers: PostNumbers,
    root: FloatArray,
    camera: Camera,
    mount: CameraMount,
    field: FieldMap,
    indices: list[int | None],
    detection: Detection,
) -> PostsSeen:
    mask = numbers.seen
    # what was not seen is noise of one, and then has no say
    covariance = numbers.covariance + (~mask)[:, :, None] * np.eye(NUMBERS)
    noise = np.linalg.cholesky(covariance)
    count = mask.sum(axis=1)
    log_norm = -np.log(noise.diagonal(axis1=1, axis2=2)).sum(axis=1) - _HALF_LOG_2PI * count
    by_edges, by_foot = mask[:, 2], mask[:, 0]
    log_clutter = -_log_width(camera) - _LOG_ANYWHERE - (by_edges & by_foot) * _LOG_ONE_THING
    log_norm -= log_clutter + log(detection.false_post) - log1p(-detection.false_post) - log(detection.post)
    first = np.where(by_foot[:, None], numbers.values[:, :2], numbers.values[:, 2:])
    offset = (numbers.values - np.concatenate([first, first], axis=1)) * mask
    offset[:, ::2] = wrap(offset[:, ::2])
    # as the mount's whitened errors and a post's own numbers move them, and what they are off the first ones
    model = np.concatenate([-numbers.by_mount @ root, mask[..., None] * _BOTH, offset[..., None]], axis=-1)
    model = np.linalg.solve(noise, model)
    step, fused_covariance, log_rest, misfit = _fused(model)
    # what has a foot and edges that do not agree is none of the map's
    allowed = np.empty((len(mask), len(field.landmarks)), dtype=np.bool_)
    allowed[:] = misfit[:, None] < _MOST_MISFIT
    for row, index in enumerate(indices):
        if index is not None:
            allowed[row] &= np.arange(len(field.landmarks)) == index
    return PostsSeen(
        below_camera=(mount.x_m, mount.y_m),
        whitening_both=model[..., 4:6],
        white_offset=(model[..., 4:6] @ step[..., None])[..., 0] - model[..., 6],
        whitened_by_mount=model[..., :4],
        log_norm=log_norm,
        log_clutter=np.asarray(log_clutter),
        allowed=allowed,
        fused=first + step,
        fused_covariance=fused_covariance,
        log_fused=log_norm + log_rest,
        numbers=count,
        labelled=any(index is not None for index in indices),
    )


def _fused(model: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Least squares (p, 2) of each post's own numbers under pixel noise and the mount's errors, from the whitened
    model (p, 4, 7) of mount, own numbers and error; covariance (p, 2, 2), the log of what is left of the density (p,)
    but for the noise's own at zero, and chi-square (p,) of two degrees."""
    # the factor, in this order, has in it what is left when those before are eliminated
    root = cholesky_factors(model.swapaxes(1, 2) @ model + _KNOWN)
    by_own = inverse_of_lower(root[:, 4:6, 4:6])
    step = (root[:, 6:, 4:6] @ by_own)[:, 0]
    diagonal = root.diagonal(axis1=1, axis2=2)
    misfit = diagonal[:, 6] ** 2 - 1.0
    log_rest = log(2.0 * pi) - np.log(diagonal[:, :6]).sum(axis=1) - 0.5 * misfit
    return step, by_own.swapaxes(1, 2) @ by_own, log_rest, misfit


@lru_cache(maxsize=16)
def _log_width(camera: Camera) -> float:
    """Of what the image spans from left to right, in radians."""
    middle = camera.cy_px
    rays, exists = camera.ray(np.array([[0.0, middle], [camera.width_px - 1.0, middle]]))
    return float(np.log(np.diff(np.arctan2(rays[:, 0], rays[:, 2]))[0])) if exists.all() else log(pi)


def _none(landmarks: int) -> PostsSeen:
    return PostsSeen(
        below_camera=(0.0, 0.0),
        whitening_both=np.zeros((0, NUMBERS, 2)),
        white_offset=np.zeros((0, NUMBERS)),
        whitened_by_mount=np.zeros((0, NUMBERS, 4)),
        log_norm=np.zeros(0),
        log_clutter=np.zeros(0),
        allowed=np.zeros((0, landmarks), dtype=np.bool_),
        fused=np.zeros((0, 2)),
        fused_covariance=np.zeros((0, 2, 2)),
        log_fused=np.zeros(0),
        numbers=np.zeros(0, dtype=np.intp),
        labelled=False,
    )
