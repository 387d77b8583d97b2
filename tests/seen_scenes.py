"""What a camera would detect of a map: exact projections with noise of stated covariance, and clutter."""

from dataclasses import dataclass

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.view import visible_parts
from fieldloc.vision.detections import Detections, SeenCircle, SeenLine, SeenPost

NAO = Camera("pinhole", 640, 480, 610.0, 610.0, 320.0, 240.0)


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


def seen(
    look: Look,
    camera: Camera,
    field: FieldMap,
    random: np.random.Generator,
    sigma_px: float = 0.3,
    clutter: int = 0,
    circles: bool = True,
    farthest_m: float = 9.0,
) -> Detections:
    lines = [*_lines(look, camera, field, random, sigma_px, farthest_m)]
    for _ in range(clutter):
        start = random.uniform([0, 0.35 * camera.height_px], [camera.width_px, camera.height_px])
        angle, length = random.uniform(0, np.pi), random.uniform(30, 150)
        lines.append(_line(np.stack([start, start + length * np.array([np.cos(angle), np.sin(angle)])]), sigma_px))
    posts = [*_posts(look, camera, field, random, sigma_px)]
    for _ in range(clutter // 2):
        u, v, width = random.uniform(0, camera.width_px), random.uniform(100, 300), random.uniform(8, 40)
        posts.append(_post(u, v - random.uniform(50, 100), v, width, sigma_px))
    found = [*_circles(look, camera, field, random, sigma_px)] if circles else []
    return Detections(camera.width_px, camera.height_px, tuple(lines), tuple(posts), tuple(found))


def _line(ends: FloatArray, sigma_px: float, width: FloatArray | None = None) -> SeenLine:
    covariance = sigma_px**2 * np.eye(4)
    widths = np.full(2, np.nan) if width is None else width
    return SeenLine(ends, covariance, widths, np.full(2, 2.0 * sigma_px))


def _lines(look, camera, field, random, sigma_px, farthest_m):  # type: ignore[no-untyped-def]
    in_robot = apply(inverse(look.pose), field.lines.reshape(-1, 2)).reshape(-1, 2, 2)
    from fieldloc.symmetry import merge_segments

    in_robot = merge_segments(in_robot)
    parts, index = visible_parts(camera, look.mount, in_robot)
    for part, _ in zip(parts, index, strict=True):
        far = np.linalg.norm(part, axis=-1)
        if far.min() > farthest_m:
            continue
        if far.max() > farthest_m:  # cut where it is too far to be seen
            near, away = (part[0], part[1]) if far[0] < far[1] else (part[1], part[0])
            share = np.linspace(0, 1, 200)[:, None]
            points = near + share * (away - near)
            inside = points[np.linalg.norm(points, axis=-1) <= farthest_m]
            part = np.stack([inside[0], inside[-1]])
        ends, _ = project_points(camera, look.mount, np.column_stack([part, np.zeros(2)]))
        length = np.hypot(*(ends[1] - ends[0]))
        if length < 20:
            continue
        along = (part[1] - part[0]) / np.linalg.norm(part[1] - part[0])
        side = 0.5 * field.line_width_m * np.array([-along[1], along[0]])
        edges = [
            project_points(camera, look.mount, np.column_stack([part + s * side, np.zeros(2)]))[0] for s in (1, -1)
        ]
        normal = np.array([-(ends[1] - ends[0])[1], (ends[1] - ends[0])[0]]) / length
        width = np.abs((edges[0] - edges[1]) @ normal) + random.normal(0, 2 * sigma_px, 2)
        yield _line(ends + random.normal(0, sigma_px, (2, 2)), sigma_px, np.maximum(width, 0.5))


def _post(u, top, foot, width, sigma_px, lean=0.0):  # type: ignore[no-untyped-def]
    left = np.array([[u - width / 2, top], [u - width / 2, foot]])
    right = np.array([[u + width / 2, top], [u + width / 2, foot]])
    return SeenPost(left, right, sigma_px**2 * np.eye(8), np.array([u, foot]), (2 * sigma_px) ** 2 * np.eye(2))


def _posts(look, camera, field, random, sigma_px):  # type: ignore[no-untyped-def]
    for mark in field.landmarks:
        radius, height = 0.5 * mark.diameter_m, mark.height_m or 0.8
        x, y = apply(inverse(look.pose), mark.position)
        far = np.hypot(x, y)
        if far < 0.5 or far > 10 or x < 0:
            continue
        bearing, half = np.arctan2(y, x), np.arcsin(radius / far)
        tangent = np.sqrt(far**2 - radius**2)
        edges = []
        for angle in (bearing + half, bearing - half):
            point = tangent * np.array([np.cos(angle), np.sin(angle)])
            heights = np.linspace(0, height, 60)
            pixels, inside = project_points(camera, look.mount, np.column_stack([np.tile(point, (60, 1)), heights]))
            edges.append(pixels[inside][[-1, 0]] if inside.sum() > 5 else None)
        if edges[0] is None or edges[1] is None:
            continue
        front = (far - radius) / far * np.array([x, y])
        foot, inside = project_points(camera, look.mount, np.array([*front, 0.0]))
        noise = random.normal(0, sigma_px, (2, 2, 2))
        yield SeenPost(
            edges[0] + noise[0],
            edges[1] + noise[1],
            sigma_px**2 * np.eye(8),
            foot + random.normal(0, 2 * sigma_px, 2) if inside else None,
            (2 * sigma_px) ** 2 * np.eye(2) if inside else None,
        )


def _circles(look, camera, field, random, sigma_px):  # type: ignore[no-untyped-def]
    for x, y, radius in field.circles:
        angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
        rim = np.array([x, y]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        in_robot = apply(inverse(look.pose), rim)
        pixels, inside = project_points(camera, look.mount, np.column_stack([in_robot, np.zeros(80)]))
        if inside.sum() > 20 and np.linalg.norm(in_robot, axis=-1).min() < 6:
            points = pixels[inside] + random.normal(0, sigma_px, (int(inside.sum()), 2))
            yield SeenCircle(points, np.full(len(points), sigma_px), np.zeros(5))
