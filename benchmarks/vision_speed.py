"""From JPEG bytes to the mixture, beside OpenCV's line segment detector on the same decoded pictures. One core's time,
whatever else the machine does."""

import math
from dataclasses import replace
from time import process_time

import numpy as np

from benchmarks.timing import table
from fieldloc.camera import Camera
from fieldloc.field import load_field
from fieldloc.render import render
from fieldloc.render.random_views import USUAL_CAMERA, random_view

_SIZES = {"640x480": 1.0, "1920x1080": 3.0}
_ASKED = {"640x480": (25.0, 2.5), "1920x1080": (80.0, 2.5)}
_REPEATS = 3


def run(first: int, count: int) -> str:
    """The median of pictures, each the fastest of a few times."""
    import cv2

    cv2.setNumThreads(1)
    rows = []
    for size, scale in _SIZES.items():
        camera = _scaled(scale, size)
        times = np.array([_one(camera, seed) for seed in range(first, first + count)]) * 1e3
        decoding, detecting, locating, whole, lsd = np.median(times, axis=0)
        asked_ms, asked_ratio = _ASKED[size]
        rows.append(
            (size, f"{decoding:.1f}", f"{detecting:.1f}", f"{locating:.1f}", f"{whole:.1f}", f"{asked_ms:.0f}",
             f"{lsd:.1f}", f"{np.median(times[:, 3] / times[:, 4]):.2f}", f"{asked_ratio:g}"),
        )  # fmt: skip
    head = ("ms, one core", "decode", "detect", "locate", "all", "asked", "LSD alone", "ratio", "asked")
    return table(head, rows)


def _scaled(scale: float, size: str) -> Camera:
    width, height = map(int, size.split("x"))
    focal = USUAL_CAMERA.fx_px * scale
    return replace(
        USUAL_CAMERA, width_px=width, height_px=height, fx_px=focal, fy_px=focal,
        cx_px=0.5 * (width - 1), cy_px=0.5 * (height - 1),
    )  # fmt: skip


def _one(camera: Camera, seed: int) -> tuple[float, float, float, float, float]:
    """Seconds of decoding, detecting, locating, all of it, LSD."""
    import cv2

    from fieldloc.locate import CameraPrior, locate, mixture
    from fieldloc.vision.detect import detect
    from fieldloc.vision.picture import decode, encode

    field, random = load_field("spl"), np.random.default_rng([seed, 57])
    view = random_view(field, random, camera)
    mount = view.mount
    data = encode(render(view.scene, camera, field, mount, view.pose, random), ".jpg", 90)
    prior = CameraPrior.told(mount.height_m, mount.tilt_rad, mount.roll_rad)
    best = [math.inf] * 5
    for _ in range(_REPEATS):
        at = [process_time()]
        picture = decode(data, "view")
        at.append(process_time())
        detections = detect(picture, field.colours, camera)
        at.append(process_time())
        mixture(locate(detections, camera, field, prior), field, 0)
        at.append(process_time())
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        start = process_time()
        cv2.createLineSegmentDetector().detect(grey)
        spent = (at[1] - at[0], at[2] - at[1], at[3] - at[2], at[3] - at[0], process_time() - start)
        best = [min(pair) for pair in zip(best, spent, strict=True)]
    return best[0], best[1], best[2], best[3], best[4]
