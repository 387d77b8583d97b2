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
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = b_from_c[..., 0], b_from_c[..., 1]
    heading = wrap(a_from_b[..., 2] + b_from_c[..., 2])
    return _joined(a_from_b[..., 0] + c * x - s * y, a_from_b[..., 1] + s * x + c * y, heading)


def inverse(a_from_b: FloatArray) -> FloatArray:
    """b_from_a (..., 3)."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = a_from_b[..., 0], a_from_b[..., 1]
    return _joined(-c * x - s * y, s * x - c * y, wrap(-a_from_b[..., 2]))


def between(a_from_b: FloatArray, a_from_c: FloatArray) -> FloatArray:
    """b_from_c (..., 3): the motion from b to c, seen from b."""
    return compose(inverse(a_from_b), a_from_c)


def exp(tangent: FloatArray) -> FloatArray:
    """Pose (..., 3) reached by moving along the twist (..., 3) = (x, y, heading) for unit time: an arc of a circle."""
    angle = tangent[..., 2]
    a, b = _arc_coefficients(angle)
    x = a * tangent[..., 0] - b * tangent[..., 1]
    y = b * tangent[..., 0] + a * tangent[..., 1]
    return _joined(x, y, wrap(angle))


def log(pose: FloatArray) -> FloatArray:
    """Twist (..., 3) whose exp is the pose; the heading in [-pi, pi)."""
    angle = wrap(pose[..., 2])
    a, b = _arc_coefficients(angle)
    scale = 1.0 / (a * a + b * b)
    x = (a * pose[..., 0] + b * pose[..., 1]) * scale
    y = (-b * pose[..., 0] + a * pose[..., 1]) * scale
    return _joined(x, y, angle)


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
    angle = np.asarray(tangent[..., 2])
    a, b = _arc_coefficients(angle)
    small = np.abs(angle) < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    # (1 - a) / angle and b / angle
    p = np.where(small, angle / 6.0, (1.0 - a) / safe)
    q = np.where(small, 0.5, b / safe)
    out = np.zeros((*angle.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = a
    out[..., 0, 1] = b
    out[..., 1, 0] = -b
    out[..., 0, 2] = p * tangent[..., 0] - q * tangent[..., 1]
    out[..., 1, 2] = q * tangent[..., 0] + p * tangent[..., 1]
    out[..., 2, 2] = 1.0
    return out


def right_jacobian_inverse(tangent: FloatArray) -> FloatArray:
    """(..., 3, 3): log(compose(exp(t), exp(d))) == t + right_jacobian_inverse(t) @ d to first order in d."""
    return np.asarray(np.linalg.inv(right_jacobian(tangent)))


def _arc_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(a) / a and (1 - cos(a)) / a, regular at zero."""
    small = np.abs(angle) < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    # 2 sin^2(a/2) instead of 1 - cos(a): no cancellation
    b = np.where(small, angle / 2.0, 2.0 * np.sin(safe / 2.0) ** 2 / safe)
    return np.asarray(a), np.asarray(b)


def _joined(*parts: FloatArray) -> FloatArray:
    """The parts (...), which broadcast, side by side (..., k). For one pose half the cost of np.stack."""
    out = np.empty((*np.broadcast(*parts).shape, len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out
