"""What is wrong all the time with where a camera sits and how it sees: its height, tilt and roll and its focal length,
from images and the poses they were taken from.

A head that is a degree askew turns all lines and feet of all images alike; gait and joints add to it what differs from
image to image. Both are told apart by their scatter:

    error of the mount in image i = constant + wobble_i,   wobble_i ~ N(0, diag(wobble^2))

The constant, and the wobble's sigmas by expectation maximization, come from the ends of lines and the posts' feet, each
against the thing on the map that it can be from there alone. A constant pan is a turn of all bearings, which no image
tells from a turn of the robot: it is the business of who knows how the robot moves (estimators.sensor). A focal length
does not change from image to image.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.covariance import propagate
from fieldloc.field import FieldMap
from fieldloc.ground import attitude_axes, cross, project_points, robot_from_camera
from fieldloc.measurements import CameraMount, ImageFeatures
from fieldloc.mount_correction import PARTS, MountCorrection
from fieldloc.pose import FloatArray
from fieldloc.repetition import inflation

_ROUNDS = 6
_SETTLED = 0.1  # of a sigma
_STEP = np.array([1e-4, 1e-5, 1e-5])  # of a pose, where derivatives are taken numerically
_MOUNT_STEP = np.array([1e-4, 1e-5, 1e-5, 1e-5])  # of height, tilt, roll, log of the focal length
_WOBBLES = np.array([1.0, 1.0, 1.0, 0.0])
_EXACT = 1e-9  # standard deviation of what is taken as known
_SIZE = len(PARTS)
_GATE = 13.8  # chi-square of two numbers, once in a thousand
_CLEARER = 9.0  # by how much the next best thing on the map must fit worse
_TAIL = 4.0  # degrees of freedom of a Student t: what fits badly counts less
_DOUBT = 9.0  # of variances: images' poses come from these very images, and lean the way that the camera is off
_PRIOR_IMAGES = 4.0  # how many images the prior of the wobble is worth


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """In the order of mount_correction.PARTS: error (4,), what is to be added to what the log says; covariance (4, 4)
    of that; wobble (4,) standard deviations image by image. sigmas: (4,) of the error beforehand. images: how many had
    something to say.
    """

    error: FloatArray
    covariance: FloatArray
    wobble: FloatArray
    sigmas: FloatArray
    images: int


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Of one image: residual (k,) seen - predicted, in units of noise; its change with mount (k, 4) and pose (k, 3)."""

    residual: FloatArray
    by_mount: FloatArray
    by_pose: FloatArray


def fit_mount(
    images: Sequence[ImageFeatures],
    poses: FloatArray,
    covariances: FloatArray,
    camera: Camera,
    field: FieldMap,
    sigmas: FloatArray,
    correlation_s: float = 1.0,
) -> MountFit:
    """images with the poses (n, 3) they were taken from and covariances (n, 3, 3) of those, robot frame.

    sigmas: (4,) of the constant error beforehand, which is also where the wobble begins. correlation_s: over what time
    images err alike. Where nothing is told, the error is 0 with those sigmas.
    """
    news, sigmas = _news(images, correlation_s), np.maximum(sigmas, _EXACT)
    error, wobble = np.zeros(_SIZE), 0.5 * sigmas * _WOBBLES
    covariance, used = np.diag(sigmas**2), 0
    # of each image; it is looked at where it was: over its own error and pose, nothing is straight enough
    off, moved = np.zeros((len(images), _SIZE)), np.zeros((len(images), 3))
    for count in range(_ROUNDS):
        spread = covariance + np.diag(wobble**2)
        told = []
        for i, (image, known) in enumerate(zip(images, _DOUBT * covariances, strict=True)):
            so_far = MountCorrection(*(error + off[i]).tolist())
            pose, mount = se2.retract(poses[i], moved[i]), so_far.applied(image.mount)
            rows = _rows(_View(image, mount, spread, pose, known, so_far.camera(camera), field))
            if len(rows.residual):
                back = rows.by_mount @ off[i] + rows.by_pose @ moved[i]
                told.append((replace(rows, residual=rows.residual + back), known, float(news[i]), i))
        used = len(told)
        if not used:
            break
        before = error
        error, covariance, wobble = _estimated(told, error, sigmas, wobble, off, moved)
        if count and (np.abs(error - before) < _SETTLED * np.sqrt(np.diagonal(covariance))).all():
            break
    return MountFit(error, covariance, wobble, sigmas, used)


def _news(images: Sequence[ImageFeatures], correlation_s: float) -> FloatArray:
    """(n,) share of each image that the one before has not said."""
    stamps_s = np.array([image.stamp_ns for image in images]) * 1e-9
    gaps = np.diff(stamps_s, prepend=-np.inf)
    gaps[gaps < 0.0] = np.inf  # another log begins
    return np.asarray(1.0 / inflation(gaps, correlation_s))


def _estimated(
    told: list[tuple[_Rows, FloatArray, float, int]],
    at: FloatArray,
    sigmas: FloatArray,
    wobble: FloatArray,
    off: FloatArray,
    moved: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The constant, its covariance and the wobble after one round; `at`: the constant that the rows are about. What is
    found of each image's own error and pose is written to its row of `off` and `moved`."""
    information: FloatArray = np.diag(1.0 / sigmas**2)
    vector: FloatArray = -at / sigmas**2
    whitened = []
    for rows, known, share, i in told:
        spread = np.eye(len(rows.residual)) + rows.by_pose @ known @ rows.by_pose.T
        whole = spread + (rows.by_mount * wobble**2) @ rows.by_mount.T
        misfit = rows.residual @ np.linalg.solve(whole, rows.residual)
        weight = float(share * (_TAIL + len(rows.residual)) / (_TAIL + misfit))
        solved = np.linalg.solve(whole, np.column_stack([rows.by_mount, rows.residual]))
        information = information + weight * (rows.by_mount.T @ solved[:, :_SIZE])
        vector = vector + weight * (rows.by_mount.T @ solved[:, _SIZE])
        whitened.append((rows, solved, weight, known, i))
    covariance = np.linalg.inv(information)
    step = covariance @ vector
    squares = _PRIOR_IMAGES * (0.5 * sigmas * _WOBBLES) ** 2
    count = float(_PRIOR_IMAGES)
    for rows, solved, weight, known, i in whitened:
        gain, left_over = wobble[:, None] ** 2 * rows.by_mount.T, solved[:, _SIZE] - solved[:, :_SIZE] @ step
        off[i], moved[i] = gain @ left_over, known @ (rows.by_pose.T @ left_over)
        left = wobble**2 - np.einsum("ik,ki->i", gain, solved[:, :_SIZE]) * wobble**2
        squares = squares + weight * (off[i] ** 2 + left)
        count += weight
    return at + step, np.asarray(covariance), np.asarray(np.sqrt(squares / count))


Part = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """An image, its mount as it is thought to be with covariance `spread` (4, 4), and the pose (3,) that it was taken
    from with covariance `known` (3, 3), robot frame."""

    image: ImageFeatures
    mount: CameraMount
    spread: FloatArray
    pose: FloatArray
    known: FloatArray
    camera: Camera
    field: FieldMap


def _rows(view: _View) -> _Rows:
    parts = [*_of_lines(view), *_of_feet(view)]
    if not parts:
        return _Rows(np.zeros(0), np.zeros((0, _SIZE)), np.zeros((0, 3)))
    return _Rows(*(np.concatenate([part[k] for part in parts]) for k in range(3)))


def _of_lines(view: _View) -> list[Part]:
    """A line's plane through the camera, v = (n, (d - n . c) / h), holds the rays of both ends (fixes.lines)."""
    image, mount, pose, camera, field = view.image, view.mount, view.pose, view.camera, view.field
    if not image.lines or not len(field.lines):
        return []
    ends = np.array([line.ends_px for line in image.lines])
    noise = np.array([line.covariance_px2 for line in image.lines])
    outwards = ends - np.array([camera.cx_px, camera.cy_px])
    rays, by_pixel, exists = camera.ray_and_jacobian(ends)
    rotation = robot_from_camera(mount)
    along = field.lines[:, 1] - field.lines[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    distance = np.einsum("mi,mi->m", normal, field.lines[:, 0] - pose[:2])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    nx, ny = c * normal[:, 0] + s * normal[:, 1], c * normal[:, 1] - s * normal[:, 0]
    depth = (distance - nx * mount.x_m - ny * mount.y_m) / mount.height_m
    plane = np.stack([nx, ny, depth], axis=1)
    scale = np.linalg.norm(plane, axis=1)
    out = []
    for k in np.flatnonzero(exists.all(axis=1)):
        directions = rays[k] @ rotation.T  # (2, 3)
        if (directions[:, 2] >= 0.0).any():
            continue
        miss = plane @ directions.T / scale[:, None]  # (m, 2)
        turned = cross(attitude_axes(mount)[1:, None], directions)  # (tilt and roll, end, 3)
        by_height = -depth[:, None] / mount.height_m * directions[:, 2] / scale[:, None]
        by_attitude = np.einsum("mi,aei->mea", plane / scale[:, None], turned)
        longer = -(rotation @ by_pixel[k] @ outwards[k][..., None])[..., 0]  # of both rays, by a longer focal length
        by_focal = plane @ longer.T / scale[:, None]
        by_mount = np.concatenate([by_height[..., None], by_attitude, by_focal[..., None]], axis=-1)  # (m, 2, 4)
        by_pose = np.empty((len(plane), 2, 3))
        by_pose[..., 0] = -nx[:, None] / mount.height_m * directions[:, 2] / scale[:, None]
        by_pose[..., 1] = -ny[:, None] / mount.height_m * directions[:, 2] / scale[:, None]
        swung = np.stack([ny, -nx, -(ny * mount.x_m - nx * mount.y_m) / mount.height_m], axis=1)
        by_pose[..., 2] = swung @ directions.T / scale[:, None]
        to_pixel = np.einsum("mi,eij->mej", plane / scale[:, None], rotation @ by_pixel[k])
        both = np.zeros((len(plane), 2, 4))
        both[:, 0, :2], both[:, 1, 2:] = to_pixel[:, 0], to_pixel[:, 1]
        own = both @ noise[k] @ both.swapaxes(1, 2)
        found = _clearest(view, -miss, by_mount, by_pose, own)
        if found is not None:
            out.append(found)
    return out


def _of_feet(view: _View) -> list[Part]:
    """A post's foot is where its near side meets the ground."""
    posts, field = view.image.posts, view.field
    if not field.landmarks or all(post.foot_px is None for post in posts):
        return []
    still = MountCorrection()
    there = _feet(view, still, view.pose)
    moved = [_feet(view, MountCorrection(*step), view.pose) for step in np.diag(_MOUNT_STEP).tolist()]
    walked = [_feet(view, still, se2.retract(view.pose, step)) for step in np.diag(_STEP)]
    by_mount, by_pose = (
        (np.stack(those, axis=-1) - there[..., None]) / step for those, step in ((moved, _MOUNT_STEP), (walked, _STEP))
    )
    seen = np.isfinite(there).all(axis=1)
    out = []
    for post in posts:
        if post.foot_px is None or post.foot_covariance_px2 is None:
            continue
        right = seen if post.label is None else seen & np.array([label == post.label for label in field.labels])
        if right.any():
            own = np.broadcast_to(post.foot_covariance_px2, (len(there), 2, 2))
            miss = post.foot_px - there
            found = _clearest(view, miss[right], by_mount[right], by_pose[right], own[right])
            if found is not None:
                out.append(found)
    return out


def _feet(view: _View, beside: MountCorrection, pose: FloatArray) -> FloatArray:
    """(m, 2) pixels of the near sides of all landmarks, NaN behind the camera; beside: what differs from the view's."""
    mount, camera = beside.applied(view.mount), beside.camera(view.camera)
    at = se2.apply(se2.inverse(pose), view.field.positions)
    foot = np.array([mount.x_m, mount.y_m])
    reach = np.linalg.norm(at - foot, axis=1, keepdims=True)
    radius = 0.5 * np.array([mark.diameter_m for mark in view.field.landmarks])[:, None]
    near = at - (at - foot) * (radius / np.maximum(reach, 1e-6))
    pixels, _ = project_points(camera, mount, np.column_stack([near, np.zeros(len(near))]))
    return pixels


def _clearest(view: _View, miss: FloatArray, by_mount: FloatArray, by_pose: FloatArray, own: FloatArray) -> Part | None:
    """The one of m things on the map that this can be, whitened; None for none, and where two can be it.

    miss: (m, 2) seen - predicted, by_mount (m, 2, 4) and by_pose (m, 2, 3) of the prediction; own: (m, 2, 2) noise of
    the seen.
    """
    whole = own + propagate(by_pose, view.known) + propagate(by_mount, view.spread)
    distance = np.einsum("mi,mi->m", miss, np.linalg.solve(whole, miss[..., None])[..., 0])
    order = np.argsort(distance)
    best = int(order[0])
    if distance[best] > _GATE or (len(order) > 1 and distance[order[1]] < distance[best] + _CLEARER):
        return None
    root = np.linalg.inv(np.linalg.cholesky(own[best]))
    return root @ miss[best], root @ by_mount[best], root @ by_pose[best]
