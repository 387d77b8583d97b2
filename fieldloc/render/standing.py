"""What stands on the ground or around it, from the farthest to the nearest: walls, goals, people, robots, balls."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.render.canvas import Canvas
from fieldloc.render.flat import Quad, Ring, strip
from fieldloc.render.goals import crossbars, diameter_m, post_colour, post_of
from fieldloc.render.grid import Indices
from fieldloc.render.net import net_of
from fieldloc.render.scene import WHITE, Ball, Colour, Panel, Person, Robot, Scene
from fieldloc.render.shapes import Shape
from fieldloc.render.solid import Pillar, Sphere


class Painted(NamedTuple):
    """part: of the map: the row of the landmark that it is; the crossbars follow on them. -1 where it is none of these.
    shading: as in Goals."""

    distance_m: float
    shape: Shape
    colour: Colour
    part: int = -1
    shading: float = 0.0


def paint_standing(canvas: Canvas, scene: Scene, field_map: FieldMap) -> dict[int, int]:
    """All of it; returns the rank at which each part of the map that is in sight was painted."""
    eye = canvas.eye.centre
    for shadow, gain in _shadows(scene, field_map):
        canvas.shade(*canvas.shares(shadow), gain)
    ranks: dict[int, int] = {}
    things = [*_panels(scene.panels, eye), *sorted(_things(scene, field_map, eye), key=lambda it: -it.distance_m)]
    for thing in things:
        pixels, share = canvas.shares(thing.shape)
        if not len(pixels):
            continue
        light = canvas.light_of(thing.colour)
        if thing.shading > 0.0 and isinstance(thing.shape, Pillar):
            light = light * _roundness(canvas, thing.shape, pixels, thing.shading).astype(np.float32)[:, None]
        rank = canvas.paint(pixels, share, light)
        if thing.part >= 0:
            ranks[thing.part] = rank
    return ranks


def _things(scene: Scene, field_map: FieldMap, eye: FloatArray) -> Iterator[Painted]:
    goals = scene.goals
    colour = goals.colour or post_colour(field_map)
    posts = [post_of(field_map, index, goals) for index in range(len(field_map.landmarks))]
    for row, bar in enumerate(crossbars(field_map, goals), len(posts)):
        # behind the farther of its posts: both are painted over its ends
        yield Painted(max(_distance(end[:2], eye) for end in (bar.start, bar.end)) + 0.01, bar, colour, row)
        for mesh in net_of(bar, bar.start[2]) if goals.net else ():
            yield Painted(_distance(mesh.frame.corners.mean(axis=0)[:2], eye), mesh, WHITE)
    for index, post in enumerate(posts):
        yield Painted(_distance(post.centre, eye), post, colour, index, goals.shading)
    for ball in scene.balls:
        yield from _ball(ball, eye)
    for robot in scene.robots:
        yield from _robot(robot, eye)
    for person in scene.people:
        yield from _person(person, eye)


def _panels(panels: tuple[Panel, ...], eye: FloatArray) -> Iterator[Painted]:
    """In the given order: what is in front comes last."""
    for panel in panels:
        low, high = [*panel.start, panel.low_m], [*panel.end, panel.low_m]
        corners = np.array([low, high, [*panel.end, panel.high_m], [*panel.start, panel.high_m]])
        yield Painted(_distance(corners.mean(axis=0)[:2], eye), Quad(corners), panel.colour)


def _ball(ball: Ball, eye: FloatArray) -> Iterator[Painted]:
    centre = np.array([ball.x_m, ball.y_m, ball.radius_m])
    distance = _distance(centre[:2], eye)
    yield Painted(distance, Sphere(centre, ball.radius_m), ball.colour)
    for k in range(5):  # dark patches, a little in front of the ball's middle as the camera sees it
        turn = 2.0 * np.pi * k / 5 + ball.x_m
        around = np.array([np.cos(turn), np.sin(turn), 0.9 * np.sin(2.0 * turn)])
        around *= 0.62 * ball.radius_m / np.linalg.norm(around)
        yield Painted(distance - 0.001, Sphere(centre + around, 0.28 * ball.radius_m), ball.patches)


def _robot(robot: Robot, eye: FloatArray) -> Iterator[Painted]:
    size = robot.height_m
    place = np.array([robot.x_m, robot.y_m])
    left = np.array([-np.sin(robot.heading_rad), np.cos(robot.heading_rad)])
    ahead = np.array([left[1], -left[0]])
    for side in (1.0, -1.0):
        foot = place + 0.1 * size * side * left
        yield from _pillar(foot + 0.03 * size * ahead, 0.1 * size, 0.0, 0.07 * size, robot.legs, eye)
        yield from _pillar(foot, 0.07 * size, 0.07 * size, 0.5 * size, robot.legs, eye, 0.001)
        arm = place + 0.24 * size * side * left
        yield from _pillar(arm, 0.045 * size, 0.4 * size, 0.78 * size, robot.legs, eye)
    yield from _pillar(place, 0.17 * size, 0.47 * size, 0.8 * size, robot.trunk, eye)
    head = np.append(place, 0.9 * size)
    yield Painted(_distance(place, eye) - 0.001, Sphere(head, 0.1 * size), robot.legs)


def _person(person: Person, eye: FloatArray) -> Iterator[Painted]:
    size = person.height_m
    place = np.array([person.x_m, person.y_m])
    for side in (1.0, -1.0):
        foot = place + side * 0.06 * size * np.array([0.6, 0.8])
        yield from _pillar(foot, 0.045 * size, 0.0, 0.5 * size, person.trousers, eye)
    yield from _pillar(place, 0.12 * size, 0.48 * size, 0.83 * size, person.shirt, eye)
    head = np.append(place, 0.92 * size)
    yield Painted(_distance(place, eye) - 0.001, Sphere(head, 0.07 * size), (120.0, 150.0, 200.0))


def _pillar(
    place: FloatArray,
    radius_m: float,
    low_m: float,
    high_m: float,
    colour: Colour,
    eye: FloatArray,
    nearer_m: float = 0.0,
) -> Iterator[Painted]:
    yield Painted(_distance(place, eye) - nearer_m, Pillar(place, radius_m, low_m, high_m), colour, shading=0.25)


def _shadows(scene: Scene, field_map: FieldMap) -> Iterator[tuple[Shape, float]]:
    """Under what stands on the ground, and of the posts where the light comes from one side."""
    goals = scene.goals
    reach = np.array(goals.shadow_m)
    if goals.shadow_dark > 0.0 and np.linalg.norm(reach) > 0.0:
        for mark in field_map.landmarks:
            yield strip(mark.position, mark.position + reach, diameter_m(mark)), 1.0 - goals.shadow_dark
    if scene.contact_dark > 0.0:
        for robot in scene.robots:
            yield Ring(np.array([robot.x_m, robot.y_m]), 0.38 * robot.height_m), 1.0 - scene.contact_dark
        for ball in scene.balls:
            yield Ring(np.array([ball.x_m, ball.y_m]), 0.9 * ball.radius_m), 1.0 - scene.contact_dark


def _roundness(canvas: Canvas, pillar: Pillar, pixels: Indices, shading: float) -> FloatArray:
    """Gain (m,) across a pillar: full in its middle, darker at its sides."""
    normals = pillar.normals(canvas.eye.centre)
    if normals is None:
        return np.ones(len(pixels))
    left, right = (canvas.eye.rays[pixels].astype(np.float64) @ normals.T).T
    across = np.clip((left - right) / np.maximum(left + right, 1e-9), -1.0, 1.0)
    return np.asarray(1.0 - shading * across**2)


def _distance(place: FloatArray, eye: FloatArray) -> float:
    return float(np.hypot(*(place - eye[:2])))
