"""Views of a field drawn at random: a robot's camera somewhere on it, with all that makes real pictures hard."""

import math
from dataclasses import dataclass, replace

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.render.goals import post_colour
from fieldloc.render.scene import Ball, Colour, Glare, Goals, Panel, Person, Robot, Scene, Sensor, Turf

USUAL_CAMERA = Camera("pinhole", 640, 480, 550.0, 550.0, 319.5, 239.5)
"""60 degrees wide, without distortion."""
_HEIGHTS_M = {"kidsize-2014": (0.4, 0.6), "kidsize": (0.45, 0.75), "adultsize": (1.1, 1.6), "spl": (0.44, 0.56)}
_USUAL_HEIGHTS_M = (0.4, 0.7)
_PAN_RAD, _ROLL_RAD = 1.0, 0.03
_TILTS_RAD = (0.05, 0.5)
_BESIDE_M = 0.3  # of the field, as far as a robot steps out
_CLEAR_M = 0.7  # around the camera, without other robots
_NO_COVARIANCE = np.zeros((4, 4))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What `render` needs. pose: (3,) field_from_robot; the mount is the true one, without covariance (zeros)."""

    scene: Scene
    camera: Camera
    mount: CameraMount
    pose: FloatArray


def random_view(
    field: FieldMap, random: np.random.Generator, camera: Camera = USUAL_CAMERA, clean: bool = False
) -> View:
    """clean: nothing but the field, and no noise."""
    xmin, ymin, xmax, ymax = field.bounds
    pose = np.array(
        [
            random.uniform(xmin - _BESIDE_M, xmax + _BESIDE_M),
            random.uniform(ymin - _BESIDE_M, ymax + _BESIDE_M),
            random.uniform(-math.pi, math.pi),
        ]
    )
    mount = CameraMount(
        random.uniform(*_HEIGHTS_M.get(field.name, _USUAL_HEIGHTS_M)),
        random.uniform(-_PAN_RAD, _PAN_RAD),
        random.uniform(*_TILTS_RAD),
        _ROLL_RAD * random.standard_normal(),
        _NO_COVARIANCE,
    )
    return View(Scene() if clean else random_scene(field, random, pose[:2]), camera, mount, pose)


def random_scene(field: FieldMap, random: np.random.Generator, keep_clear: FloatArray | None = None) -> Scene:
    """A hall with a carpet, people around it, robots and a ball on it; keep_clear: (2,) where no robot stands."""
    low, high = np.array(field.bounds[:2]), np.array(field.bounds[2:])
    height_m = max([0.4 * mark.height_m for mark in field.landmarks] + [0.5])
    robots = [
        Robot(float(x), float(y), random.uniform(-math.pi, math.pi), height_m * random.uniform(0.9, 1.3))
        for x, y in random.uniform(low, high, (int(random.integers(0, 6)), 2))
        if keep_clear is None or math.hypot(x - keep_clear[0], y - keep_clear[1]) > _CLEAR_M
    ]
    robots = [replace(robot, legs=_grey(random, 150, 235), trunk=_grey(random, 40, 220)) for robot in robots]
    balls = [Ball(float(x), float(y), random.uniform(0.05, 0.1)) for x, y in random.uniform(low, high, (2, 2))]
    border_m = random.uniform(0.4, 1.2)
    return Scene(
        turf=_turf(random, low, high, border_m),
        goals=Goals(
            colour=post_colour(field, int(random.integers(len(field.colours.posts))), random.uniform(0.7, 0.95)),
            net=bool(random.random() < 0.5),
            shading=random.uniform(0.0, 0.4),
            shadow_m=(float(random.normal(0.0, 0.7)), float(random.normal(0.0, 0.7))),
            shadow_dark=random.uniform(0.0, 0.4),
        ),
        sensor=random_sensor(random),
        balls=tuple(balls[: int(random.integers(0, 3))]),
        robots=tuple(robots),
        people=tuple(_people(random, low - border_m, high + border_m)),
        panels=tuple(_hall(random, low - border_m, high + border_m)),
        ceiling=_grey(random, 90, 220),
        contact_dark=random.uniform(0.1, 0.4),
    )


def random_sensor(random: np.random.Generator) -> Sensor:
    motion_px = random.exponential(0.5, 2) * random.choice([-1.0, 1.0], 2)
    return Sensor(
        blur_px=random.uniform(0.5, 1.0),
        motion_px=(float(motion_px[0]), float(motion_px[1])),
        vignetting=random.uniform(0.0, 0.3),
        exposure=random.uniform(0.75, 1.05),
        rolling=random.uniform(0.0, 0.06),
        rolling_rows=random.uniform(100.0, 400.0),
        rolling_phase_rad=random.uniform(0.0, 2.0 * math.pi),
        read_noise=random.uniform(0.5, 3.0),
        shot_noise=random.uniform(1.0, 6.0),
        gamma=random.uniform(1.0, 2.2),
    )


def _turf(random: np.random.Generator, low: FloatArray, high: FloatArray, border_m: float) -> Turf:
    green = random.uniform(80.0, 150.0)
    glares = tuple(
        Glare(float(x), float(y), random.uniform(0.3, 1.2), random.choice([0.7, 1.2, 1.4]))
        for x, y in random.uniform(low, high, (int(random.integers(0, 5)), 2))
    )
    return Turf(
        colour=(green * random.uniform(0.2, 0.6), green, green * random.uniform(0.15, 0.6)),
        floor=_grey(random, 60, 180),
        border_m=border_m,
        mown=random.choice([0.0, random.uniform(0.0, 0.12)]),
        mown_m=random.uniform(0.6, 1.5),
        mown_along_rad=random.choice([0.0, math.pi / 2]),
        roughness=random.uniform(0.02, 0.12),
        wear=random.uniform(0.0, 0.35),
        glares=glares,
        seed=int(random.integers(2**31)),
    )


def _people(random: np.random.Generator, low: FloatArray, high: FloatArray) -> list[Person]:
    """Outside of the rectangle."""
    out = []
    for _ in range(int(random.integers(0, 7))):
        place = random.uniform(low, high)
        axis, side = int(random.integers(2)), int(random.integers(2))
        place[axis] = (low, high)[side][axis] + (2 * side - 1) * random.uniform(0.2, 1.5)
        trousers, shirt = (_any_colour(random) for _ in range(2))
        out.append(Person(float(place[0]), float(place[1]), random.uniform(1.5, 1.95), trousers, shirt))
    return out


def _hall(random: np.random.Generator, low: FloatArray, high: FloatArray) -> list[Panel]:
    """Four walls with windows, their bright frames and banners; here and there a post of something else."""
    away_m, height_m = random.uniform(1.6, 6.0), random.uniform(2.5, 6.0)
    low, high = low - away_m, high + away_m
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    wall = _grey(random, 90, 225)
    panels = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        panels.append(_panel(start, end, 0.0, 1.0, 0.0, height_m, wall))
        length_m = float(np.linalg.norm(end - start))
        if random.random() < 0.5:
            panels.append(_panel(start, end, 0.0, 1.0, 0.0, random.uniform(0.3, 0.9), _grey(random, 60, 235)))
        for _ in range(int(random.integers(0, 5))):
            first, width = random.uniform(0.02, 0.8), random.uniform(0.8, 2.5) / length_m
            panels += _window(random, start, end, first, min(width, 0.98 - first), height_m, 0.09 / length_m)
        for _ in range(int(random.integers(0, 3))):
            first = random.uniform(0.02, 0.9)
            panels.append(
                _panel(
                    start, end, first, first + 0.1 / length_m, 0.0, random.uniform(1.0, height_m), _any_colour(random)
                )
            )
    return panels


def _window(
    random: np.random.Generator,
    start: FloatArray,
    end: FloatArray,
    first: float,
    width: float,
    height_m: float,
    frame: float,
) -> list[Panel]:
    """Shares of the wall's length: where it begins, how wide it is and its frame."""
    low_m, high_m = random.uniform(0.0, 1.2), random.uniform(1.8, height_m)
    pane, bars = (_grey(random, 225, 255), _grey(random, 40, 230))
    out = [_panel(start, end, first, first + width, low_m, high_m, pane)]
    for at in np.linspace(first, first + width, int(random.integers(2, 5))):
        out.append(_panel(start, end, float(at), float(at) + frame, low_m, high_m, bars))
    return out


def _panel(
    start: FloatArray, end: FloatArray, first: float, last: float, low_m: float, high_m: float, colour: Colour
) -> Panel:
    """The part of a wall between two shares of its way."""
    one, other = start + first * (end - start), start + last * (end - start)
    return Panel((float(one[0]), float(one[1])), (float(other[0]), float(other[1])), low_m, high_m, colour)


def _grey(random: np.random.Generator, least: float, most: float) -> Colour:
    blue, green, red = np.clip(random.uniform(least, most) + random.normal(0.0, 6.0, 3), 0.0, 255.0).tolist()
    return blue, green, red


def _any_colour(random: np.random.Generator) -> Colour:
    blue, green, red = random.uniform(20.0, 235.0, 3).tolist()
    return blue, green, red
