"""What a camera would detect of a map: exact projections with noise of stated covariance, and clutter."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, compose, inverse, wrap
from fieldloc.symmetry import merge_segments
from fieldloc.view import visible_parts
from fieldloc.vision.detections import Detections, SeenCircle, SeenLine, SeenPost

NAO = Camera("pinhole", 640, 480, 610.0, 610.0, 320.0, 240.0)
FARTHEST_M = 9.0


@dataclass(frozen=True)
class Look:
    """pose (3,) of the camera's foot and axis, height, pitch, roll."""

    pose: FloatArray
    height_m: float
    pitch_rad: float
    roll_rad: float

    @property
    def mount(self) -> CameraMount:
        return CameraMount(self.height_m, 0.0, self.pitch_rad, self.roll_rad, np.zeros((4, 4)))

    def on_image(self, camera: Camera, points: FloatArray, height_m: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of field points (n, 2), and whether they are on the image."""
        in_robot = apply(inverse(self.pose), points)
        return project_points(camera, self.mount, np.column_stack([in_robot, np.full(len(points), height_m)]))


@dataclass
class Scene:
    camera: Camera
    field: FieldMap
    random: np.random.Generator
    sigma_px: float = 0.3

    def seen(self, look: Look, clutter: int = 0, circles: bool = True, posts: bool = True) -> Detections:
        """clutter: so many lines that are none, and half as many posts."""
        u_max, v_max = self.camera.width_px, self.camera.height_px
        lines, upright = [*self._lines(look)], [*self._posts(look)] if posts else []
        for _ in range(clutter):
            start = self.random.uniform([0, 0.35 * v_max], [u_max, v_max])
            angle, length = self.random.uniform(0, np.pi), self.random.uniform(30, 120)
            lines.append(self._line(np.stack([start, start + length * np.array([np.cos(angle), np.sin(angle)])])))
        for _ in range(clutter // 2):
            u, v, width = self.random.uniform(0, u_max), self.random.uniform(100, 300), self.random.uniform(8, 40)
            left = np.array([[u, v - 80.0], [u, v]])
            upright.append(self._post(left, left + [width, 0.0], np.array([u + 0.5 * width, v])))
        return Detections(u_max, v_max, tuple(lines), tuple(upright), tuple(self._circles(look)) if circles else ())

    def _line(self, ends: FloatArray, width: FloatArray | None = None) -> SeenLine:
        widths = np.full(2, np.nan) if width is None else width
        return SeenLine(ends, self.sigma_px**2 * np.eye(4), widths, np.full(2, 2.0 * self.sigma_px))

    def _noise(self, *shape: int) -> FloatArray:
        return self.random.normal(0.0, self.sigma_px, shape)

    def _lines(self, look: Look) -> Iterator[SeenLine]:
        in_robot = merge_segments(apply(inverse(look.pose), self.field.lines))
        for part in visible_parts(self.camera, look.mount, in_robot)[0]:
            points = part[0] + np.linspace(0.0, 1.0, 200)[:, None] * (part[1] - part[0])
            points = points[np.linalg.norm(points, axis=-1) <= FARTHEST_M]
            if len(points) < 2:
                continue
            near = points[[0, -1]]
            ends = project_points(self.camera, look.mount, np.column_stack([near, np.zeros(2)]))[0]
            along = ends[1] - ends[0]
            length = float(np.hypot(*along))
            if length < 20.0:
                continue
            direction = (near[1] - near[0]) / np.linalg.norm(near[1] - near[0])
            side = 0.5 * self.field.line_width_m * np.array([-direction[1], direction[0]])
            left, right = (
                project_points(self.camera, look.mount, np.column_stack([near + s * side, np.zeros(2)]))[0]
                for s in (1, -1)
            )
            width = np.abs((left - right) @ np.array([-along[1], along[0]])) / length + self._noise(2)
            yield self._line(ends + self._noise(2, 2), np.maximum(width, 0.5))

    def _post(self, left: FloatArray, right: FloatArray, foot: FloatArray | None) -> SeenPost:
        covariance = None if foot is None else 4.0 * self.sigma_px**2 * np.eye(2)
        return SeenPost(left, right, self.sigma_px**2 * np.eye(8), foot, covariance)

    def _posts(self, look: Look) -> Iterator[SeenPost]:
        heights = np.linspace(0.0, 1.0, 60)
        for mark in self.field.landmarks:
            radius = 0.5 * mark.diameter_m
            x, y = apply(inverse(look.pose), mark.position)
            far = float(np.hypot(x, y))
            if not 0.5 < far < FARTHEST_M or x < 0.0:
                continue
            edges = []
            for turn in (1.0, -1.0):
                angle = np.arctan2(y, x) + turn * np.arcsin(radius / far)
                foot = np.sqrt(far**2 - radius**2) * np.array([np.cos(angle), np.sin(angle)])
                points = np.column_stack([np.tile(foot, (60, 1)), heights])
                pixels, inside = project_points(self.camera, look.mount, points)
                edges.append(pixels[inside])
            if min(map(len, edges)) < 5:
                continue
            before = np.append((1.0 - radius / far) * np.array([x, y]), 0.0)
            at, inside = project_points(self.camera, look.mount, before)
            left, right = (edge[[-1, 0]] + self._noise(2, 2) for edge in edges)
            yield self._post(left, right, at + 2.0 * self._noise(2) if inside else None)

    def _circles(self, look: Look) -> Iterator[SeenCircle]:
        for x, y, radius in self.field.circles:
            angle = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
            rim = np.array([x, y]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            pixels, inside = look.on_image(self.camera, rim)
            if inside.sum() > 20:
                points = pixels[inside]
                yield SeenCircle(points + self._noise(*points.shape), np.full(len(points), self.sigma_px), np.zeros(5))


def off(pose: FloatArray, truth: FloatArray, symmetries: FloatArray) -> FloatArray:
    """(3,) of a pose to the nearest of the true one and its twins."""
    errors = [pose - compose(turn, truth) for turn in (np.zeros(3), *symmetries)]
    for error in errors:
        error[2] = wrap(error[2])
    return min(errors, key=lambda error: float(np.hypot(error[0], error[1]) + abs(error[2])))
