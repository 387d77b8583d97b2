"""Where a ray meets the image plane at unit focal length, and back: the formulas of OpenCV's two lens models.

pinhole: coefficients k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 (or fewer) on the plane z = 1, with q = x^2 + y^2:
    R = (1 + k1 q + k2 q^2 + k3 q^3) / (1 + k4 q + k5 q^2 + k6 q^3)
    x' = x R + 2 p1 x y + p2 (q + 2 x^2) + s1 q + s2 q^2
    y' = y R + p1 (q + 2 y^2) + 2 p2 x y + s3 q + s4 q^2
fisheye: k1, k2, k3, k4 on the angle t from the optical axis: |(x', y')| = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).

A polynomial turns back somewhere; beyond that radius it has no inverse. Both functions answer with mask False there.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

Model = Literal["pinhole", "fisheye"]
Mask = NDArray[np.bool_]
Distortion = tuple[float, ...]

_ITERATIONS = 60  # a bisection alone ends within them; Newton takes about six
_FAR = 1e6  # tangent of the widest angle a pinhole is asked for
_LAST_STEP = 1e-9  # Newton doubles the digits: what is left after such a step is below rounding
_ON_AXIS = 1e-150  # nearer to the axis numbers lose their digits
_SAME = 1e-10  # a solution that does not project back to its point within this is none


def project(model: Model, distortion: Distortion, rays: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    """Plane points (..., 2) of rays (..., 3) of any length, their Jacobians (..., 2, 3), and where they exist."""
    with np.errstate(all="ignore"):  # rays without an image end as NaN and False
        plane, jacobian, mask = (_project_pinhole if model == "pinhole" else _project_fisheye)(distortion, rays)
    mask = mask & np.isfinite(plane).all(axis=-1) & np.isfinite(jacobian).all(axis=(-1, -2))
    return np.where(mask[..., None], plane, np.nan), np.where(mask[..., None, None], jacobian, np.nan), mask


def unproject(model: Model, distortion: Distortion, plane: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    """Unit rays (..., 3) of plane points (..., 2), to machine precision, Jacobians (..., 3, 2), where they exist."""
    with np.errstate(all="ignore"):
        rays, jacobian, mask = (_unproject_pinhole if model == "pinhole" else _unproject_fisheye)(distortion, plane)
    mask = mask & np.isfinite(rays).all(axis=-1) & np.isfinite(jacobian).all(axis=(-1, -2))
    if mask.all():
        return rays, jacobian, mask
    return np.where(mask[..., None], rays, np.nan), np.where(mask[..., None, None], jacobian, np.nan), mask


def _project_pinhole(distortion: Distortion, rays: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    z = rays[..., 2]
    ideal = rays[..., :2] / z[..., None]
    plane, to_ideal = _distort(distortion, ideal)
    ideal_to_ray = np.zeros((*z.shape, 2, 3))
    ideal_to_ray[..., 0, 0] = ideal_to_ray[..., 1, 1] = 1.0 / z
    ideal_to_ray[..., 2] = -ideal / z[..., None]
    inside = np.hypot(ideal[..., 0], ideal[..., 1]) < _pinhole_limit(distortion)
    return plane, to_ideal @ ideal_to_ray, (z > 0) & inside & (_determinant(to_ideal) > 0)


def _unproject_pinhole(distortion: Distortion, plane: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    ideal = plane
    mask = np.asarray(np.isfinite(plane).all(axis=-1))
    jacobian = None
    if any(distortion):
        limit = _pinhole_limit(distortion)
        radius = np.hypot(plane[..., 0], plane[..., 1])
        undistorted = _invert(lambda r: _radial(distortion, r), radius, limit)
        ideal = plane * np.where(radius > _ON_AXIS, undistorted / radius, 1.0)[..., None]
        for _ in range(_ITERATIONS):
            value, jacobian = _distort(distortion, ideal)
            step = _solve(jacobian, value - plane)
            ideal = ideal - step
            if not np.any(np.abs(step) > _LAST_STEP * (1.0 + np.abs(ideal))):
                break
        value, jacobian = _distort(distortion, ideal)
        mask = mask & (np.abs(value - plane).max(axis=-1) < _SAME) & (_determinant(jacobian) > 0)
        mask = mask & (np.hypot(ideal[..., 0], ideal[..., 1]) < limit)
    rays = np.empty((*ideal.shape[:-1], 3))
    rays[..., 2] = 1.0 / np.sqrt(1.0 + ideal[..., 0] ** 2 + ideal[..., 1] ** 2)
    rays[..., :2] = ideal * rays[..., 2:]
    # a unit ray moves at right angles to itself
    to_ideal = -rays[..., :, None] * rays[..., None, :2]
    to_ideal[..., 0, 0] += 1.0
    to_ideal[..., 1, 1] += 1.0
    to_ideal *= rays[..., 2, None, None]
    return rays, to_ideal if jacobian is None else to_ideal @ _inverse(jacobian), mask


def _project_fisheye(distortion: Distortion, rays: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    xy, z = rays[..., :2], rays[..., 2]
    side = np.hypot(xy[..., 0], xy[..., 1])
    angle = np.arctan2(side, z)
    radius, slope = _fisheye_radius(distortion, angle)
    on_axis = side < _ON_AXIS
    scale = np.where(on_axis, 1.0 / z, radius / side)
    outward = xy / np.where(on_axis, 1.0, side)[..., None]
    length2 = side**2 + z**2
    jacobian = np.zeros((*z.shape, 2, 3))
    jacobian[..., :2] = scale[..., None, None] * np.eye(2)
    bend = slope * z / length2 - scale
    jacobian[..., :2] += bend[..., None, None] * outward[..., :, None] * outward[..., None, :]
    jacobian[..., 2] = -(slope * side / length2)[..., None] * outward
    return scale[..., None] * xy, jacobian, np.asarray(angle < _fisheye_limit(distortion))


def _unproject_fisheye(distortion: Distortion, plane: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    radius = np.hypot(plane[..., 0], plane[..., 1])
    limit = _fisheye_limit(distortion)
    angle = _invert(lambda t: _fisheye_radius(distortion, t), radius, limit)
    again, slope = _fisheye_radius(distortion, angle)
    mask = (np.abs(again - radius) < _SAME) & (angle < limit)
    on_axis = radius <= _ON_AXIS
    outward = plane / np.where(on_axis, 1.0, radius)[..., None]
    c, s = np.cos(angle), np.sin(angle)
    rays = np.concatenate([s[..., None] * outward, c[..., None]], axis=-1)
    # outwards the ray turns as the angle grows, sidewards it turns about the axis
    sideward = np.where(on_axis, 1.0, s / radius)
    jacobian = np.empty((*radius.shape, 3, 2))
    jacobian[..., :2, :] = (c / slope - sideward)[..., None, None] * outward[..., :, None] * outward[..., None, :]
    jacobian[..., 0, 0] += sideward
    jacobian[..., 1, 1] += sideward
    jacobian[..., 2, :] = -(s / slope)[..., None] * outward
    return rays, jacobian, mask


def _distort(distortion: Distortion, ideal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The pinhole formulas above and their Jacobian (..., 2, 2)."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _padded(distortion)
    x, y = ideal[..., 0], ideal[..., 1]
    q = x * x + y * y
    top, bottom = 1 + q * (k1 + q * (k2 + q * k3)), 1 + q * (k4 + q * (k5 + q * k6))
    ratio = top / bottom
    ratio_q = (k1 + q * (2 * k2 + q * 3 * k3) - ratio * (k4 + q * (2 * k5 + q * 3 * k6))) / bottom
    plane = np.stack(
        [
            x * ratio + 2 * p1 * x * y + p2 * (q + 2 * x * x) + q * (s1 + q * s2),
            y * ratio + p1 * (q + 2 * y * y) + 2 * p2 * x * y + q * (s3 + q * s4),
        ],
        axis=-1,
    )
    prism_x, prism_y = 2 * (s1 + 2 * q * s2), 2 * (s3 + 2 * q * s4)
    jacobian = np.empty((*q.shape, 2, 2))
    jacobian[..., 0, 0] = ratio + 2 * x * x * ratio_q + 2 * p1 * y + 6 * p2 * x + prism_x * x
    jacobian[..., 0, 1] = 2 * x * y * ratio_q + 2 * p1 * x + 2 * p2 * y + prism_x * y
    jacobian[..., 1, 0] = 2 * x * y * ratio_q + 2 * p1 * x + 2 * p2 * y + prism_y * x
    jacobian[..., 1, 1] = ratio + 2 * y * y * ratio_q + 6 * p1 * y + 2 * p2 * x + prism_y * y
    return plane, jacobian


def _radial(distortion: Distortion, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radius after the pinhole's radial part alone, and its slope."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(distortion)[:8]
    q = radius * radius
    top, bottom = 1 + q * (k1 + q * (k2 + q * k3)), 1 + q * (k4 + q * (k5 + q * k6))
    ratio = top / bottom
    ratio_q = (k1 + q * (2 * k2 + q * 3 * k3) - ratio * (k4 + q * (2 * k5 + q * 3 * k6))) / bottom
    return radius * ratio, ratio + 2 * q * ratio_q


def _fisheye_radius(distortion: Distortion, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radius on the plane of an angle from the optical axis, and its slope."""
    k1, k2, k3, k4 = distortion or (0.0, 0.0, 0.0, 0.0)
    q = angle * angle
    radius = angle * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    return radius, 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))


def _invert(
    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]], target: FloatArray, limit: float
) -> FloatArray:
    """Where an increasing function with slope reaches the targets within [0, limit]: Newton held inside a bracket."""
    low, high = np.zeros_like(target), np.full_like(target, limit)
    x = np.minimum(target, 0.5 * limit)
    for _ in range(_ITERATIONS):
        value, slope = function(x)
        low, high = np.where(value <= target, x, low), np.where(value >= target, x, high)
        newton = x - (value - target) / slope
        following = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        done = not np.any(np.abs(following - x) > _LAST_STEP * (1.0 + x))
        x = following
        if done:
            break
    return x


@lru_cache(maxsize=64)
def _padded(distortion: Distortion) -> Distortion:
    return (*distortion, *(0.0,) * (12 - len(distortion)))[:12]


@lru_cache(maxsize=64)
def _pinhole_limit(distortion: Distortion) -> float:
    """Radius on the ideal plane at which the radial part stops growing or has its pole."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(distortion)[:8]
    top, bottom = np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])
    slope = top * bottom + np.polynomial.Polynomial([0, 2]) * (top.deriv() * bottom - top * bottom.deriv())
    return min(math.sqrt(_first_root(slope)), math.sqrt(_first_root(bottom)), _FAR)


@lru_cache(maxsize=64)
def _fisheye_limit(distortion: Distortion) -> float:
    """Angle at which the image's radius stops growing; straight behind at the latest."""
    k1, k2, k3, k4 = distortion or (0.0, 0.0, 0.0, 0.0)
    slope = np.polynomial.Polynomial([1, 3 * k1, 5 * k2, 7 * k3, 9 * k4])
    return min(math.sqrt(_first_root(slope)), math.pi)


def _first_root(polynomial: np.polynomial.Polynomial) -> float:
    """The smallest positive real root, infinity where there is none."""
    roots = polynomial.trim().roots()
    real = roots[np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))].real
    return min((float(root) for root in real if root > 0), default=np.inf)


def _determinant(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0])


def _inverse(matrix: FloatArray) -> FloatArray:
    """Of (..., 2, 2)."""
    out = np.empty_like(matrix)
    out[..., 0, 0], out[..., 1, 1] = matrix[..., 1, 1], matrix[..., 0, 0]
    out[..., 0, 1], out[..., 1, 0] = -matrix[..., 0, 1], -matrix[..., 1, 0]
    return np.asarray(out / _determinant(matrix)[..., None, None])


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """2x2 systems by Cramer's rule: a singular one among many gives its own infinity, not an exception for all."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    x, y = right[..., 0], right[..., 1]
    return np.asarray(np.stack([d * x - b * y, a * y - c * x], axis=-1) / _determinant(matrix)[..., None])
