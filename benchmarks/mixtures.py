"""What it costs to make a mixture: of an image of two posts and eight lines, and of ten landmarks without a name on a
map of fifty. Beside it a hundred products of numpy's of eight matrices (3, 3): what a call costs here, mostly.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice

import numpy as np

from benchmarks.timing import fastest_s, table
from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.fixes.cylinder import edge_bearings
from fieldloc.ground import project_points
from fieldloc.image_mixture import image_mixture
from fieldloc.measurements import CameraMount, ImageFeatures, LandmarkScan, LineObservation, PostObservation
from fieldloc.pose import FloatArray, apply, inverse, wrap
from fieldloc.scan_mixture import scan_mixture
from fieldloc.view import visible_parts

_CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
_MOUNT = CameraMount(0.55, 0.0, 0.35, 0.0, np.diag([0.01, 0.01, 0.01, 0.01]) ** 2, 0.03, 0.0)
_SIGMA_PX, _LEAST_LINE_PX = 0.5, 40.0
_LINES, _POSTS = 8, 2
_LANDMARKS, _SEEN, _OUTLIERS = 50, 10, 2
_SIGMA_RANGE_M, _SIGMA_BEARING_RAD = 0.05, 0.02
_ASKED_MS = {"image": 2.0, "scan": 10.0}


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(prog="python -m benchmarks mixtures", description=__doc__)
    parser.add_argument("--count", type=int, default=40, metavar="N", help="so many of each (40)")
    parser.add_argument(
        "--repeats", type=int, default=10, metavar="N", help="the fastest of N runs of each counts (10)"
    )
    chosen = parser.parse_args(options)
    detection, field = Detection(), load_field("kidsize")
    works: dict[str, list[Callable[[], object]]] = {
        "image": [
            partial(image_mixture, image, _CAMERA, field, detection)
            for image in islice(_images(field, np.random.default_rng(0)), chosen.count)
        ],
        "scan": [
            partial(_solutions, scan, on_map, detection)
            for scan, on_map in islice(_scans(np.random.default_rng(0)), chosen.count)
        ],
    }
    rows = []
    for name, each in works.items():
        *times, peer = np.array(fastest_s([*each, _peer], chosen.repeats)) * 1e3
        median, worst = float(np.median(times)), float(max(times))
        rows.append(
            (name, f"{median:.2f}", f"{worst:.2f}", f"{_ASKED_MS[name]:g}", f"{peer:.3f}", f"{median / peer:.0f}")
        )
    head = ("ms, one core", "median", "worst", "asked", "100 products", "times as long")
    return table(head, rows)


def _peer() -> None:
    matrices = np.ones((8, 3, 3))
    for _ in range(100):
        matrices @ matrices


def _solutions(scan: LandmarkScan, field: FieldMap, detection: Detection) -> object:
    mixture = scan_mixture(scan, field, detection, np.ones((_LANDMARKS, 2)))
    return None if mixture is None else mixture.solutions()


def _images(field: FieldMap, random: np.random.Generator) -> Iterator[ImageFeatures]:
    """From anywhere on the field whence so much is seen."""
    x_min, y_min, x_max, y_max = field.bounds
    while True:
        pose = random.uniform([x_min, y_min, -np.pi], [x_max, y_max, np.pi])
        lines, posts = _lines(field, pose, random), _posts(field, pose, random)
        if (len(lines), len(posts)) == (_LINES, _POSTS):
            yield ImageFeatures(0, _MOUNT, posts, lines)


def _lines(field: FieldMap, pose: FloatArray, random: np.random.Generator) -> tuple[LineObservation, ...]:
    parts, _ = visible_parts(_CAMERA, _MOUNT, apply(inverse(pose), field.lines))
    ends, _ = project_points(_CAMERA, _MOUNT, np.concatenate([parts, np.zeros((len(parts), 2, 1))], axis=-1))
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) > _LEAST_LINE_PX
    noise = _SIGMA_PX**2 * np.eye(4)
    return tuple(LineObservation(random.normal(one, _SIGMA_PX), noise) for one in ends[long])


def _posts(field: FieldMap, pose: FloatArray, random: np.random.Generator) -> tuple[PostObservation, ...]:
    foot_of_camera = np.array([_MOUNT.x_m, _MOUNT.y_m])
    noise = _SIGMA_PX**2 * np.eye(4)
    found = []
    for mark in field.landmarks:
        x, y = apply(inverse(pose), mark.position) - foot_of_camera
        distance, radius = float(np.hypot(x, y)), 0.5 * mark.diameter_m
        bearings, is_outside = edge_bearings(np.array([distance, np.arctan2(y, x)]), radius)
        if not is_outside:
            continue
        touching = np.sqrt(distance**2 - radius**2) * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        ground = np.array([*touching, (1.0 - radius / distance) * np.array([x, y])]) + foot_of_camera
        pixels, inside = project_points(_CAMERA, _MOUNT, np.column_stack([ground, [0.05, 0.05, 0.0]]))
        if inside.all():
            *edges, foot = random.normal(pixels, _SIGMA_PX)
            found.append(PostObservation(np.array(edges), noise, foot, noise[:2, :2]))
    return tuple(found)


def _scans(random: np.random.Generator) -> Iterator[tuple[LandmarkScan, FieldMap]]:
    """Of the nearest landmarks, every other one with two that are not there."""
    sigmas = np.array([_SIGMA_RANGE_M, _SIGMA_BEARING_RAD])
    outliers = 0
    while True:
        positions = random.uniform(-10.0, 10.0, (_LANDMARKS, 2))
        pose = random.uniform([-5.0, -5.0, -np.pi], [5.0, 5.0, np.pi])
        at = apply(inverse(pose), positions)
        x, y = at[np.argsort(np.hypot(at[:, 0], at[:, 1]))[:_SEEN]].T
        seen = random.normal(np.column_stack([np.hypot(x, y), np.arctan2(y, x)]), sigmas)
        seen[:outliers] = random.uniform([0.5, -np.pi], [5.0, np.pi], (outliers, 2))
        seen[:, 1] = wrap(seen[:, 1])
        marks = tuple(Landmark(str(i), place, 0.1, np.zeros((2, 2))) for i, place in enumerate(positions))
        field = FieldMap("fifty", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)
        covariance = np.tile(np.diag(sigmas**2), (_SEEN, 1, 1))
        yield LandmarkScan(0, (None,) * _SEEN, seen, covariance, np.zeros(3)), field
        outliers = _OUTLIERS - outliers
