"""Rotations as quaternions (x, y, z, w) and rigid motions, in plain floats: one at a time, numpy costs ten times that.

A rigid motion a_from_b is its translation and its rotation: p_in_a = rotate(rotation, p_in_b) + translation.
"""

from math import acos, atan2, sin, sqrt
from typing import NamedTuple

import numpy as np

from fieldloc.pose import FloatArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

NO_ROTATION: Quaternion = (0.0, 0.0, 0.0, 1.0)
_SHORTEST = 1e-3  # a quaternion below this length is a message that nobody filled in
_FARTHEST_M = 1e9  # a position beyond it is no position
_NEARLY_EQUAL = 0.9995  # cosine above which a straight line between quaternions is as good as the arc


class Motion(NamedTuple):
    """a_from_b."""

    translation: Vector
    rotation: Quaternion


STILL = Motion((0.0, 0.0, 0.0), NO_ROTATION)


def motion(translation: FloatArray, rotation: FloatArray) -> Motion | None:
    """Of a message's translation (3,) and rotation (4,), normalised; None where they are none: NaN, length zero."""
    tx, ty, tz = translation.tolist()
    x, y, z, w = rotation.tolist()
    length = sqrt(x * x + y * y + z * z + w * w)
    if not (abs(tx) + abs(ty) + abs(tz) < _FARTHEST_M and _SHORTEST < length < 1.0 / _SHORTEST):  # False for NaN too
        return None
    return Motion((tx, ty, tz), (x / length, y / length, z / length, w / length))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(q: Quaternion, v: Vector) -> Vector:
    x, y, z, w = q
    vx, vy, vz = v
    # v + 2 w (u x v) + 2 u x (u x v) with u = (x, y, z)
    cx, cy, cz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * cx + y * cz - z * cy,
        vy + w * cy + z * cx - x * cz,
        vz + w * cz + x * cy - y * cx,
    )


def compose(a_from_b: Motion, b_from_c: Motion) -> Motion:
    """a_from_c."""
    x, y, z = rotate(a_from_b.rotation, b_from_c.translation)
    tx, ty, tz = a_from_b.translation
    return Motion((x + tx, y + ty, z + tz), multiply(a_from_b.rotation, b_from_c.rotation))


def inverse(a_from_b: Motion) -> Motion:
    """b_from_a."""
    x, y, z, w = a_from_b.rotation
    back = (-x, -y, -z, w)
    tx, ty, tz = rotate(back, a_from_b.translation)
    return Motion((-tx, -ty, -tz), back)


def between(a: Motion, b: Motion, share: float) -> Motion:
    """On the way from a (share 0) to b (share 1): straight for the position, at constant turning rate (slerp)."""
    (ax, ay, az), (bx, by, bz) = a.translation, b.translation
    translation = (ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az))
    return Motion(translation, _slerp(a.rotation, b.rotation, share))


def matrix(q: Quaternion) -> FloatArray:
    """(3, 3)"""
    columns = [rotate(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return np.array(columns).T


def heading(q: Quaternion) -> float:
    """Of the turned x axis, seen from above."""
    x, y, z, w = q
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def on_the_ground(m: Motion) -> FloatArray:
    """The pose (3,) = x, y, heading that is left of it seen from above."""
    return np.array([m.translation[0], m.translation[1], heading(m.rotation)])


def _slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = -1.0 if cosine < 0.0 else 1.0  # q and -q are the same rotation: the shorter way
    cosine = abs(cosine)
    if cosine > _NEARLY_EQUAL:
        to_a, to_b = 1.0 - share, sign * share
    else:
        angle = acos(cosine)
        to_a, to_b = sin((1.0 - share) * angle) / sin(angle), sign * sin(share * angle) / sin(angle)
    x, y, z, w = (to_a * p + to_b * q for p, q in zip(a, b, strict=True))
    length = sqrt(x * x + y * y + z * z + w * w)
    return (x / length, y / length, z / length, w / length)
