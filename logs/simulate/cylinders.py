"""The upright things around a field that a camera may take for goal posts: they themselves, people, robots' legs."""

from dataclasses import dataclass

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.simulate.vision_settings import VisionSettings

_USUAL_DIAMETER_M = 0.1  # of a landmark whose diameter is not known
_PERSON_HEIGHT_M = 1.7
_PERSON_OUTSIDE_M = (0.5, 1.5)  # of the field's outermost lines
_LEG_DIAMETER_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Cylinders:
    """positions: (n, p, 2) in the field frame for each of n images, NaN where there is none. radii_m, heights_m,
    chances: (p,), the last by which each is rarer than a post."""

    positions: FloatArray
    radii_m: FloatArray
    heights_m: FloatArray
    chances: FloatArray


def people_around(field: FieldMap, count: int, random: np.random.Generator) -> FloatArray:
    """(count, 2): somewhere beside the field, where they stay."""
    xmin, ymin, xmax, ymax = field.bounds
    around = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]])
    away = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    out = np.zeros((count, 2))
    for person in out:
        corners = around + random.uniform(*_PERSON_OUTSIDE_M) * away
        sides = np.roll(corners, -1, axis=0) - corners
        begins = np.concatenate([[0.0], np.cumsum(np.abs(sides).sum(axis=1))])
        along = random.uniform(0.0, begins[-1])
        side = int(np.searchsorted(begins[1:-1], along, side="right"))
        person[:] = corners[side] + (along - begins[side]) / (begins[side + 1] - begins[side]) * sides[side]
    return out


def cylinders_of(field: FieldMap, people: FloatArray, others: FloatArray, settings: VisionSettings) -> Cylinders:
    """others: (n, k, 2) the other robots in n images."""
    posts = settings.posts
    count, robots = others.shape[:2]
    standing = np.concatenate([field.positions, people])
    diameters = [mark.diameter_m or _USUAL_DIAMETER_M for mark in field.landmarks]
    diameters += [posts.person_width_m] * len(people) + [_LEG_DIAMETER_M] * robots
    heights = [posts.goal_height_m] * len(field.landmarks)
    heights += [_PERSON_HEIGHT_M] * len(people) + [settings.robots.height_m] * robots
    chances = [1.0] * len(field.landmarks) + [posts.person_chance] * len(people) + [posts.robot_chance] * robots
    positions = np.concatenate([np.broadcast_to(standing, (count, *standing.shape)), others], axis=1)
    if posts.robot_chance == 0.0:  # for speed
        kept = len(standing)
        positions, diameters, heights, chances = positions[:, :kept], diameters[:kept], heights[:kept], chances[:kept]
    return Cylinders(positions, 0.5 * np.array(diameters), np.array(heights), np.array(chances))
