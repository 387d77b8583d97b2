"""What other robots hide from a camera: upright cylinders between it and the ground or a post."""

import numpy as np

from fieldloc.pose import FloatArray
from logs.simulate.clipping import Part, inside_half_spaces
from logs.simulate.vision_settings import OtherRobotSettings

_TOUCHING = 0.99  # of its distance: a robot that touches the camera is taken as not quite as wide
_SAME_M = 1e-6


def hidden_part(
    centres: FloatArray, robot: FloatArray, settings: OtherRobotSettings, start: FloatArray, end: FloatArray
) -> Part:
    """The part (m,) of ground segments from start (m, 2) to end (m, 2) behind a robot (m, 2); none where it is NaN.

    centres: (m, 3) of the cameras. The robot's shadow is what lies between the tangents to it, from its near side on
    and, where the camera looks over it, up to where the ray past its top meets the ground.
    """
    away = robot - centres[:, :2]
    distance = np.hypot(away[:, 0], away[:, 1])
    safe = np.where(distance > 0.0, distance, 1.0)
    ahead = away / safe[:, None]
    sine = np.minimum(settings.radius_m / safe, _TOUCHING)
    cosine = np.sqrt(1.0 - sine**2)
    above = centres[:, 2] - settings.height_m
    looks_over = above > 0.0
    far = (distance + settings.radius_m) * centres[:, 2] / np.where(looks_over, above, 1.0)

    def sides(points: FloatArray) -> list[FloatArray]:
        x, y = (points - centres[:, :2]).T
        along = x * ahead[:, 0] + y * ahead[:, 1]
        across = y * ahead[:, 0] - x * ahead[:, 1]
        before_far = np.where(looks_over, far - along, 1.0)
        return [
            along * sine - across * cosine,
            along * sine + across * cosine,
            along - np.maximum(distance - settings.radius_m, 0.0),
            before_far,
        ]

    return inside_half_spaces(list(zip(sides(start), sides(end), strict=True)))


def hidden_below(
    centres: FloatArray, others: FloatArray, settings: OtherRobotSettings, points: FloatArray
) -> FloatArray:
    """Up to which height (n, p) verticals over points (n, p, 2) are behind other robots (n, k, 2); -inf where not.

    centres: (n, 3) of the cameras. A robot hides what is farther away than its own axis.
    """
    to_point = points - centres[:, None, :2]
    distance = np.hypot(to_point[..., 0], to_point[..., 1])
    out = np.full(distance.shape, -np.inf)
    if not settings.hide:
        return out
    height = centres[:, 2:]
    for other in np.moveaxis(others, 1, 0):
        away = other - centres[:, :2]
        near = np.maximum(np.hypot(away[:, 0], away[:, 1]), _SAME_M)[:, None]
        across = np.abs(to_point[..., 1] * away[:, :1] - to_point[..., 0] * away[:, 1:]) / near
        along = (to_point[..., 0] * away[:, :1] + to_point[..., 1] * away[:, 1:]) / near
        sine = np.minimum(settings.radius_m / near, _TOUCHING)
        covered = (along > 0.0) & (across <= sine * distance) & (near + _SAME_M < distance)
        # the ray past the robot's top goes on to the point
        over = height + (settings.height_m - height) * distance / near
        out = np.where(covered, np.maximum(out, over), out)
    return out
