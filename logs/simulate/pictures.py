"""What the camera of a simulated robot truly shows: a picture for each shot of a game, rendered on all cores.

What it draws is what the simulated detector gets wrong: people beside the field, other robots' legs, the carpet's
border, the circle's arcs, and blur while the head turns. The shots are those of the simulated features.
"""

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.render.random_views import random_scene
from fieldloc.render.scene import Person, Robot, Scene
from logs.simulate.course import Course
from logs.simulate.scenario import Scenario
from logs.simulate.sight import SimulatedCamera
from logs.simulate.vision_settings import VisionSettings

_QUEUED = 4  # pictures in work or waiting, for each core
_FEW = 4  # pictures that are not worth a second process
_FLICKER = 0.03  # standard deviation of the exposure's changes from picture to picture
_NO_COVARIANCE = np.zeros((4, 4))


@dataclass(frozen=True, slots=True)
class PictureSettings:
    """quality: of JPEG, 1 to 100. observations: whether the simulated detector's finds stay beside the pictures."""

    quality: int = 90
    observations: bool = False


def with_camera(scenario: Scenario, size: tuple[int, int] | None, images_hz: float | None) -> Scenario:
    """The scenario with a camera that shows the same in size = (width, height) pixels, and takes images so often."""
    vision = scenario.vision
    camera, timing = vision.camera, vision.timing
    if size is not None:
        across, down = size[0] / camera.width_px, size[1] / camera.height_px
        camera = replace(
            camera,
            width_px=size[0],
            height_px=size[1],
            fx_px=camera.fx_px * across,
            fy_px=camera.fy_px * down,
            cx_px=(camera.cx_px + 0.5) * across - 0.5,
            cy_px=(camera.cy_px + 0.5) * down - 0.5,
        )
    if images_hz is not None:
        timing = replace(timing, images_hz=images_hz)
    return replace(scenario, vision=replace(vision, camera=camera, timing=timing))


class Picture(NamedTuple):
    """mount: where the robot believes that its camera was. data: a JPEG file."""

    ready_ns: int
    stamp_ns: int
    mount: CameraMount
    data: bytes


def take_pictures(
    camera: SimulatedCamera,
    course: Course,
    field: FieldMap,
    settings: VisionSettings,
    pictures: PictureSettings,
    random: np.random.Generator,
) -> Iterator[Picture]:
    """In the order of their stamps."""
    shots = camera.shots(course)
    seeds = random.integers(2**62, size=len(shots))
    scene = _scene(camera, field, settings, random)
    headings = random.uniform(-np.pi, np.pi, (shots.others.shape[1], 1))
    blur_px = settings.camera.fx_px * settings.noise.exposure_s * shots.turning_radps
    draw = partial(_draw, field=field, camera=settings.camera, quality=pictures.quality)

    def task(k: int) -> "_Task":
        others = np.hstack([shots.others[k], headings])
        seen = others[np.isfinite(others[:, 0])].tolist()
        robots = [Robot(x_m, y_m, heading_rad, settings.robots.height_m) for x_m, y_m, heading_rad in seen]
        # a head turns sideways most of the time
        sensor = replace(scene.sensor, motion_px=(float(blur_px[k]), 0.0))
        shot = shots.shot(k)
        return _Task(replace(scene, robots=tuple(robots), sensor=sensor), shot.mount, shot.pose, int(seeds[k]))

    for k, data in enumerate(_in_order(draw, (task(k) for k in range(len(shots))), len(shots))):
        mount = shots.believed.mount(k, _NO_COVARIANCE)
        yield Picture(int(shots.log_times_ns[k]), int(shots.stamps_ns[k]), mount, data)


class _Task(NamedTuple):
    scene: Scene
    mount: CameraMount
    pose: FloatArray
    seed: int


def _scene(camera: SimulatedCamera, field: FieldMap, settings: VisionSettings, random: np.random.Generator) -> Scene:
    """The same hall and light all game long."""
    scene = random_scene(field, random)
    people = [
        replace(person, x_m=x, y_m=y)
        for person, (x, y) in zip(_dressed(random), camera.people(field).tolist(), strict=False)
    ]
    turf = replace(scene.turf, border_m=settings.lines.border_m)
    return replace(scene, turf=turf, people=tuple(people), robots=())


def _dressed(random: np.random.Generator) -> Iterator[Person]:
    while True:
        trousers, shirt = random.uniform(20.0, 235.0, (2, 3)).tolist()
        yield Person(0.0, 0.0, random.uniform(1.5, 1.95), tuple(trousers), tuple(shirt))


def _draw(task: _Task, field: FieldMap, camera: Camera, quality: int) -> bytes:
    """In whatever process."""
    from fieldloc.render.renderer import render
    from fieldloc.vision.picture import encode

    random = np.random.default_rng(task.seed)
    sensor = task.scene.sensor
    sensor = replace(
        sensor,
        exposure=sensor.exposure * (1.0 + _FLICKER * random.standard_normal()),
        rolling_phase_rad=random.uniform(0.0, 2.0 * np.pi),
    )
    picture = render(replace(task.scene, sensor=sensor), camera, field, task.mount, task.pose, random)
    return encode(picture, ".jpg", quality)


def _in_order(draw: "partial[bytes]", tasks: Iterator[_Task], count: int) -> Iterator[bytes]:
    if count < _FEW:
        yield from map(draw, tasks)
        return
    processes = os.cpu_count() or 1
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        waiting: deque[Future[bytes]] = deque()
        try:
            for task in tasks:
                waiting.append(pool.submit(draw, task))
                if len(waiting) > _QUEUED * processes:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
