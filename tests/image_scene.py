"""A camera on a robot on a field: the posts and lines that it would see, exactly or with noise of given pixels."""

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount, ImageFeatures, LineObservation, PostObservation
from fieldloc.pose import FloatArray

CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
MOUNT = CameraMount(0.55, 0.0, 0.35, 0.0, np.diag([0.01, 0.01, 0.01, 0.01]) ** 2, 0.03, 0.0)
_STEPS = 400  # points along a line of which the first and last on the image are taken


def see(
    field: FieldMap,
    pose: FloatArray,
    stamp_ns: int,
    random: np.random.Generator,
    sigma_px: float,
    mount: CameraMount = MOUNT,
) -> ImageFeatures:
    """What the camera of the robot at `pose` (3,) sees; the real mount is off by a draw of its covariance."""
    error = random.multivariate_normal(np.zeros(4), mount.covariance) if sigma_px > 0.0 else np.zeros(4)
    real = CameraMount(
        mount.height_m + error[0],
        mount.pan_rad + error[1],
        mount.tilt_rad + error[2],
        mount.roll_rad + error[3],
        mount.covariance,
        mount.x_m,
        mount.y_m,
    )
    noise = max(sigma_px, 0.1) ** 2

    def noisy(points: FloatArray) -> FloatArray:
        return points + sigma_px * random.standard_normal(points.shape)

    lines = []
    for ends in field.lines:
        along = np.linspace(0.0, 1.0, _STEPS)[:, None]
        pixels = _on_image(real, pose, ends[0] + along * (ends[1] - ends[0]), np.zeros(_STEPS))
        if len(pixels) > 20 and np.linalg.norm(pixels[-1] - pixels[0]) > 40.0:
            lines.append(LineObservation(noisy(pixels[[0, -1]]), noise * np.eye(4)))
    posts = []
    for mark in field.landmarks:
        camera_at = se2.apply(pose, np.array([real.x_m, real.y_m]))
        away = mark.position - camera_at
        distance = np.linalg.norm(away)
        radius = 0.5 * mark.diameter_m
        # where the lines of sight touch the cylinder
        half = np.arcsin(radius / distance)
        reach = np.sqrt(distance**2 - radius**2)
        touching = [camera_at + reach * se2.rotation(side * half) @ (away / distance) for side in (1.0, -1.0)]
        edges = _on_image(real, pose, np.array(touching), np.full(2, real.height_m))
        foot = _on_image(real, pose, (mark.position - radius * away / distance)[None], np.zeros(1))
        if len(foot) and not len(edges):
            edges = _on_image(real, pose, np.array(touching), np.full(2, 0.05))
        if len(edges) == 2 and len(foot) == 1:
            posts.append(PostObservation(noisy(edges), noise * np.eye(4), noisy(foot)[0], 4.0 * noise * np.eye(2)))
    return ImageFeatures(stamp_ns, mount, tuple(posts), tuple(lines))


def _on_image(mount: CameraMount, pose: FloatArray, points: FloatArray, heights_m: FloatArray) -> FloatArray:
    in_robot = se2.apply(se2.inverse(pose), points)
    pixels, visible = project_points(CAMERA, mount, np.column_stack([in_robot, heights_m]))
    inside = visible & (pixels > 0.0).all(axis=-1) & (pixels < [639.0, 479.0]).all(axis=-1)
    return pixels[inside]
