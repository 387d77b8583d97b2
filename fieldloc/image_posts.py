"""The posts of one image as numbers that are linear in what disturbs them: for weighing many poses at once.

A post's foot on the ground gives a bearing and an inverse distance, its two edges give both once more (see
`fieldloc.fixes.post_feet`). All four move with their own pixels and with the errors of the camera's height, pan, tilt
and roll, which everything in the image shares; so they are kept apart from each other until a pose explains them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.image_map import image_map
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap

NUMBERS = 4  # foot's bearing and inverse distance, edges' bearing and inverse distance
_LEAST_PX2 = 1e-4  # no pixel is exacter
_NO_FOOT = np.full(2, np.nan)
_LARGEST_INVERSE_M = 1.0  # nearer than a metre the image holds no whole post
_ONE_THING_RAD = 0.1  # how far foot and edges of whatever stands there can be apart
_BOTH = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class PostsSeen:
    """p posts of use, seen from the point `below_camera` (2,) of the robot.

    Four numbers each: bearing and inverse distance of the axis by the foot, then by the edges. Predicted (bearing,
    inverse distance) - fused, by whitening_both (p, 4, 2), plus white_offset (p, 4), is the error that the pixels'
    noise makes white; zero for what was not seen. whitened_by_mount: (p, 4, 4) change of the whitened numbers with the
    mount's whitened errors. log_clutter: (p,) log density of what is no post of the map's; log_norm: (p,) of the noise
    at zero, with the odds that it is one. allowed: (p, m) whether it can be that landmark.
    fused: (p, 2) the best bearing and inverse distance, fused_covariance (p, 2, 2) with the mount's part; log_fused:
    (p,) log of the factor that turns the normal density of those two into that of all numbers.
    seen: (p, 2) whether its foot and its edges were. labelled: whether any has a name.
    """

    below_camera: FloatArray
    whitening_both: FloatArray
    white_offset: FloatArray
    whitened_by_mount: FloatArray
    log_norm: FloatArray
    log_clutter: FloatArray
    allowed: NDArray[np.bool_]
    fused: FloatArray
    fused_covariance: FloatArray
    log_fused: FloatArray
    seen: NDArray[np.bool_]
    labelled: bool

    def __len__(self) -> int:
        return len(self.fused)

    def predicted(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bearing and inverse distance (..., 2) of landmarks (..., 2) from poses (..., 3), Jacobian (..., 2, 3)."""
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        away_x, away_y = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        x, y = c * away_x + s * away_y, c * away_y - s * away_x  # from the robot
        u, v = x - self.below_camera[0], y - self.below_camera[1]
        inverse2 = 1.0 / np.maximum(u * u + v * v, 1e-6)
        inverse = np.sqrt(inverse2)
        value = np.empty((*u.shape, 2))
        value[..., 0], value[..., 1] = np.arctan2(v, u), inverse
        jacobian = np.empty((*u.shape, 2, 3))
        to_u, to_v = -v * inverse2, u * inverse2
        jacobian[..., 0, 0], jacobian[..., 0, 1], jacobian[..., 0, 2] = -to_u, -to_v, to_u * y - to_v * x
        cube = inverse2 * inverse
        to_u, to_v = -u * cube, -v * cube
        jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = -to_u, -to_v, to_u * y - to_v * x
        return value, jacobian


def seen_together(posts: PostsSeen, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Bearing and inverse distance of posts i and j (n,) as (n, 4), and covariance (n, 4, 4): what two posts say of the
    mount's errors, which they share, included."""
    design = np.zeros((len(i), 2 * NUMBERS, 8))
    design[:, :NUMBERS, :2], design[:, NUMBERS:, 2:4] = posts.whitening_both[i], posts.whitening_both[j]
    design[:, :NUMBERS, 4:], design[:, NUMBERS:, 4:] = -posts.whitened_by_mount[i], -posts.whitened_by_mount[j]
    offset = np.concatenate([posts.white_offset[i], posts.white_offset[j]], axis=1)
    back = np.swapaxes(design, 1, 2)
    information = back @ design
    information[:, range(4, 8), range(4, 8)] += 1.0
    covariance = np.linalg.inv(information)
    correction = (covariance @ back @ offset[..., None])[:, :4, 0]
    return np.concatenate([posts.fused[i], posts.fused[j]], axis=1) - correction, covariance[:, :4, :4]


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
        k for k, (post, index) in enumerate(zip(posts, indices, strict=True)) if not post.label or index is not None
    ]
    if not rows or not field.landmarks or mount.height_m <= 0:
        return _none(len(field.landmarks))
    pixels, noise = _pixels([posts[k] for k in rows])
    radius_m = image_map(field).radius_m
    rays, to_pixels, exists = camera.ray_and_jacobian(pixels)
    rotation = robot_from_camera(mount)
    directions, to_pixels = rays @ rotation.T, rotation @ to_pixels
    turns = np.swapaxes(cross(attitude_axes(mount), directions[..., None, :]), -1, -2)  # (p, 3, 3, 3)
    with np.errstate(all="ignore"):  # what cannot be seen is masked
        values, to_pixel, to_mount, seen = _by_foot(mount.height_m, radius_m, directions[:, 2])
        edge_values, by_edges, edges_seen = _by_edges(radius_m, directions[:, :2])
    jacobian = np.zeros((len(rows), NUMBERS, 6))
    jacobian[:, :2, 4:] = to_pixel @ to_pixels[:, 2]
    jacobian[:, 2:, :4] = (by_edges @ to_pixels[:, :2]).swapaxes(1, 2).reshape(-1, 2, 4)
    by_mount = np.zeros((len(rows), NUMBERS, 4))
    by_mount[:, :2, 0], by_mount[:, :2, 1:] = to_mount, to_pixel @ turns[:, 2]
    by_mount[:, 2:, 1:] = (by_edges @ turns[:, :2]).sum(axis=1)
    mask = np.repeat(np.stack([seen & exists[:, 2], edges_seen & exists[:, :2].all(axis=1)], axis=-1), 2, axis=-1)
    return _weighed(
        np.concatenate([values, edge_values], axis=-1), jacobian, noise, by_mount @ root, mask, camera, mount, field,
        [indices[k] for k in rows], detection,
    )  # fmt: skip


def _weighed(
    values: FloatArray,
    jacobian: FloatArray,
    noise: FloatArray,
    by_mount: FloatArray,
    mask: NDArray[np.bool_],
    camera: Camera,
    mount: CameraMount,
    field: FieldMap,
    indices: list[int | None],
    detection: Detection,
) -> PostsSeen:
    mask = mask & np.isfinite(values)
    kept = mask.any(axis=1)
    if not kept.any():
        return _none(len(field.landmarks))
    mask = mask[kept]
    values = np.where(mask, values[kept], 0.0)
    by_mount = np.where(mask[..., None], by_mount[kept], 0.0)
    jacobian = np.where(mask[..., None], jacobian[kept], 0.0)
    covariance = jacobian @ noise[kept] @ np.swapaxes(jacobian, -1, -2)
    unseen = np.arange(NUMBERS)
    covariance[:, unseen, unseen] += np.where(mask, 0.0, 1.0)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    log_norm = np.sum(np.where(mask, np.log(whitening[:, unseen, unseen]) - 0.5 * np.log(2 * np.pi), 0.0), axis=1)
    whitening = whitening * mask[:, None, :] * mask[:, :, None]
    by_edges, by_foot = mask[:, 2], mask[:, 0]
    log_clutter = -np.log(_width_rad(camera)) - np.log(_LARGEST_INVERSE_M) * np.ones(len(values))
    log_clutter -= np.where(by_edges & by_foot, np.log(_ONE_THING_RAD) + np.log(_LARGEST_INVERSE_M), 0.0)
    by_mount = whitening @ by_mount
    log_norm -= np.log(detection.clutter) + log_clutter - np.log1p(-detection.clutter) - np.log(detection.post)
    fused, fused_covariance, log_rest = _fused(values, whitening, by_mount, by_foot)
    allowed = np.ones((len(values), len(field.landmarks)), dtype=np.bool_)
    names = [indices[row] for row in np.flatnonzero(kept)]
    for row, index in enumerate(names):
        if index is not None:
            allowed[row] = np.arange(len(field.landmarks)) == index
    below = np.array([mount.x_m, mount.y_m])
    labelled = any(index is not None for index in names)
    both = whitening @ _BOTH
    apart = np.concatenate([fused, fused], axis=-1) - values
    apart[:, ::2] = wrap(apart[:, ::2])
    return PostsSeen(
        below_camera=below,
        whitening_both=both,
        white_offset=(whitening @ apart[..., None])[..., 0],
        whitened_by_mount=by_mount,
        log_norm=log_norm,
        log_clutter=log_clutter,
        allowed=allowed,
        fused=fused,
        fused_covariance=fused_covariance,
        log_fused=log_norm + log_rest,
        seen=mask[:, ::2],
        labelled=labelled,
    )


def _pixels(posts: list[PostObservation]) -> tuple[FloatArray, FloatArray]:
    """Left edge, right edge, foot (p, 3, 2), NaN for a foot that is not seen; covariance (p, 6, 6)."""
    pixels, noise = np.empty((len(posts), 3, 2)), np.zeros((len(posts), 6, 6))
    for row, post in enumerate(posts):
        pixels[row, :2] = post.edges_px
        pixels[row, 2] = _NO_FOOT if post.foot_px is None else post.foot_px
        noise[row, :4, :4] = post.covariance_px2
        if post.foot_px is not None:
            if post.foot_covariance_px2 is None:
                raise ValueError("a post has a foot_px without a foot_covariance_px2")
            noise[row, 4:, 4:] = post.foot_covariance_px2
    noise[:, range(6), range(6)] += _LEAST_PX2
    return pixels, noise


def _by_foot(
    height_m: float, radius_m: float, directions: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """(bearing, inverse distance) (p, 2), change with the direction (p, 2, 3) and the height (p, 2), mask (p,)."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    level2 = x * x + y * y
    level = np.sqrt(level2)
    mask = (z < 0) & (level > 0)
    reach = height_m * level / -z
    inverse = 1.0 / (reach + radius_m)
    value = np.stack([np.arctan2(y, x), inverse], axis=-1)
    to_direction = np.zeros((len(x), 2, 3))
    to_direction[:, 0, 0], to_direction[:, 0, 1] = -y / level2, x / level2
    slope = -(inverse**2) * reach  # by the reach's relative change
    to_direction[:, 1, 0], to_direction[:, 1, 1], to_direction[:, 1, 2] = (
        slope * x / level2,
        slope * y / level2,
        -slope / z,
    )
    to_height = np.stack([np.zeros(len(x)), slope / height_m], axis=-1)
    return value, to_direction, to_height, mask


def _by_edges(radius_m: float, directions: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """(bearing, inverse distance) (p, 2), change (p, 2 edges, 2, 3) with the two directions (p, 2, 3), mask (p,)."""
    x, y = directions[..., 0], directions[..., 1]
    level2 = x * x + y * y
    bearings = np.arctan2(y, x)
    half = 0.5 * wrap(bearings[:, 0] - bearings[:, 1])
    mask = (half > 0) & (half < 0.5 * np.pi) & (level2 > 0).all(axis=-1) & (radius_m > 0)
    radius = max(radius_m, 1e-9)
    value = np.stack([wrap(bearings[:, 1] + half), np.sin(half) / radius], axis=-1)
    to_bearing = np.zeros((len(x), 2, 1, 3))
    to_bearing[:, :, 0, 0], to_bearing[:, :, 0, 1] = -y / level2, x / level2
    weight = np.empty((len(x), 2, 2, 1))
    weight[:, :, 0, 0] = 0.5
    weight[:, 0, 1, 0] = 0.5 * np.cos(half) / radius
    weight[:, 1, 1, 0] = -weight[:, 0, 1, 0]
    return value, weight * to_bearing, np.asarray(mask)


def _fused(
    values: FloatArray, whitening: FloatArray, by_mount: FloatArray, by_foot: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least squares (p, 2) of each post's own numbers under pixel noise and the mount's errors, covariance (p, 2, 2),
    and the log of what is left of the density (p,) but for the noise's own at zero."""
    first = np.where(by_foot[:, None], values[:, :2], values[:, 2:])
    offset = values - np.tile(first, 2)
    offset[:, ::2] = wrap(offset[:, ::2])
    design = np.concatenate([whitening @ _BOTH, -by_mount], axis=-1)
    back = np.swapaxes(design, -1, -2)
    information = back @ design
    information[:, range(2, 6), range(2, 6)] += 1.0
    covariance = np.linalg.inv(information)
    white = whitening @ offset[..., None]
    gradient = back @ white
    step = covariance @ gradient
    misfit = (white * white).sum(axis=(1, 2)) - (gradient * step).sum(axis=(1, 2))
    log_rest = np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(information)[1] - 0.5 * misfit
    return first + step[:, :2, 0], covariance[:, :2, :2], log_rest


@lru_cache(maxsize=16)
def _width_rad(camera: Camera) -> float:
    """What the image spans from left to right."""
    middle = camera.cy_px
    rays, exists = camera.ray(np.array([[0.0, middle], [camera.width_px - 1.0, middle]]))
    return float(np.arctan2(*rays[1, [0, 2]]) - np.arctan2(*rays[0, [0, 2]])) if exists.all() else np.pi


def _none(landmarks: int) -> PostsSeen:
    return PostsSeen(
        below_camera=np.zeros(2),
        whitening_both=np.zeros((0, NUMBERS, 2)),
        white_offset=np.zeros((0, NUMBERS)),
        whitened_by_mount=np.zeros((0, NUMBERS, 4)),
        log_norm=np.zeros(0),
        log_clutter=np.zeros(0),
        allowed=np.zeros((0, landmarks), dtype=np.bool_),
        fused=np.zeros((0, 2)),
        fused_covariance=np.zeros((0, 2, 2)),
        log_fused=np.zeros(0),
        seen=np.zeros((0, 2), dtype=np.bool_),
        labelled=False,
    )
