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
    out = []
    for _ in range(count):
        outside = random.uniform(*_PERSON_OUTSIDE_M)
        width, height = xmax - xmin, ymax - ymin
        along = random.uniform(0.0, 2.0 * (width + height))
        if along < 2.0 * width:
            out.append([xmin + along % width, ymin - outside if along < width else ymax + outside])
        else:
            along -= 2.0 * width
            out.append([xmin - outside if along < height else xmax + outside, ymin + along % height])
    return np.array(out).reshape(-1, 2)


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
