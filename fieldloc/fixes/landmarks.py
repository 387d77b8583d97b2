"""The pose from two or more identified landmarks, each with range and bearing.

Least squares over where the landmarks' middle lies in the sensor's frame, and the sensor's heading: range and bearing
are nearly linear in these, while the position in the field swings on an arc when the heading is uncertain. By scalars:
a scan has a handful of landmarks, and at that size plain floats are several times faster than small arrays.

Sources: the closed-form start is the two-dimensional case of Arun, Huang & Blostein 1987 (rigid alignment of two point
sets), weighted, in complex numbers; errors of the surveyed positions enter as in Krotkov 1989, propagated to the
observation to first order.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fieldloc.fixes.base import Fix
from fieldloc.pose import FloatArray

_MAX_ITERATIONS = 20  # two do, unless the geometry is bad
_CONVERGED = 1e-9  # squared length of the last step in its own sigmas; what is left of it is smaller still
_SIGMA_KNOWS_NOTHING_RAD = math.pi / math.sqrt(3.0)  # of a heading that could be any
_PROBE_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class LandmarkFix(Fix):
    """A fix that says how far to trust it.

    chi2: the weighted squared residuals, chi-square with 2n - 3 degrees of freedom when all is as modelled.
    chi2_each: (n,) by how much chi2 would fall if that landmark were left out, chi-square with 2 degrees of freedom
        for each from three landmarks on: the wrongly identified one stands out. With two, both have all of chi2.
    nonlinearity: how far chi2 two sigmas of heading away, to the worse side, is from the 4 that the covariance says,
        relative: 0 is a Gaussian. Landmarks close together leave a banana; from about 0.5 on the covariance should not
        be taken at its word, and the observations themselves are the better factors.
    """

    chi2: float = 0.0
    chi2_each: FloatArray = field(default_factory=lambda: np.zeros(0))
    nonlinearity: float = 0.0


class _Sight(NamedTuple):
    """One landmark: its place, from the landmarks' middle, and the covariance of it; what was seen, and that of it."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float
    range_m: float
    bearing_rad: float
    rr: float
    rb: float
    bb: float


_State = tuple[float, float, float]
"""The landmarks' middle in the sensor's frame (x, y), heading of the sensor."""
_Symmetric = tuple[float, float, float, float, float, float]
"""Upper triangle of a symmetric 3x3 matrix by rows."""


class _Equations(NamedTuple):
    """Normal equations a step = g at a state."""

    chi2: float
    log_det: float
    a: _Symmetric
    g: tuple[float, float, float]


def landmark_fix(
    positions: FloatArray,
    range_bearing: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
) -> tuple[LandmarkFix, ...]:
    """The most likely pose of the robot; empty where the landmarks do not determine it.

    positions: (n, 2) of the landmarks on the map, metres, field frame; positions_covariance: (n, 2, 2) of these.
    range_bearing: (n, 2) metres, radians, as the sensor sees them; covariance: (n, 2, 2) of these, per landmark.
    robot_from_sensor: (3,) where the sensor sits; on the robot's origin when not given.
    Empty for fewer than two landmarks, coincident ones, a range that is not positive, a value that is not finite.
    Raises ValueError for shapes that do not fit and a covariance that is not positive definite.
    """
    middle, sights = _sights(positions, range_bearing, covariance, positions_covariance)
    if len(sights) < 2:
        return ()
    found = _minimise(_rigid_alignment(sights), sights)
    if found is None:
        return ()
    state, at = found
    p = _inverse(at.a)
    if p is None or not p[5] < _SIGMA_KNOWS_NOTHING_RAD**2:
        return ()
    mount = (0.0, 0.0, 0.0) if robot_from_sensor is None else robot_from_sensor.tolist()
    pose, pose_covariance = _robot_pose(state, p, middle, mount)
    aside = [_state(_along_heading(pose, pose_covariance, k), middle, mount) for k in (-_PROBE_SIGMAS, _PROBE_SIGMAS)]
    rises = [_equations(side, sights).chi2 - at.chi2 for side in aside]
    return (
        LandmarkFix(
            pose=np.array(pose),
            covariance=np.array(pose_covariance)[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3),
            log_weight=-0.5 * (at.chi2 + at.log_det) - len(sights) * math.log(math.tau),
            solver="landmark_fix",
            chi2=at.chi2,
            chi2_each=np.array(_chi2_each(state, p, at.chi2, sights)),
            nonlinearity=max(abs(rise / _PROBE_SIGMAS**2 - 1.0) for rise in rises),
        ),
    )


def _sights(
    positions: FloatArray, range_bearing: FloatArray, covariance: FloatArray, positions_covariance: FloatArray | None
) -> tuple[complex, list[_Sight]]:
    """Checked input, and the landmarks' middle; no sights where a value is not finite or a range not positive."""
    n = len(positions)
    if positions.shape != (n, 2) or range_bearing.shape != (n, 2) or covariance.shape != (n, 2, 2):
        raise ValueError(
            f"positions {positions.shape}, range_bearing {range_bearing.shape} and covariance {covariance.shape} "
            "need shapes (n, 2), (n, 2) and (n, 2, 2)"
        )
    if positions_covariance is not None and positions_covariance.shape != (n, 2, 2):
        raise ValueError(f"positions_covariance has shape {positions_covariance.shape}, needs ({n}, 2, 2)")
    on_map = [[[0.0, 0.0], [0.0, 0.0]]] * n if positions_covariance is None else positions_covariance.tolist()
    there = positions.tolist()
    middle_x, middle_y = sum(x for x, _ in there) / max(n, 1), sum(y for _, y in there) / max(n, 1)
    sights = []
    total = 0.0
    for (x, y), ((xx, xy), (_, yy)), (r, b), ((rr, rb), (_, bb)) in zip(
        there, on_map, range_bearing.tolist(), covariance.tolist(), strict=True
    ):
        if not (rr > 0.0 and rr * bb > rb * rb):
            raise ValueError("covariance of a range and bearing is not positive definite")
        total += x + y + xx + xy + yy + r + b + rr + rb + bb
        if r > 0.0:
            sights.append(_Sight(x - middle_x, y - middle_y, xx, xy, yy, r, b, rr, rb, bb))
    if len(sights) < n or not math.isfinite(total):
        return 0j, []
    return complex(middle_x, middle_y), sights


def _rigid_alignment(sights: Sequence[_Sight]) -> _State:
    """The state that best lays the landmarks onto the points seen, each point equally certain in all directions."""
    weights = [1.0 / (s.rr + s.range_m**2 * s.bb + s.xx + s.yy) for s in sights]
    seen = [s.range_m * complex(math.cos(s.bearing_rad), math.sin(s.bearing_rad)) for s in sights]
    there = [complex(s.x, s.y) for s in sights]
    total = sum(weights)
    seen_middle = sum(w * q for w, q in zip(weights, seen, strict=True)) / total
    there_middle = sum(w * z for w, z in zip(weights, there, strict=True)) / total
    turn = sum(
        w * (z - there_middle) * (q - seen_middle).conjugate() for w, z, q in zip(weights, there, seen, strict=True)
    )
    heading = math.atan2(turn.imag, turn.real)
    centre = seen_middle - complex(math.cos(heading), -math.sin(heading)) * there_middle
    return centre.real, centre.imag, heading


def _minimise(state: _State, sights: Sequence[_Sight]) -> tuple[_State, _Equations] | None:
    """Gauss-Newton with step halving; None where it does not converge or a direction stays unknown."""
    at = _equations(state, sights)
    for _ in range(_MAX_ITERATIONS):
        p = _inverse(at.a)
        if p is None:
            return None
        g = at.g
        step = (
            p[0] * g[0] + p[1] * g[1] + p[2] * g[2],
            p[1] * g[0] + p[3] * g[1] + p[4] * g[2],
            p[2] * g[0] + p[4] * g[1] + p[5] * g[2],
        )
        decrease = step[0] * g[0] + step[1] * g[1] + step[2] * g[2]
        scale = 1.0
        while True:
            ahead = (state[0] + scale * step[0], state[1] + scale * step[1], state[2] + scale * step[2])
            at_ahead = _equations(ahead, sights)
            if decrease < _CONVERGED:
                return ahead, at_ahead
            # map errors make the weights depend on the state, so that chi2 may rise a little on the way
            if at_ahead.chi2 <= at.chi2 * 1.01 + 1e-9:
                break
            scale *= 0.5
            if scale < 1e-3:
                return None
        state, at = ahead, at_ahead
    return None


def _seen_from(state: _State, s: _Sight) -> tuple[float, float, float, float, float, float, float, float]:
    """What a state says of one landmark: range_m and bearing_rad; then u and v, the derivatives of range and bearing by
    the point (x, y) in the sensor's frame; then that point's derivative by the heading."""
    c, sine = math.cos(state[2]), math.sin(state[2])
    across_x, across_y = c * s.x + sine * s.y, c * s.y - sine * s.x
    qx, qy = state[0] + across_x, state[1] + across_y
    d = math.hypot(qx, qy) or 1e-12  # on the landmark: any direction will do
    ux, uy = qx / d, qy / d
    return d, math.atan2(qy, qx), ux, uy, -uy / d, ux / d, across_y, -across_x


def _noise(state: _State, s: _Sight, ux: float, uy: float, vx: float, vy: float) -> tuple[float, float, float]:
    """Covariance (rr, rb, bb) of the residual: the sensor's, and the map's turned into the sensor's frame."""
    if s.xx == 0.0 == s.yy:
        return s.rr, s.rb, s.bb
    c, sine = math.cos(state[2]), math.sin(state[2])
    ux, uy, vx, vy = c * ux - sine * uy, sine * ux + c * uy, c * vx - sine * vy, sine * vx + c * vy
    return (
        s.rr + ux * ux * s.xx + 2.0 * ux * uy * s.xy + uy * uy * s.yy,
        s.rb + ux * vx * s.xx + (ux * vy + uy * vx) * s.xy + uy * vy * s.yy,
        s.bb + vx * vx * s.xx + 2.0 * vx * vy * s.xy + vy * vy * s.yy,
    )


def _equations(state: _State, sights: Sequence[_Sight]) -> _Equations:
    """Sum over the landmarks of J^T W J and J^T W e, W the inverse covariance of the residual e = seen - expected."""
    chi2 = log_det = a00 = a01 = a02 = a11 = a12 = a22 = g0 = g1 = g2 = 0.0
    for s in sights:
        d, direction, ux, uy, vx, vy, tx, ty = _seen_from(state, s)
        error_range, error_bearing = s.range_m - d, math.remainder(s.bearing_rad - direction, math.tau)
        rr, rb, bb = _noise(state, s, ux, uy, vx, vy)
        det = rr * bb - rb * rb
        wrr, wrb, wbb = bb / det, -rb / det, rr / det
        # J = [[ux, uy, uh], [vx, vy, vh]]
        uh, vh = ux * tx + uy * ty, vx * tx + vy * ty
        weighted_range = wrr * error_range + wrb * error_bearing
        weighted_bearing = wrb * error_range + wbb * error_bearing
        chi2 += error_range * weighted_range + error_bearing * weighted_bearing
        log_det += math.log(det)
        wu_x, wv_x = wrr * ux + wrb * vx, wrb * ux + wbb * vx
        wu_y, wv_y = wrr * uy + wrb * vy, wrb * uy + wbb * vy
        a00 += ux * wu_x + vx * wv_x
        a01 += uy * wu_x + vy * wv_x
        a02 += uh * wu_x + vh * wv_x
        a11 += uy * wu_y + vy * wv_y
        a12 += uh * wu_y + vh * wv_y
        a22 += uh * (wrr * uh + wrb * vh) + vh * (wrb * uh + wbb * vh)
        g0 += ux * weighted_range + vx * weighted_bearing
        g1 += uy * weighted_range + vy * weighted_bearing
        g2 += uh * weighted_range + vh * weighted_bearing
    return _Equations(chi2, log_det, (a00, a01, a02, a11, a12, a22), (g0, g1, g2))


def _inverse(a: _Symmetric) -> _Symmetric | None:
    """None where the matrix is singular to rounding."""
    a00, a01, a02, a11, a12, a22 = a
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c00 + a01 * c01 + a02 * c02
    if not det > 1e-13 * a00 * a11 * a22:
        return None
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    return c00 / det, c01 / det, c02 / det, c11 / det, c12 / det, c22 / det


def _chi2_each(state: _State, p: _Symmetric, chi2: float, sights: Sequence[_Sight]) -> list[float]:
    """e^T (S - J P J^T)^-1 e per landmark: to first order what chi2 loses without it."""
    if len(sights) == 2:
        return [chi2, chi2]
    p00, p01, p02, p11, p12, p22 = p
    out = []
    for s in sights:
        d, direction, ux, uy, vx, vy, tx, ty = _seen_from(state, s)
        error_range, error_bearing = s.range_m - d, math.remainder(s.bearing_rad - direction, math.tau)
        rr, rb, bb = _noise(state, s, ux, uy, vx, vy)
        uh, vh = ux * tx + uy * ty, vx * tx + vy * ty
        pu = (p00 * ux + p01 * uy + p02 * uh, p01 * ux + p11 * uy + p12 * uh, p02 * ux + p12 * uy + p22 * uh)
        pv = (p00 * vx + p01 * vy + p02 * vh, p01 * vx + p11 * vy + p12 * vh, p02 * vx + p12 * vy + p22 * vh)
        left_rr = rr - (ux * pu[0] + uy * pu[1] + uh * pu[2])
        left_rb = rb - (vx * pu[0] + vy * pu[1] + vh * pu[2])
        left_bb = bb - (vx * pv[0] + vy * pv[1] + vh * pv[2])
        det = left_rr * left_bb - left_rb * left_rb
        if det > 1e-9 * rr * bb:
            cross = error_range * error_bearing
            out.append((left_bb * error_range**2 - 2.0 * left_rb * cross + left_rr * error_bearing**2) / det)
        else:  # the others do not determine the pose
            out.append(chi2)
    return out


def _robot_pose(state: _State, p: _Symmetric, middle: complex, mount: Sequence[float]) -> tuple[_State, _Symmetric]:
    """Pose and covariance, field axes, of the robot that carries the sensor at `mount`.

    robot = middle - arm, arm = R(robot's heading) mount + R(sensor's heading) state: both swing with the heading.
    """
    heading = math.remainder(state[2] - mount[2], math.tau)
    c, s = math.cos(state[2]), math.sin(state[2])
    robot_c, robot_s = math.cos(heading), math.sin(heading)
    arm_x = c * state[0] - s * state[1] + robot_c * mount[0] - robot_s * mount[1]
    arm_y = s * state[0] + c * state[1] + robot_s * mount[0] + robot_c * mount[1]
    p00, p01, p02, p11, p12, p22 = p
    # the state's covariance turned into field axes, with the sign of -R
    xx = c * c * p00 - 2.0 * c * s * p01 + s * s * p11
    xy = c * s * (p00 - p11) + (c * c - s * s) * p01
    yy = s * s * p00 + 2.0 * c * s * p01 + c * c * p11
    xh, yh = -(c * p02 - s * p12), -(s * p02 + c * p12)
    # d robot / d heading = (arm_y, -arm_x)
    covariance = (
        xx + 2.0 * arm_y * xh + arm_y * arm_y * p22,
        xy - arm_x * xh + arm_y * yh - arm_x * arm_y * p22,
        xh + arm_y * p22,
        yy - 2.0 * arm_x * yh + arm_x * arm_x * p22,
        yh - arm_x * p22,
        p22,
    )
    return (middle.real - arm_x, middle.imag - arm_y, heading), covariance


def _state(pose: _State, middle: complex, mount: Sequence[float]) -> _State:
    """The inverse of `_robot_pose`."""
    heading = pose[2] + mount[2]
    in_robot = (middle - complex(pose[0], pose[1])) * complex(math.cos(pose[2]), -math.sin(pose[2]))
    in_sensor = (in_robot - complex(mount[0], mount[1])) * complex(math.cos(mount[2]), -math.sin(mount[2]))
    return in_sensor.real, in_sensor.imag, heading


def _along_heading(pose: _State, covariance: _Symmetric, sigmas: float) -> _State:
    """The likeliest pose whose heading is that many sigmas off."""
    step = sigmas / math.sqrt(covariance[5])
    return pose[0] + step * covariance[2], pose[1] + step * covariance[4], pose[2] + step * covariance[5]
