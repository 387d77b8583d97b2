"""Pictures of real fields, from other people's data beside the repository.

nao: five places on an SPL field (Oomes & Visser 2024), truth by OptiTrack; with the joints' and the IMU's attitude and
without. boxes: goal posts in fisheye pictures of middle-size robots. mask: the painted lines of a humanoid's picture.
"""

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import table
from fieldloc.camera import Camera
from fieldloc.field import load_field
from fieldloc.locate import CameraPrior, Located, locate
from fieldloc.pose import FloatArray, rotation
from fieldloc.vision.detect import detect
from fieldloc.vision.detections import Detections
from fieldloc.vision.picture import load_picture

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
NAO_CAMERA = Camera("pinhole", 640, 480, 610.0, 610.0, 320.0, 240.0)
_MOUNTED_RAD = math.radians(1.2)  # the top camera's pitch in the head, as its maker says
_AHEAD_M = 0.06  # of the head's marker, whose place is measured
_POST_CLASS = 4
_OVERLAP = 0.3
_WITHIN_PX = 3
_LINE = 127  # in the mask


def run() -> str:
    if not DATA.is_dir():
        return f"skipped: {DATA} is missing: other people's pictures"
    parts = {"nao": _nao, "boxes": _boxes, "mask": _mask}
    return "\n".join(f"{name}: {part()}" for name, part in parts.items())


class Place(NamedTuple):
    """A NAO's picture: where the head's marker truly was (2,), and what the robot knew of its camera."""

    picture: Path
    marker: FloatArray
    prior: CameraPrior


def nao_places() -> Iterator[Place]:
    """None where the data is missing."""
    summary = DATA / "nao" / "truth_summary.csv"
    if not summary.is_file():
        return
    for row in csv.reader(summary.read_text(encoding="utf-8").splitlines()):
        if row[0].startswith("black"):
            x_m, y_m, height_m, _, _, head_rad, _, roll_rad, torso_rad = map(float, row[1:])
            prior = CameraPrior.told(height_m, head_rad + torso_rad + _MOUNTED_RAD, roll_rad)
            yield Place(DATA / "nao" / row[0] / "imagetop.jpg", np.array([x_m, y_m]), prior)


def nearest_marker(pose: FloatArray, marker: FloatArray) -> FloatArray:
    """(2,) how far the marker that a camera's pose implies is off the true one or its twin."""
    implied = pose[:2] - rotation(pose[2]) @ np.array([_AHEAD_M, 0.0])
    return np.asarray(min(implied - marker, implied + marker, key=lambda off: float(np.hypot(*off))))


def located_nao(place: Place, told: bool) -> Located:
    field, picture = load_field("spl"), load_picture(place.picture)
    detections = detect(picture, field.colours, NAO_CAMERA)
    return locate(detections, NAO_CAMERA, field, place.prior if told else None)


def _nao() -> str:
    rows = []
    for told in (True, False):
        for place in nao_places():
            name = f"{place.picture.parent.name}, {'told' if told else 'not told'} the attitude"
            located = located_nao(place, told)
            if not located.hypotheses:
                rows.append((name, "-", "-", "-", "-", "-"))
                continue
            offs = [nearest_marker(one.pose, place.marker) for one in located.hypotheses]
            away = [float(np.hypot(*off)) for off in offs]
            best, first = int(np.argmin(away)), located.hypotheses[0]
            sigmas = math.sqrt(offs[best] @ np.linalg.solve(located.hypotheses[best].covariance[:2, :2], offs[best]))
            rows.append(
                (name, f"{away[0]:.3f}", f"{2.0 * first.probability:.3f}", f"{away[best]:.3f}", f"{sigmas:.1f}",
                 f"{math.degrees(first.pitch_rad - place.prior.mean[1]):.1f}"),
            )  # fmt: skip
    if not rows:
        return "skipped: nao/ is missing"
    head = ("", "first m off", "P with its twin", "nearest m off", "sigmas", "pitch beside the prior's, deg")
    return "\n" + table(head, rows)


def _boxes() -> str:
    files = sorted((DATA / "images" / "msl").rglob("*.txt"))
    if not files:
        return "skipped: images/msl is missing"
    right = seen = true = 0
    for file in files:
        picture = load_picture(file.with_suffix(".jpg"))
        boxes = _post_boxes(file, picture.shape[1], picture.shape[0])
        found = [post.box_px for post in detect(picture).posts]
        true, seen = true + len(boxes), seen + len(found)
        for box in found:
            over = [_overlap(box, other) for other in boxes]
            if over and max(over) >= _OVERLAP:
                right += 1
                boxes.pop(int(np.argmax(over)))
    return f"{len(files)} pictures, posts' recall {right / max(true, 1):.2f}, precision {right / max(seen, 1):.2f}"


def _post_boxes(file: Path, width_px: int, height_px: int) -> list[FloatArray]:
    """(4,) left, top, right, bottom each."""
    out = []
    for row in file.read_text(encoding="utf-8").splitlines():
        kind, *numbers = row.split()
        if int(kind) == _POST_CLASS:
            u, v, width, height = np.array(numbers, dtype=np.float64) * [width_px, height_px, width_px, height_px]
            out.append(np.array([u - width / 2, v - height / 2, u + width / 2, v + height / 2]))
    return out


def _overlap(one: FloatArray, other: FloatArray) -> float:
    """Area in both as a share of that in either."""
    size = np.maximum(np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2]), 0.0)
    both = float(size[0] * size[1])
    areas = float(np.prod(one[2:] - one[:2]) + np.prod(other[2:] - other[:2]))
    return both / max(areas - both, 1e-9)


def _mask() -> str:
    folder = DATA / "images" / "torso"
    if not (folder / "segmentation_1_1.png").is_file():
        return "skipped: images/torso is missing"
    painted = load_picture(folder / "segmentation_1_0.png")[:, :, 0] == _LINE
    drawn = _drawn(detect(load_picture(folder / "segmentation_1_1.png")), painted.shape)
    recall, precision = _share_near(painted, drawn), _share_near(drawn, painted)
    return f"pixels of lines within {_WITHIN_PX} px: recall {recall:.2f}, precision {precision:.2f}"


def _drawn(detections: Detections, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Where the lines, circles and marks that are seen are, as wide as they are seen."""
    import cv2

    canvas = np.zeros(shape, dtype=np.uint8)
    widths = [3.0]
    for line in detections.lines:
        along = line.ends_px[1] - line.ends_px[0]
        across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        width = np.maximum(np.nan_to_num(line.width_px, nan=1.0), 1.0)[:, None]
        widths.append(float(width.mean()))
        corners = np.concatenate([line.ends_px + 0.5 * width * across, (line.ends_px - 0.5 * width * across)[::-1]])
        cv2.fillPoly(canvas, [np.round(corners * 8).astype(np.int32)], 1, cv2.LINE_8, 3)
    stroke = max(1, round(float(np.median(widths))))
    for circle in detections.circles:
        points = np.round(circle.points_px * 8).astype(np.int32)
        for point in points:
            cv2.circle(canvas, (int(point[0]), int(point[1])), 4 * stroke, 1, -1, cv2.LINE_8, 3)
    for mark in detections.marks:
        cv2.circle(canvas, (round(mark.centre_px[0]), round(mark.centre_px[1])), stroke, 1, -1)
    return np.asarray(canvas > 0)


def _share_near(some: NDArray[np.bool_], others: NDArray[np.bool_]) -> float:
    import cv2

    away = cv2.distanceTransform((~others).astype(np.uint8), cv2.DIST_L2, 5)
    return float((away[some] <= _WITHIN_PX).mean()) if some.any() else 0.0
