"""Pictures of a field from any camera, with exact truth, for tests and benchmarks. Knows no OpenCV and no file.

    from fieldloc.render import Scene, render
    picture = render(Scene(), camera, field, mount, pose, rng)     # (h, w, 3) uint8, blue green red
    picture, truth = render_with_truth(Scene(), camera, field, mount, pose, rng)

camera: `fieldloc.camera.Camera`, pinhole or fisheye. field: `fieldloc.field.FieldMap`. mount: `CameraMount`.
pose: (3,) field_from_robot. `Scene()` is clean: even turf, white lines and posts, no noise; what else there can be is
in `fieldloc.render.scene`.
"""

from fieldloc.render.renderer import render, render_with_truth
from fieldloc.render.scene import Ball, Glare, Goals, Panel, Person, Robot, Scene, Sensor, Turf
from fieldloc.render.truth import Truth

__all__ = [
    "Ball",
    "Glare",
    "Goals",
    "Panel",
    "Person",
    "Robot",
    "Scene",
    "Sensor",
    "Truth",
    "Turf",
    "render",
    "render_with_truth",
]
