"""SE(2): poses (..., 3) = [x_m, y_m, heading_rad] of one frame in another, one or a stack of them.

`field_from_robot` maps robot coordinates to field coordinates: `apply(field_from_robot, point_in_robot)`.
The tangent is ordered (x, y, heading) and acts on the right: `retract(pose, delta) = compose(pose, exp(delta))`, so a
tangent covariance is expressed in the robot frame, as in gtsam.Pose2. Records that leave a function carry the
covariance of (x, y, heading) in field axes instead; `rotate_covariance` goes from one to the other.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_SMALL_ANGLE_RAD = 1e-4  # below it the series beat the closed form: the next term is under 1e-17


def wrap(angle_rad: FloatArray | float) -> FloatArray:
    """Angle in [-pi, pi), any shape."""
    return np.asarray((np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi)


def rotation(heading_rad: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 2, 2) that turn vectors counter-clockwise by the heading (...)."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    out = np.empty((*np.shape(c), 2, 2))
    out[..., 0, 0] = out[..., 1, 1] = c
    out[..., 0, 1], out[..., 1, 0] = -s, s
    return out


def rotation3(heading_rad: FloatArray | float) -> FloatArray:
    """(..., 3, 3): rotation of (x, y), identity on the heading. Takes robot-frame tangents to field axes."""
    heading = np.asarray(heading_rad)
    out = np.zeros((*heading.shape, 3, 3))
    out[..., :2, :2] = rotation(heading)
    out[..., 2, 2] = 1.0
    return out


def rotate_covariance(covariance: FloatArray, heading_rad: FloatArray | float) -> FloatArray:
    """Covariance (..., 3, 3) of a pose with its axes turned by the heading.

    `rotate_covariance(P_robot, heading)` is in field axes, `rotate_covariance(P_field, -heading)` in robot axes.
    """
    r = rotation3(heading_rad)
    return np.asarray(r @ covariance @ np.swapaxes(r, -1, -2))


def apply(a_from_b: FloatArray, points_in_b: FloatArray) -> FloatArray:
    """Points (..., 2) of frame b in frame a; poses (..., 3) and points broadcast."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = points_in_b[..., 0], points_in_b[..., 1]
    return _joined(a_from_b[..., 0] + c * x - s * y, a_from_b[..., 1] + s * x + c * y)


def compose(a_from_b: FloatArray, b_from_c: FloatArray) -> FloatArray:
    """a_from_c (..., 3), heading wrapped; stacks broadcast."""
    heading = a_from_b[..., 2]
    c, s = np.cos(heading), np.sin(heading)
    x, y = b_from_c[..., 0], b_from_c[..., 1]
    turned = wrap(heading + b_from_c[..., 2])
    return _joined(a_from_b[..., 0] + c * x - s * y, a_from_b[..., 1] + s * x + c * y, turned)


def inverse(a_from_b: FloatArray) -> FloatArray:
    """b_from_a (..., 3)."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = a_from_b[..., 0], a_from_b[..., 1]
    return _joined(-c * x - s * y, s * x - c * y, wrap(-a_from_b[..., 2]))


def between(a_from_b: FloatArray, a_from_c: FloatArray) -> FloatArray:
    """b_from_c (..., 3): the motion from b to c, seen from b."""
    heading = a_from_b[..., 2]
    c, s = np.cos(heading), np.sin(heading)
    x, y = a_from_c[..., 0] - a_from_b[..., 0], a_from_c[..., 1] - a_from_b[..., 1]
    return _joined(c * x + s * y, c * y - s * x, wrap(a_from_c[..., 2] - heading))


def exp(tangent: FloatArray) -> FloatArray:
    """Pose (..., 3) reached by moving along the twist (..., 3) = (x, y, heading) for unit time: an arc of a circle."""
    forward, left, turn = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    half = 0.5 * turn
    chord = _chord(half)
    a, b = chord * np.cos(half), chord * np.sin(half)
    return _joined(a * forward - b * left, b * forward + a * left, wrap(turn))


def log(pose: FloatArray) -> FloatArray:
    """Twist (..., 3) whose exp is the pose; the heading in [-pi, pi)."""
    x, y, turn = pose[..., 0], pose[..., 1], wrap(pose[..., 2])
    half = 0.5 * turn
    along = np.cos(half) / _chord(half)
    return _joined(along * x + half * y, along * y - half * x, turn)


def retract(pose: FloatArray, tangent: FloatArray) -> FloatArray:
    """The pose (..., 3) moved by a robot-frame tangent (..., 3)."""
    return compose(pose, exp(tangent))


def local(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Robot-frame tangent (..., 3) from `pose` to `other`: retract(pose, local(pose, other)) == other."""
    return log(between(pose, other))


def adjoint(pose: FloatArray) -> FloatArray:
    """(..., 3, 3): compose(pose, exp(t)) == compose(exp(adjoint(pose) @ t), pose)."""
    out = rotation3(pose[..., 2])
    out[..., 0, 2] = pose[..., 1]
    out[..., 1, 2] = -pose[..., 0]
    return out


def right_jacobian(tangent: FloatArray) -> FloatArray:
    """(..., 3, 3): exp(t + d) == compose(exp(t), exp(right_jacobian(t) @ d)) to first order in d."""
    forward, left, turn = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    half = 0.5 * turn
    chord = _chord(half)
    a, b = chord * np.cos(half), chord * np.sin(half)
    p = _over(1.0 - a, turn, 1.0 / 6.0)
    q = 0.5 * chord * chord  # b / turn
    return _affine(a, b, p * forward - q * left, q * forward + p * left)


def right_jacobian_inverse(tangent: FloatArray) -> FloatArray:
    """(..., 3, 3): log(compose(exp(t), exp(d))) == t + right_jacobian_inverse(t) @ d to first order in d.

    With the plane as complex numbers the right Jacobian is v' = a - ib on it and (1 - v') / turn times the twist beside
    it; so its inverse is 1 / v' and (1 - 1 / v') / turn times the twist.
    """
    forward, left, turn = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    half = 0.5 * turn
    along = np.cos(half) / _chord(half)
    r = _over(1.0 - along, turn, 1.0 / 12.0)
    return _affine(along, -half, r * forward + 0.5 * left, r * left - 0.5 * forward)


def _chord(half: FloatArray) -> FloatArray:
    """sin(h) / h, how long the chord of an arc of 2 h is beside the arc. With it, regular at zero and without loss of
    digits: sin(2h) / 2h = chord cos(h), (1 - cos(2h)) / 2h = chord sin(h)."""
    safe = np.where(half == 0.0, 1e-300, half)
    return np.asarray(np.sin(safe) / safe)


def _over(difference: FloatArray, angle: FloatArray, slope: float) -> FloatArray:
    """difference / angle, of which the series begins with slope * angle: that is taken where digits cancel."""
    small = np.abs(angle) < _SMALL_ANGLE_RAD
    return np.where(small, slope * angle, difference / np.where(small, 1.0, angle))


def _affine(a: FloatArray, b: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """(..., 3, 3) of [[a, b, x], [-b, a, y], [0, 0, 1]]."""
    out = np.zeros((*x.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = a
    out[..., 0, 1], out[..., 1, 0] = b, -b
    out[..., 0, 2], out[..., 1, 2] = x, y
    out[..., 2, 2] = 1.0
    return out


def _joined(*parts: FloatArray) -> FloatArray:
    """(..., k) of k parts, the first of which has the shape (...) of all. For one pose half the cost of np.stack."""
    out = np.empty((*np.shape(parts[0]), len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out
