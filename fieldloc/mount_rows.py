"""What one image says of its camera's mount and focal length, from a pose that is thought to be known.

The ends of lines and the posts' feet, each against the thing on the map that it can be from there alone, or not at all.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.covariance import propagate
from fieldloc.field import FieldMap
from fieldloc.ground import attitude_axes, cross, project_points, robot_from_camera
from fieldloc.measurements import CameraMount, ImageFeatures
from fieldloc.mount_correction import PARTS, MountCorrection
from fieldloc.pose import FloatArray

_STEP = np.array([1e-4, 1e-5, 1e-5])  # of a pose, where derivatives are taken numerically
_MOUNT_STEP = np.array([1e-4, 1e-5, 1e-5, 1e-5])  # of height, tilt, roll, log of the focal length
_GATE = 13.8  # chi-square of two numbers, once in a thousand
_CLEARER = 9.0  # by how much the next best thing on the map must fit worse
_SIZE = len(PARTS)
_TAIL = 4.0  # degrees of freedom of a Student t: what fits badly counts less


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Of one image: residual (k,) seen - predicted, in units of noise; its change with mount (k, 4) and pose (k, 3)."""

    residual: FloatArray
    by_mount: FloatArray
    by_pose: FloatArray


Part = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An image, its mount as it is thought to be with covariance `spread` (4, 4), and the pose (3,) that it was taken
    from with covariance `known` (3, 3), robot frame."""

    image: ImageFeatures
    mount: CameraMount
    spread: FloatArray
    pose: FloatArray
    known: FloatArray
    camera: Camera
    field: FieldMap


class Weighed(NamedTuple):
    """An image's numbers weighed by the inverse of their covariance W: inverse W times the change with mount (k, n)
    and times the residual (k,). weight: how much of a vote the image has."""

    by_mount: FloatArray
    residual: FloatArray
    weight: float

    @staticmethod
    def of(rows: Rows, known: FloatArray, wobble: FloatArray, share: float) -> "Weighed":
        """known: (3, 3) covariance of the pose, wobble: (n,) standard deviations of the mount from image to image,
        share: how much of a vote it has if it fits; a Student t gives less to what fits badly."""
        noise = np.eye(len(rows.residual)) + propagate(rows.by_pose, known)
        whole = noise + propagate(rows.by_mount, np.diag(wobble**2))
        columns = np.column_stack([rows.by_mount, rows.residual])
        solved = np.asarray(np.linalg.solve(whole, columns), dtype=np.float64)
        by_mount, residual = solved[:, :-1], solved[:, -1]
        misfit = float(rows.residual @ residual)
        return Weighed(by_mount, residual, share * (_TAIL + len(residual)) / (_TAIL + misfit))

    def says(self, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Information (n, n) of the constant error, and vector (n,), about the mount that the rows are about."""
        return self.weight * (rows.by_mount.T @ self.by_mount), self.weight * (rows.by_mount.T @ self.residual)

    def left(self, step: FloatArray) -> FloatArray:
        """(k,) the weighed residual once the constant has moved by a step (n,)."""
        return self.residual - self.by_mount @ step

    def wobbled(self, rows: Rows, wobble: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n,) and variance (n,) of the image's own error, of which `left` is what the constant leaves."""
        gain = wobble[:, None] ** 2 * rows.by_mount.T
        return gain @ left, wobble**2 * (1.0 - np.einsum("ik,ki->i", gain, self.by_mount))


def rows_of(view: View) -> Rows:
    """Of all lines and feet that can be only one thing."""
    parts = [*_of_lines(view), *_of_feet(view)]
    if not parts:
        return Rows(np.zeros(0), np.zeros((0, _SIZE)), np.zeros((0, 3)))
    return Rows(*(np.concatenate([part[k] for part in parts]) for k in range(3)))


def _of_lines(view: View) -> list[Part]:
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


def _of_feet(view: View) -> list[Part]:
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


def _feet(view: View, beside: MountCorrection, pose: FloatArray) -> FloatArray:
    """(m, 2) pixels of the near sides of all landmarks, NaN behind the camera; beside: what differs from the view's."""
    mount, camera = beside.applied(view.mount), beside.camera(view.camera)
    at = se2.apply(se2.inverse(pose), view.field.positions)
    foot = np.array([mount.x_m, mount.y_m])
    reach = np.linalg.norm(at - foot, axis=1, keepdims=True)
    radius = 0.5 * np.array([mark.diameter_m for mark in view.field.landmarks])[:, None]
    near = at - (at - foot) * (radius / np.maximum(reach, 1e-6))
    pixels, _ = project_points(camera, mount, np.column_stack([near, np.zeros(len(near))]))
    return pixels


def _clearest(view: View, miss: FloatArray, by_mount: FloatArray, by_pose: FloatArray, own: FloatArray) -> Part | None:
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
