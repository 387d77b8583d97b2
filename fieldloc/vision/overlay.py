"""A picture of what was found: the map drawn over the photograph, and on a plan beside it where it can be from."""

from collections.abc import Callable

import cv2
import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import project_points
from fieldloc.locate.hypotheses import Hypothesis, Located
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.symmetry import merge_segments
from fieldloc.vision.detections import Detections
from fieldloc.vision.picture import UInt8Array

Colour = tuple[int, int, int]

_MAP: Colour = (0, 220, 255)
_LINE: Colour = (0, 0, 255)
_POST: Colour = (255, 80, 0)
_CIRCLE: Colour = (255, 0, 255)
_CORNER: Colour = (255, 255, 0)
_TURF: Colour = (60, 120, 50)
_WHITE: Colour = (255, 255, 255)
_SHIFT = 4  # OpenCV draws to fractions of a pixel, of which this is the power of two
_SAMPLES = 60
_MARGIN_M = 1.0
_SIGMAS = 3.0
_MOST = 12


def draw(picture: UInt8Array, detections: Detections, located: Located, camera: Camera, field: FieldMap) -> UInt8Array:
    """(h, w', 3): the photograph with what was detected (lines red, posts blue, circle violet) and the map as the first
    hypothesis sees it (yellow), and a plan of the field with all hypotheses, each with its ellipse of three sigmas."""
    photo = picture.copy()
    if located.hypotheses:
        _draw_map(photo, located.hypotheses[0], camera, field)
    _draw_detections(photo, detections)
    return np.hstack([photo, _plan(located, field, photo.shape[0])])


def _draw_map(photo: UInt8Array, best: Hypothesis, camera: Camera, field: FieldMap) -> None:
    mount = CameraMount(best.height_m, 0.0, best.pitch_rad, best.roll_rad, np.zeros((4, 4)))
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    curves = [np.column_stack([a + share * (b - a), np.zeros(_SAMPLES)]) for a, b in merge_segments(field.lines)]
    for x, y, radius in field.circles:
        turn = 2.0 * np.pi * share[:, 0]
        curves.append(np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn), np.zeros(_SAMPLES)]))
    for mark in field.landmarks:
        top = mark.height_m or 1.0
        curves.append(np.column_stack([np.tile(mark.position, (_SAMPLES, 1)), top * share]))
    for ends in field.crossbars:
        a, b = (field.landmarks[i] for i in map(field.index_of, ends) if i is not None)
        flat = a.position + share * (b.position - a.position)
        curves.append(np.column_stack([flat, np.full(_SAMPLES, a.height_m)]))
    for curve in curves:
        in_robot = np.column_stack([apply(inverse(best.pose), curve[:, :2]), curve[:, 2]])
        pixels, visible = project_points(camera, mount, in_robot)
        for i in np.flatnonzero(visible[1:] & visible[:-1]):
            _line(photo, pixels[i], pixels[i + 1], _MAP, 1)


def _draw_detections(photo: UInt8Array, detections: Detections) -> None:
    for line in detections.lines:
        _line(photo, line.ends_px[0], line.ends_px[1], _LINE, 1)
    for post in detections.posts:
        _line(photo, post.left_px[0], post.left_px[1], _POST, 1)
        _line(photo, post.right_px[0], post.right_px[1], _POST, 1)
        for point in (post.foot_px, post.top_px):
            if point is not None:
                _dot(photo, point, 4, _POST)
    for circle in detections.circles:
        for point in circle.points_px:
            _dot(photo, point, 1, _CIRCLE)
    for corner in detections.corners:
        _dot(photo, corner.point_px, 4, _CORNER)
        _write(photo, corner.kind, corner.point_px + [6.0, -4.0], _CORNER)
    for mark in detections.marks:
        _dot(photo, mark.centre_px, 3, _CORNER)


def _plan(located: Located, field: FieldMap, height: int) -> UInt8Array:
    """(height, w, 3) the field from above, x up and y to the left."""
    x_min, y_min, x_max, y_max = field.bounds
    scale = (height - 1) / max(x_max - x_min + 2.0 * _MARGIN_M, 1e-6)
    width = max(int(scale * (y_max - y_min + 2.0 * _MARGIN_M)), 1)
    plan = np.full((height, width, 3), _TURF, dtype=np.uint8)

    def at(point: FloatArray) -> FloatArray:
        return scale * np.array([y_max + _MARGIN_M - point[1], x_max + _MARGIN_M - point[0]])

    for a, b in field.lines:
        _line(plan, at(a), at(b), _WHITE, 1)
    for x, y, radius in field.circles:
        cv2.circle(
            plan, _fixed(at(np.array([x, y]))), round(radius * scale * 2**_SHIFT), _WHITE, 1, cv2.LINE_AA, _SHIFT
        )
    for mark in field.landmarks:
        _dot(plan, at(mark.position), 3, _POST)
    for one in reversed(located.hypotheses[:_MOST]):
        _hypothesis(plan, one, at, scale)
    _write(plan, f"none of these {100 * located.none:.1f} %", np.array([6.0, height - 8.0]), _WHITE)
    return plan


def _hypothesis(plan: UInt8Array, one: Hypothesis, at: Callable[[FloatArray], FloatArray], scale: float) -> None:
    shade = 0.35 + 0.65 * min(2.0 * one.probability, 1.0)
    colour = (round(_MAP[0] * shade), round(_MAP[1] * shade), round(_MAP[2] * shade))
    values, vectors = np.linalg.eigh(one.covariance[:2, :2])
    axes = np.minimum(_SIGMAS * scale * np.sqrt(np.maximum(values, 0.0)), 1e4)
    long = vectors[:, 1]
    degrees = float(np.degrees(np.arctan2(-long[0], -long[1])))
    size = (round(axes[1] * 2**_SHIFT), round(axes[0] * 2**_SHIFT))
    cv2.ellipse(plan, _fixed(at(one.pose[:2])), size, degrees, 0.0, 360.0, colour, 1, cv2.LINE_AA, _SHIFT)
    ahead = one.pose[:2] + 0.6 * np.array([np.cos(one.pose[2]), np.sin(one.pose[2])])
    cv2.arrowedLine(plan, _fixed(at(one.pose[:2])), _fixed(at(ahead)), colour, 1, cv2.LINE_AA, _SHIFT, 0.3)
    _write(plan, f"{100 * one.probability:.1f}", at(one.pose[:2]) + [6.0, 4.0], colour)


def _fixed(point: FloatArray) -> tuple[int, int]:
    limited = np.clip(point, -2e4, 2e4) * 2**_SHIFT
    return round(float(limited[0])), round(float(limited[1]))


def _line(picture: UInt8Array, start: FloatArray, end: FloatArray, colour: Colour, thickness: int) -> None:
    cv2.line(picture, _fixed(start), _fixed(end), colour, thickness, cv2.LINE_AA, _SHIFT)


def _dot(picture: UInt8Array, centre: FloatArray, radius: int, colour: Colour) -> None:
    cv2.circle(picture, _fixed(centre), radius * 2**_SHIFT, colour, 1, cv2.LINE_AA, _SHIFT)


def _write(picture: UInt8Array, text: str, at: FloatArray, colour: Colour) -> None:
    cv2.putText(picture, text, (round(at[0]), round(at[1])), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1, cv2.LINE_AA)
