"""A picture of a scene from a camera's pose on the field, with the truth about what it shows."""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.render.canvas import Canvas
from fieldloc.render.exposure import UInt8Array, expose
from fieldloc.render.grid import Eye
from fieldloc.render.scene import Scene
from fieldloc.render.standing import paint_standing
from fieldloc.render.truth import Truth, truth_of
from fieldloc.render.turf import paint_ground


def render(
    scene: Scene, camera: Camera, field: FieldMap, mount: CameraMount, pose: FloatArray, rng: np.random.Generator
) -> UInt8Array:
    """(h, w, 3), blue, green, red. pose: (3,) field_from_robot. rng: for the sensor's noise alone.

    ValueError where the camera is not above the ground.
    """
    canvas, _ = _painted(scene, camera, field, mount, pose)
    return _exposed(canvas, scene, camera, rng)


def render_with_truth(
    scene: Scene, camera: Camera, field: FieldMap, mount: CameraMount, pose: FloatArray, rng: np.random.Generator
) -> tuple[UInt8Array, Truth]:
    """As `render`, with what the picture shows."""
    canvas, ranks = _painted(scene, camera, field, mount, pose)
    return _exposed(canvas, scene, camera, rng), truth_of(canvas, camera, field, scene.goals, ranks)


def _painted(
    scene: Scene, camera: Camera, field: FieldMap, mount: CameraMount, pose: FloatArray
) -> tuple[Canvas, dict[int, int]]:
    if not mount.height_m > 0.0:
        raise ValueError(f"height_m is {mount.height_m}, must be above 0")
    canvas = Canvas(Eye(camera, mount, pose, scene.sensor.blur_px), scene.sensor.gamma)
    paint_ground(canvas, scene, field)
    ranks = paint_standing(canvas, scene, field)
    canvas.light[np.isnan(canvas.eye.rays[:, 0])] = 0.0  # beyond what the lens shows
    return canvas, ranks


def _exposed(canvas: Canvas, scene: Scene, camera: Camera, rng: np.random.Generator) -> UInt8Array:
    return expose(canvas.light.reshape(camera.height_px, camera.width_px, 3), scene.sensor, rng)
