"""What one assignment of a scan says from one pose, by plain numbers: most scans are of a robot that knows its place.

The same as `ScanModel.terms`, `scan_quadratics` and `Expansion.after` have it for many at once, where the map is exact:
at the size of a scan plain floats are several times faster than small arrays.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from fieldloc.mixture import IntArray
from fieldloc.one_pose import arc, bend, wrapped
from fieldloc.pose import FloatArray
from fieldloc.scan_model import NEAREST_M, ScanModel

ROUNDS = 3
STRAIGHT = 0.05  # m, m, rad: a step that is no longer needs no further linearisation
MOST = 12  # landmarks, up to which this is faster than arrays

_LARGE = 600.0

Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]
"""Upper triangle of a symmetric 3x3 matrix by rows."""


class Seen(NamedTuple):
    """An observation and its landmark on the map (x, y). w..: inverse of its own covariance, widened. log_peak: density
    without an error, relative to clutter. longer, turned: what all share, one standard deviation, widened; s..: what it
    says of that by covariances that are not widened."""

    x: float
    y: float
    range_m: float
    bearing_rad: float
    wrr: float
    wrb: float
    wbb: float
    log_peak: float
    longer: float
    turned: float
    srr: float
    srb: float
    sbb: float


class Alone(NamedTuple):
    """An expansion of one solution, relative to all being clutter. least_gain: log evidence of the most doubtful
    observation's landmark against clutter, beside the others; doubt: how likely all are together that leave one of them
    out, beside this one."""

    constant: float
    gradient: Vector
    information: Symmetric
    shrink: tuple[Vector, Vector, Vector]
    step: Vector
    updated: Symmetric
    evidence: float
    least_gain: float
    doubt: float


class Line(NamedTuple):
    """Error of an observation's range and bearing, and their changes with the tangent at the pose."""

    range_m: float
    bearing_rad: float
    r0: float
    r1: float
    r2: float
    b0: float
    b1: float
    b2: float


def seen_of(model: ScanModel, matches: IntArray, wider: FloatArray | None) -> list[Seen]:
    """Observations that have a landmark, -1 for none. wider: as `ScanModel.terms` takes it."""
    out = []
    every = zip(
        matches.tolist(),
        model.positions[matches].tolist(),
        [(1.0, 1.0)] * len(matches) if wider is None else wider.tolist(),
        model.rows,
        strict=True,
    )
    for match, (x, y), (by_r, by_b), (r, b, rr, rb, bb, plain_l, plain_t, longer, turned, log_peak, _) in every:
        if match < 0:
            continue
        det = rr * bb - rb * rb
        s = plain_l * plain_l * bb / det, -plain_l * plain_t * rb / det, plain_t * plain_t * rr / det
        log_peak -= 0.5 * math.log(det)
        rr, rb, bb = by_r * rr, math.sqrt(by_r * by_b) * rb, by_b * bb
        det = rr * bb - rb * rb
        out.append(Seen(x, y, r, b, bb / det, -rb / det, rr / det, log_peak, longer, turned, *s))
    return out


def expanded_alone(seen: Sequence[Seen], pose: Vector, covariance: Symmetric) -> Alone:
    """At a pose of the sensor, straight where it leads; covariance of the tangent there."""
    step: Vector = (0.0, 0.0, 0.0)
    for _ in range(ROUNDS):
        out = _expanded(seen, linear(seen, pose, step), covariance)
        after = out.step
        if max(abs(after[0] - step[0]), abs(after[1] - step[1]), abs(after[2] - step[2])) < STRAIGHT:
            break
        step = after
    return out


def fitted(seen: Sequence[Seen], pose: Vector, covariance: Symmetric, rounds: int) -> Vector:
    """After so many steps to where the landmarks' own errors are least, each from a pose that is known so well."""
    own = [one._replace(longer=0.0, turned=0.0) for one in seen]
    for _ in range(rounds):
        (forward, left, turn), (x, y, heading) = _expanded(own, linear(own, pose), covariance).step, pose
        forward, left, turn = arc(forward, left, turn)
        c, s = math.cos(heading), math.sin(heading)
        pose = x + c * forward - s * left, y + s * forward + c * left, wrapped(heading + turn)
    return pose


def linear(seen: Sequence[Seen], pose: Vector, step: Vector = (0.0, 0.0, 0.0)) -> list[Line]:
    """Straight where the step leads."""
    (x, y, heading), (forward, left, turn) = pose, step
    c, s = math.cos(heading), math.sin(heading)
    a, b, p, q = bend(turn)
    ahead, aside = a * forward - b * left, b * forward + a * left
    x, y, heading = x + c * ahead - s * aside, y + s * ahead + c * aside, heading + turn
    by_x, by_y = p * forward - q * left, q * forward + p * left
    out = []
    for one in seen:
        dx, dy = one.x - x, one.y - y
        d = max(math.hypot(dx, dy), NEAREST_M)
        bearing = math.atan2(dy, dx) - heading
        c, s = math.cos(bearing), math.sin(bearing)
        r0, r1, b0, b1 = b * s - a * c, -b * c - a * s, (a * s + b * c) / d, (b * s - a * c) / d
        r2, b2 = -c * by_x - s * by_y, (s * by_x - c * by_y) / d - 1.0
        out.append(
            Line(
                d - one.range_m - (r0 * forward + r1 * left + r2 * turn),
                math.remainder(bearing - one.bearing_rad, math.tau) - (b0 * forward + b1 * left + b2 * turn),
                r0,
                r1,
                r2,
                b0,
                b1,
                b2,
            )
        )
    return out


def _expanded(seen: Sequence[Seen], lines: Sequence[Line], covariance: Symmetric) -> Alone:
    # written out: this is where the time goes
    constant = g0 = g1 = g2 = gl = gt = 0.0
    a00 = a01 = a02 = a11 = a12 = a22 = l0 = l1 = l2 = t0 = t1 = t2 = 0.0
    ll, lt, tt, sll, slt, stt = 1.0, 0.0, 1.0, 1.0, 0.0, 1.0
    for (_, _, _, _, wrr, wrb, wbb, log_peak, longer, turned, srr, srb, sbb), (er, eb, r0, r1, r2, b0, b1, b2) in zip(
        seen, lines, strict=True
    ):
        wr0, wr1, wr2 = wrr * r0 + wrb * b0, wrr * r1 + wrb * b1, wrr * r2 + wrb * b2
        wb0, wb1, wb2 = wrb * r0 + wbb * b0, wrb * r1 + wbb * b1, wrb * r2 + wbb * b2
        wer, web = wrr * er + wrb * eb, wrb * er + wbb * eb
        constant += log_peak - 0.5 * (er * wer + eb * web)
        a00 += r0 * wr0 + b0 * wb0
        a01 += r0 * wr1 + b0 * wb1
        a02 += r0 * wr2 + b0 * wb2
        a11 += r1 * wr1 + b1 * wb1
        a12 += r1 * wr2 + b1 * wb2
        a22 += r2 * wr2 + b2 * wb2
        g0 -= r0 * wer + b0 * web
        g1 -= r1 * wer + b1 * web
        g2 -= r2 * wer + b2 * web
        # by how much all ranges are too long (l), all bearings turned (t)
        l0, l1, l2 = l0 + longer * wr0, l1 + longer * wr1, l2 + longer * wr2
        t0, t1, t2 = t0 + turned * wb0, t1 + turned * wb1, t2 + turned * wb2
        gl, gt = gl - longer * wer, gt - turned * web
        ll, lt, tt = ll + longer * longer * wrr, lt + longer * turned * wrb, tt + turned * turned * wbb
        sll, slt, stt = sll + srr, slt + srb, stt + sbb
    det = ll * tt - lt * lt
    fll, flt, ftt = tt / det, -lt / det, ll / det
    # what is shared follows the tangent so, from (ml, mt) on
    ml, ml0, ml1, ml2 = fll * gl + flt * gt, fll * l0 + flt * t0, fll * l1 + flt * t1, fll * l2 + flt * t2
    mt, mt0, mt1, mt2 = flt * gl + ftt * gt, flt * l0 + ftt * t0, flt * l1 + ftt * t1, flt * l2 + ftt * t2
    constant += 0.5 * (gl * ml + gt * mt - math.log(sll * stt - slt * slt))
    g0, g1, g2 = g0 - l0 * ml - t0 * mt, g1 - l1 * ml - t1 * mt, g2 - l2 * ml - t2 * mt
    a00, a01, a02 = a00 - l0 * ml0 - t0 * mt0, a01 - l0 * ml1 - t0 * mt1, a02 - l0 * ml2 - t0 * mt2
    a11, a12, a22 = a11 - l1 * ml1 - t1 * mt1, a12 - l1 * ml2 - t1 * mt2, a22 - l2 * ml2 - t2 * mt2
    information = a00, a01, a02, a11, a12, a22
    shrink, det = _shrink(covariance, information)
    (s0, s1, s2), (s3, s4, s5), (s6, s7, s8) = shrink
    p00, p01, p02, p11, p12, p22 = covariance
    u00, u11 = s0 * p00 + s1 * p01 + s2 * p02, s3 * p01 + s4 * p11 + s5 * p12
    u22 = s6 * p02 + s7 * p12 + s8 * p22
    u01 = 0.5 * (s0 * p01 + s1 * p11 + s2 * p12 + s3 * p00 + s4 * p01 + s5 * p02)
    u02 = 0.5 * (s0 * p02 + s1 * p12 + s2 * p22 + s6 * p00 + s7 * p01 + s8 * p02)
    u12 = 0.5 * (s3 * p02 + s4 * p12 + s5 * p22 + s6 * p01 + s7 * p11 + s8 * p12)
    d0, d1, d2 = u00 * g0 + u01 * g1 + u02 * g2, u01 * g0 + u11 * g1 + u12 * g2, u02 * g0 + u12 * g1 + u22 * g2
    evidence = constant + 0.5 * (g0 * d0 + g1 * d1 + g2 * d2 - math.log(det))
    # how likely each is beside the others: the innovation without it, from the residual with it
    least, doubt = math.inf, 0.0
    for (_, _, _, _, wrr, wrb, wbb, log_peak, longer, turned, _, _, _), (er, eb, r0, r1, r2, b0, b1, b2) in zip(
        seen, lines, strict=True
    ):
        r0, r1, r2 = r0 - longer * ml0, r1 - longer * ml1, r2 - longer * ml2
        b0, b1, b2 = b0 - turned * mt0, b1 - turned * mt1, b2 - turned * mt2
        er, eb = er + longer * ml + r0 * d0 + r1 * d1 + r2 * d2, eb + turned * mt + b0 * d0 + b1 * d1 + b2 * d2
        ur0, ur1, ur2 = u00 * r0 + u01 * r1 + u02 * r2, u01 * r0 + u11 * r1 + u12 * r2, u02 * r0 + u12 * r1 + u22 * r2
        ub0, ub1, ub2 = u00 * b0 + u01 * b1 + u02 * b2, u01 * b0 + u11 * b1 + u12 * b2, u02 * b0 + u12 * b1 + u22 * b2
        rr = r0 * ur0 + r1 * ur1 + r2 * ur2 + longer * longer * fll
        rb = b0 * ur0 + b1 * ur1 + b2 * ur2 + longer * turned * flt
        bb = b0 * ub0 + b1 * ub1 + b2 * ub2 + turned * turned * ftt
        a, b, c, d = 1.0 - wrr * rr - wrb * rb, -wrr * rb - wrb * bb, -wrb * rr - wbb * rb, 1.0 - wrb * rb - wbb * bb
        det = max(a * d - b * c, 1e-300)
        pull_r, pull_b = wrr * er + wrb * eb, wrb * er + wbb * eb
        misfit = er * (d * pull_r - b * pull_b) + eb * (a * pull_b - c * pull_r)
        gain = log_peak + 0.5 * (math.log(det) - misfit / det)
        least, doubt = min(least, gain), doubt + math.exp(-max(gain, -_LARGE))
    updated = u00, u01, u02, u11, u12, u22
    return Alone(constant, (g0, g1, g2), information, shrink, (d0, d1, d2), updated, evidence, least, doubt)


def _shrink(p: Symmetric, a: Symmetric) -> tuple[tuple[Vector, Vector, Vector], float]:
    """Inverse of 1 + P A, and the determinant of that."""
    p00, p01, p02, p11, p12, p22 = p
    a00, a01, a02, a11, a12, a22 = a
    m00, m01, m02 = (
        1.0 + p00 * a00 + p01 * a01 + p02 * a02,
        p00 * a01 + p01 * a11 + p02 * a12,
        p00 * a02 + p01 * a12 + p02 * a22,
    )
    m10, m11, m12 = (
        p01 * a00 + p11 * a01 + p12 * a02,
        1.0 + p01 * a01 + p11 * a11 + p12 * a12,
        p01 * a02 + p11 * a12 + p12 * a22,
    )
    m20, m21, m22 = (
        p02 * a00 + p12 * a01 + p22 * a02,
        p02 * a01 + p12 * a11 + p22 * a12,
        1.0 + p02 * a02 + p12 * a12 + p22 * a22,
    )
    c00, c10, c20 = m11 * m22 - m12 * m21, m12 * m20 - m10 * m22, m10 * m21 - m11 * m20
    det = m00 * c00 + m01 * c10 + m02 * c20
    return (
        (c00 / det, (m02 * m21 - m01 * m22) / det, (m01 * m12 - m02 * m11) / det),
        (c10 / det, (m00 * m22 - m02 * m20) / det, (m02 * m10 - m00 * m12) / det),
        (c20 / det, (m01 * m20 - m00 * m21) / det, (m00 * m11 - m01 * m10) / det),
    ), det
