"""Two goal posts and what a robot sees of them: shared by the tests of the post solvers."""

import numpy as np

from fieldloc.pose import FloatArray, wrap

GOAL = np.array([[4.5, 1.3], [4.5, -1.3]])
OWN_GOAL = np.array([[-4.5, 1.3], [-4.5, -1.3]])
RADIUS_M = 0.05


def view(poses: FloatArray, posts: FloatArray = GOAL) -> FloatArray:
    """(bearing 1, bearing 2, size 1, size 2) (..., 4) seen from poses (..., 3), size = radius / distance."""
    to_posts = posts - poses[..., None, :2]
    bearings = wrap(np.arctan2(to_posts[..., 1], to_posts[..., 0]) - poses[..., 2:])
    return np.concatenate([bearings, RADIUS_M / np.hypot(to_posts[..., 0], to_posts[..., 1])], axis=-1)


def pose_error(found: FloatArray, truth: FloatArray) -> FloatArray:
    error = found - truth
    error[..., 2] = wrap(error[..., 2])
    return error


def edge_noise(focal_px: float, sigma_px: float) -> FloatArray:
    """(4, 4): what independent noise of every edge does to bearings and half-widths."""
    return np.eye(4) * (sigma_px / focal_px) ** 2 / 2


def poses_in_front_of_the_goal(
    rng: np.random.Generator, number: int, nearest_m: float, farthest_m: float
) -> FloatArray:
    direction = rng.uniform(np.pi / 2 + 0.25, 3 * np.pi / 2 - 0.25, number)
    distance = rng.uniform(nearest_m, farthest_m, number)
    place = GOAL.mean(axis=0) + distance[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    return np.concatenate([place, rng.uniform(-np.pi, np.pi, (number, 1))], axis=-1)
