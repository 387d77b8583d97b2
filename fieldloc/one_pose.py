"""One pose at a time, a hundred times a second: what fieldloc.pose does for stacks, without their overhead."""

import math

import numpy as np

from fieldloc.pose import FloatArray

_SMALL_ANGLE_RAD = 1e-4


def bend(turn: float) -> tuple[float, float, float, float]:
    """Of an arc: its end is (a forward - b left, b forward + a left), its right Jacobian se2.right_jacobian's
    [[a, b, p forward - q left], [-b, a, q forward + p left], [0, 0, 1]]."""
    if abs(turn) < _SMALL_ANGLE_RAD:
        return 1.0 - turn * turn / 6.0, 0.5 * turn, turn / 6.0, 0.5
    a, b = math.sin(turn) / turn, 2.0 * math.sin(0.5 * turn) ** 2 / turn
    return a, b, (1.0 - a) / turn, b / turn


def arc(forward: float, left: float, turn: float) -> tuple[float, float, float]:
    """As se2.exp."""
    a, b, _, _ = bend(turn)
    return a * forward - b * left, b * forward + a * left, wrapped(turn)


def spread(forward: float, left: float, turn: float) -> FloatArray:
    """As se2.right_jacobian."""
    a, b, p, q = bend(turn)
    return np.array([[a, b, p * forward - q * left], [-b, a, q * forward + p * left], [0.0, 0.0, 1.0]])


def composed(one: FloatArray, other: FloatArray) -> FloatArray:
    """As se2.compose."""
    x, y, heading = one.tolist()
    forward, left, turn = other.tolist()
    c, s = math.cos(heading), math.sin(heading)
    return np.array([x + c * forward - s * left, y + s * forward + c * left, wrapped(heading + turn)])


def retracted(pose: FloatArray, tangent: FloatArray) -> FloatArray:
    """As se2.retract."""
    return composed(pose, np.array(arc(*tangent.tolist())))


def after(motion: FloatArray) -> FloatArray:
    """The adjoint of its inverse (3, 3): a robot-frame tangent before it, as one after it."""
    x, y, heading = motion.tolist()
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0.0, 0.0, 1.0]])


def turned(covariance: FloatArray, heading_rad: float) -> FloatArray:
    """As se2.rotate_covariance."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ covariance @ turn.T)


def wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % math.tau - math.pi
