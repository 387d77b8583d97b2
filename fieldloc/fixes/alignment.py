"""Range and bearing to identified landmarks as least squares, by scalars.

The unknowns are where the landmarks' middle lies in the sensor's frame, and the sensor's heading: range and bearing are
nearly linear in these, while the position in the field swings on an arc when the heading is uncertain. A scan has a
handful of landmarks, and at that size plain floats are several times faster than small arrays.

Sources: the closed-form start is the two-dimensional case of Arun, Huang & Blostein 1987 (rigid alignment of two point
sets), weighted, in complex numbers; errors of the surveyed positions enter as in Krotkov 1989, propagated to the
observation to first order.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

_MAX_ITERATIONS = 20  # two do, unless the geometry is bad
_ON_IT_M = 1e-12  # on the landmark any direction will do
_CONVERGED = 1e-9  # squared length of the last step in its own sigmas; what is left of it is smaller still


class Sight(NamedTuple):
    """One landmark: its place, from the landmarks' middle, and the covariance of it; what was seen, and that of it; and
    by how much its range is too long where all of them are together, one standard deviation of that."""

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
    longer: float = 0.0


State = tuple[float, float, float]
"""The landmarks' middle in the sensor's frame (x, y), heading of the sensor."""
Symmetric = tuple[float, float, float, float, float, float]
"""Upper triangle of a symmetric 3x3 matrix by rows."""


class Shared(NamedTuple):
    """By how many standard deviations all ranges are likeliest too long, the variance of that at the state, and by how
    much it falls with a step of it."""

    value: float
    variance: float
    by_state: tuple[float, float, float]


class Equations(NamedTuple):
    """Normal equations a step = g at a state; what ranges share is at its likeliest there, and free in `a`."""

    chi2: float
    log_det: float
    a: Symmetric
    g: tuple[float, float, float]
    shared: Shared


def rigid_alignment(sights: Sequence[Sight]) -> State:
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


def minimise(state: State, sights: Sequence[Sight]) -> tuple[State, Equations] | None:
    """Gauss-Newton with step halving; None where it does not converge or a direction stays unknown."""
    at = equations(state, sights)
    for _ in range(_MAX_ITERATIONS):
        p = inverse(at.a)
        if p is None:
            return None
        g = at.g
        step = (
            p[0] * g[0] + p[1] * g[1] + p[2] * g[2],
            p[1] * g[0] + p[3] * g[1] + p[4] * g[2],
            p[2] * g[0] + p[4] * g[1] + p[5] * g[2],
        )
        decrease = step[0] * g[0] + step[1] * g[1] + step[2] * g[2]
        if not math.isfinite(step[0] + step[1] + step[2] + decrease):
            return None
        scale = 1.0
        while True:
            ahead = (state[0] + scale * step[0], state[1] + scale * step[1], state[2] + scale * step[2])
            at_ahead = equations(ahead, sights)
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


def equations(state: State, sights: Sequence[Sight]) -> Equations:
    """Sum over the landmarks of J^T W J and J^T W e, W the inverse covariance of the residual e = seen - expected."""
    # written out: this is where the time goes
    chi2 = log_det = a00 = a01 = a02 = a11 = a12 = a22 = g0 = g1 = g2 = 0.0
    b0 = b1 = b2 = by_shared = pull = 0.0
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    for x, y, xx, xy, yy, range_m, bearing_rad, rr, rb, bb, longer in sights:
        across_x, across_y = cosine * x + sine * y, cosine * y - sine * x
        qx, qy = state[0] + across_x, state[1] + across_y
        d = math.hypot(qx, qy) or _ON_IT_M
        ux, uy = qx / d, qy / d
        vx, vy = -uy / d, ux / d
        error_range, error_bearing = range_m - d, math.remainder(bearing_rad - math.atan2(qy, qx), math.tau)
        if xx != 0.0 or yy != 0.0:
            rr, rb, bb = _with_survey(cosine, sine, ux, uy, vx, vy, xx, xy, yy, rr, rb, bb)
        det = rr * bb - rb * rb
        wrr, wrb, wbb = bb / det, -rb / det, rr / det
        # J = [[ux, uy, uh], [vx, vy, vh]]
        uh, vh = ux * across_y - uy * across_x, vx * across_y - vy * across_x
        weighted_range = wrr * error_range + wrb * error_bearing
        weighted_bearing = wrb * error_range + wbb * error_bearing
        chi2 += error_range * weighted_range + error_bearing * weighted_bearing
        log_det += math.log(det)
        wu_x, wv_x = wrr * ux + wrb * vx, wrb * ux + wbb * vx
        wu_y, wv_y = wrr * uy + wrb * vy, wrb * uy + wbb * vy
        wu_h, wv_h = wrr * uh + wrb * vh, wrb * uh + wbb * vh
        a00 += ux * wu_x + vx * wv_x
        a01 += uy * wu_x + vy * wv_x
        a02 += uh * wu_x + vh * wv_x
        a11 += uy * wu_y + vy * wv_y
        a12 += uh * wu_y + vh * wv_y
        a22 += uh * wu_h + vh * wv_h
        g0 += ux * weighted_range + vx * weighted_bearing
        g1 += uy * weighted_range + vy * weighted_bearing
        g2 += uh * weighted_range + vh * weighted_bearing
        if longer:
            b0, b1, b2 = b0 + longer * wu_x, b1 + longer * wu_y, b2 + longer * wu_h
            by_shared += longer * longer * wrr
            pull += longer * weighted_range
    variance = 1.0 / (1.0 + by_shared)
    value, f0, f1, f2 = variance * pull, variance * b0, variance * b1, variance * b2
    return Equations(
        chi2 - value * pull,
        log_det - math.log(variance),
        (a00 - b0 * f0, a01 - b0 * f1, a02 - b0 * f2, a11 - b1 * f1, a12 - b1 * f2, a22 - b2 * f2),
        (g0 - b0 * value, g1 - b1 * value, g2 - b2 * value),
        Shared(value, variance, (f0, f1, f2)),
    )


def misfit(state: State, sights: Sequence[Sight]) -> float:
    """chi2 alone, as in `equations`."""
    chi2 = by_shared = pull = 0.0
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    for x, y, xx, xy, yy, range_m, bearing_rad, rr, rb, bb, longer in sights:
        qx, qy = state[0] + cosine * x + sine * y, state[1] + cosine * y - sine * x
        d = math.hypot(qx, qy) or _ON_IT_M
        error_range, error_bearing = range_m - d, math.remainder(bearing_rad - math.atan2(qy, qx), math.tau)
        if xx != 0.0 or yy != 0.0:
            ux, uy = qx / d, qy / d
            rr, rb, bb = _with_survey(cosine, sine, ux, uy, -uy / d, ux / d, xx, xy, yy, rr, rb, bb)
        det = rr * bb - rb * rb
        weighted_range = (bb * error_range - rb * error_bearing) / det
        chi2 += error_range * weighted_range + error_bearing * (rr * error_bearing - rb * error_range) / det
        by_shared += longer * longer * bb / det
        pull += longer * weighted_range
    return chi2 - pull * pull / (1.0 + by_shared)


def _with_survey(
    cosine: float, sine: float, ux: float, uy: float, vx: float, vy: float,
    xx: float, xy: float, yy: float, rr: float, rb: float, bb: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Covariance (rr, rb, bb) of the residual: the sensor's, and the map's turned into the sensor's frame."""
    ux, uy, vx, vy = cosine * ux - sine * uy, sine * ux + cosine * uy, cosine * vx - sine * vy, sine * vx + cosine * vy
    return (
        rr + ux * ux * xx + 2.0 * ux * uy * xy + uy * uy * yy,
        rb + ux * vx * xx + (ux * vy + uy * vx) * xy + uy * vy * yy,
        bb + vx * vx * xx + 2.0 * vx * vy * xy + vy * vy * yy,
    )


def inverse(a: Symmetric) -> Symmetric | None:
    """None where the matrix is singular to rounding."""
    a00, a01, a02, a11, a12, a22 = a
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c00 + a01 * c01 + a02 * c02
    if not det > 1e-13 * a00 * a11 * a22:
        return None
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    return c00 / det, c01 / det, c02 / det, c11 / det, c12 / det, c22 / det


def chi2_each(state: State, p: Symmetric, at: Equations, sights: Sequence[Sight]) -> list[float]:
    """e^T (S - J P J^T)^-1 e per landmark: to first order what chi2 loses without it."""
    if len(sights) == 2:
        return [at.chi2, at.chi2]
    p00, p01, p02, p11, p12, p22 = p
    value, variance, (f0, f1, f2) = at.shared
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    out = []
    for x, y, xx, xy, yy, range_m, bearing_rad, rr, rb, bb, longer in sights:
        across_x, across_y = cosine * x + sine * y, cosine * y - sine * x
        qx, qy = state[0] + across_x, state[1] + across_y
        d = math.hypot(qx, qy) or _ON_IT_M
        ux, uy = qx / d, qy / d
        vx, vy = -uy / d, ux / d
        error_range = range_m - d - longer * value
        error_bearing = math.remainder(bearing_rad - math.atan2(qy, qx), math.tau)
        if xx != 0.0 or yy != 0.0:
            rr, rb, bb = _with_survey(cosine, sine, ux, uy, vx, vy, xx, xy, yy, rr, rb, bb)
        uh, vh = ux * across_y - uy * across_x, vx * across_y - vy * across_x
        # what is shared follows the state
        ux, uy, uh = ux - longer * f0, uy - longer * f1, uh - longer * f2
        pu = (p00 * ux + p01 * uy + p02 * uh, p01 * ux + p11 * uy + p12 * uh, p02 * ux + p12 * uy + p22 * uh)
        pv = (p00 * vx + p01 * vy + p02 * vh, p01 * vx + p11 * vy + p12 * vh, p02 * vx + p12 * vy + p22 * vh)
        left_rr = rr - (ux * pu[0] + uy * pu[1] + uh * pu[2]) - longer * longer * variance
        left_rb = rb - (vx * pu[0] + vy * pu[1] + vh * pu[2])
        left_bb = bb - (vx * pv[0] + vy * pv[1] + vh * pv[2])
        det = left_rr * left_bb - left_rb * left_rb
        if det > 1e-9 * rr * bb:
            cross = error_range * error_bearing
            out.append((left_bb * error_range**2 - 2.0 * left_rb * cross + left_rr * error_bearing**2) / det)
        else:  # the others do not determine the pose
            out.append(at.chi2)
    return out
