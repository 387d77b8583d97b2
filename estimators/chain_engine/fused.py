"""All of a chain linearised and summed up to its normal equations in one sweep, in numba.

The formulas are those of estimators.linearised, which does the same with arrays and says what they are of. In here a
3 x 3 matrix is nine numbers, row by row, and an affine one ((a, b, x), (-b, a, y), (0, 0, 1)) is (a, b, x, y): all
Jacobians and adjoints of the plane are such. Angles come with their cosines and sines, which are turned on, not made
anew.
"""

import math
from typing import NamedTuple

import numpy as np

from estimators.chain_engine.jit import compiled
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

Numbers = tuple[float, ...]

POSE, LANDMARK, HEADING, LINE = 0, 1, 2, 3
"""Kinds of factors. Their values (5,): pose, its heading's cosine and sine; place on the map, where it was seen;
heading; heading, offset, the normal's cosine and sine."""
_SMALL_ANGLE_RAD = 1e-4
_SHORT_RAD = 0.1  # up to here a few powers of an angle are all that a double holds of its cosine and sine
_LARGE = 1e100


class Motions(NamedTuple):
    """moved (n - 1, 3) by odometry's word; informations (n - 1, 6) about the errors, lower triangles; by_calibration
    (n - 1, 3, c) their change with the calibration; durations_s (n - 1,)."""

    moved: FloatArray
    informations: FloatArray
    by_calibration: FloatArray
    durations_s: FloatArray


class Factors(NamedTuple):
    """order (k,): of the others, first by node, then those by sight last, starts (2 n + 1,) of each of these there;
    kinds (k,), values (k, 5), informations (k, 6), lower triangles."""

    starts: IntArray
    order: IntArray
    kinds: IntArray
    values: FloatArray
    informations: FloatArray


@compiled
def add_all(
    poses: FloatArray,
    motions: Motions,
    factors: Factors,
    common: FloatArray,
    square2: float,
    bend: float,
    columns: tuple[int, ...],
    diagonal: FloatArray,
    following: FloatArray,
    border: FloatArray,
    corner: FloatArray,
) -> float:
    """Adds motions and factors to the blocks; what is left of half their squared errors in sigmas.

    common: (c + 4,) the calibrations of odometry and sensor. square2: of Cauchy's kernel; bend: see Arithmetic.
    columns: see Blocks; the calibrations' or none.
    """
    moved, motion_informations, by_calibration, durations_s = motions
    q = len(columns) + 1
    c = q - 5 if q > 1 else 0
    calibration, sensor = common[:-4], common[-4:]
    off = q > 1 or np.any(sensor != 0.0)  # whether things are seen from elsewhere than where the robot is
    lever, by_sensor, rows = np.zeros((3, 4)), np.zeros((3, 5)), np.zeros((3, q))
    cost = x = y = heading = cos = sin = 0.0
    for k in range(len(poses)):
        m = max(k - 1, 0)
        last_x, last_y, last_heading, last_cos, last_sin = x, y, heading, cos, sin
        x, y, heading = poses[k, 0], poses[k, 1], poses[k, 2]
        cos, sin = math.cos(heading), math.sin(heading)
        right: Numbers = (1.0, 0.0, 0.0, 0.0)
        at_x = at_y = at_turn = at_sin = 0.0
        at_cos = 1.0
        if len(moved):
            one = two = three = 0.0
            for j in range(len(calibration)):
                one += by_calibration[m, 0, j] * calibration[j]
                two += by_calibration[m, 1, j] * calibration[j]
                three += by_calibration[m, 2, j] * calibration[j]
            x1, y1, turn, turn_cos, turn_sin, right = _exp(one, two, three)
            at_cos, at_sin = _cos_sin(moved[m, 2])
            at_x, at_y = moved[m, 0] + at_cos * x1 - at_sin * y1, moved[m, 1] + at_sin * x1 + at_cos * y1
            at_turn = _wrapped(moved[m, 2] + turn)
            at_cos, at_sin = at_cos * turn_cos - at_sin * turn_sin, at_sin * turn_cos + at_cos * turn_sin
        rows[:] = 0.0
        known = False
        if k > 0:
            dx, dy = x - last_x, y - last_y
            walked_x, walked_y = last_cos * dx + last_sin * dy, last_cos * dy - last_sin * dx
            walked_cos, walked_sin = cos * last_cos + sin * last_sin, sin * last_cos - cos * last_sin
            dx, dy = walked_x - at_x, walked_y - at_y
            error, after = _log(
                at_cos * dx + at_sin * dy, at_cos * dy - at_sin * dx, _wrapped(heading - last_heading - at_turn)
            )
            information = _symmetric(motion_informations[m])
            pull = _vector(information, error)
            cost += 0.5 * (pull[0] * error[0] + pull[1] * error[1] + pull[2] * error[2])
            towards = _under_vector(after, pull)
            own = _under(after, _times(information, after))
            # by the tangent before it moves as -after @ adjoint
            adjoint = (
                walked_cos,
                walked_sin,
                walked_sin * walked_x - walked_cos * walked_y,
                walked_cos * walked_x + walked_sin * walked_y,
            )
            across = _under(adjoint, own)
            before = _times(across, adjoint)
            backwards = _under_vector(adjoint, towards)
            _add(diagonal[m], 1.0, before)
            _add(diagonal[k], 1.0, own)
            _add(following[m], -1.0, across)
            _add_column(border[m], q - 1, 1.0, backwards)
            _add_column(border[k], q - 1, -1.0, towards)
            if c:
                # the expected motion is on the error's left side: the inverse right Jacobian at the error backwards
                moving = _product((after[0], -after[1], after[2] - error[1], after[3] + error[0]), right)
                weighted = _times(information, moving)
                by_pose, by_motion = _under(after, weighted), _under(moving, weighted)
                for j in range(c):
                    column = _column(by_calibration[m], j)
                    change = _vector(by_pose, column)
                    back, alone = _under_vector(adjoint, change), _vector(by_motion, column)
                    _add_column(border[m], j, 1.0, back)
                    _add_column(border[k], j, -1.0, change)
                    _add_column(rows, j, 1.0, alone)
                moves = _under_vector(moving, pull)
                _add_column(rows, q - 1, 1.0, moves)
                known = True
        first, seen, end = factors.starts[2 * k], factors.starts[2 * k + 1], factors.starts[2 * k + 2]
        if not off:
            seen = end
        if seen > first:
            own, towards, left = _known(factors, first, seen, (x, y, heading, cos, sin), square2, bend)
            cost += left
            _add(diagonal[k], 1.0, own)
            _add_column(border[k], q - 1, 1.0, towards)
        if end > seen:
            velocity: Numbers = (0.0, 0.0, 0.0)
            inverse: Numbers = right
            per_s = 0.0
            if len(moved):
                velocity, inverse = _log(at_x, at_y, at_turn)
                per_s = 1.0 / durations_s[m]
                velocity = (velocity[0] * per_s, velocity[1] * per_s, velocity[2] * per_s)
            x1, y1, turn, turn_cos, turn_sin, turning = _exp(
                sensor[0] - sensor[3] * velocity[0],
                sensor[1] - sensor[3] * velocity[1],
                -sensor[2] - sensor[3] * velocity[2],
            )
            there_x, there_y = x + cos * x1 - sin * y1, y + sin * x1 + cos * y1
            there_cos, there_sin = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
            there = (there_x, there_y, heading + turn, there_cos, there_sin)
            information, pull, left = _known(factors, seen, end, there, square2, bend)
            cost += left
            adjoint = (turn_cos, turn_sin, turn_sin * x1 - turn_cos * y1, turn_cos * x1 + turn_sin * y1)
            own, towards = _under(adjoint, _times(information, adjoint)), _under_vector(adjoint, pull)
            _add(diagonal[k], 1.0, own)
            _add_column(border[k], q - 1, 1.0, towards)
            if q > 1:
                weighted = _times(information, turning)
                by_pose, by_turn = _under(adjoint, weighted), _under(turning, weighted)
                pull = _under_vector(turning, pull)
                # the velocity's change with the calibration, and with it the tangent's
                changes, late = _product(inverse, right), -sensor[3] * per_s
                by_both, by_motion = _times(by_pose, changes), _under(changes, _times(by_turn, changes))
                lever[0, 0], lever[1, 1], lever[2, 2] = 1.0, 1.0, -1.0
                for i in range(3):
                    lever[i, 3] = -velocity[i]
                    by_sensor[i, 4] = pull[i]
                for j in range(4):
                    column = _column(lever, j)
                    change, alone = _vector(by_pose, column), _vector(by_turn, column)
                    _add_column(border[k], c + j, 1.0, change)
                    by_sensor[0, j], by_sensor[1, j], by_sensor[2, j] = alone
                for i in range(4):
                    for j in range(5):
                        for r in range(3):
                            corner[c + i, c + j] += lever[r, i] * by_sensor[r, j]
                if late != 0.0:
                    known = True
                    for j in range(c):
                        column = _column(by_calibration[m], j)
                        change, alone = _vector(by_both, column), _vector(by_motion, column)
                        _add_column(border[k], j, late, change)
                        _add_column(rows, j, late * late, alone)
                    for j in range(5):
                        alone = _under_vector(changes, _column(by_sensor, j))
                        _add_column(rows, c + j, late, alone)
        if known:
            for i in range(c):
                one, two, three = by_calibration[m, 0, i], by_calibration[m, 1, i], by_calibration[m, 2, i]
                for j in range(q):
                    corner[i, j] += one * rows[0, j] + two * rows[1, j] + three * rows[2, j]
    return cost


@compiled
def retracted(poses: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As Arithmetic.retracted."""
    out, most = np.empty((len(poses), 3)), np.zeros(3)
    for k in range(len(poses)):
        x, y, turn, _, _, _ = _exp(steps[k, 0], steps[k, 1], steps[k, 2])
        cos, sin = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        out[k, 0], out[k, 1] = poses[k, 0] + cos * x - sin * y, poses[k, 1] + sin * x + cos * y
        out[k, 2] = _wrapped(poses[k, 2] + turn)
        for i in range(3):
            size = abs(steps[k, i])
            if size > most[i] or math.isnan(size):  # what is not a number stays so
                most[i] = size
    return out, most


@compiled
def _known(
    factors: Factors, first: int, end: int, pose: Numbers, square2: float, bend: float
) -> tuple[Numbers, Numbers, float]:
    """What some factors say of the pose that they are about: information (9,), towards (3,), what is left of them."""
    x, y, heading, cos, sin = pose
    i00 = i10 = i11 = i20 = i21 = i22 = towards0 = towards1 = towards2 = cost = 0.0
    product = 1.0
    for index in range(first, end):
        f = factors.order[index]
        kind, value = factors.kinds[f], factors.values[f]
        information = _symmetric(factors.informations[f])
        if kind == POSE:
            dx, dy = x - value[0], y - value[1]
            error, after = _log(
                value[3] * dx + value[4] * dy, value[3] * dy - value[4] * dx, _wrapped(heading - value[2])
            )
            pull = _vector(information, error)
            square = pull[0] * error[0] + pull[1] * error[1] + pull[2] * error[2]
            pull0, pull1, pull2 = _under_vector(after, pull)
            a00, _, _, a10, a11, _, a20, a21, a22 = _under(after, _times(information, after))
        elif kind == LANDMARK:
            dx, dy = value[0] - x, value[1] - y
            forward, left = cos * dx + sin * dy, cos * dy - sin * dx
            dx, dy = forward - value[2], left - value[3]
            a00, a10, a11 = information[0], information[3], information[4]
            pull0, pull1 = -a00 * dx - a10 * dy, -a10 * dx - a11 * dy
            square = -pull0 * dx - pull1 * dy
            pull2 = forward * pull1 - left * pull0
            a20, a21 = a10 * forward - a00 * left, a11 * forward - a10 * left
            a22 = a21 * forward - a20 * left
        else:
            turn = _wrapped(heading - value[0])
            a00 = a10 = a11 = a20 = a21 = pull0 = pull1 = 0.0
            a22 = information[0]
            pull2 = a22 * turn
            square = pull2 * turn
            if kind == LINE:
                ahead, aside = value[2] * cos + value[3] * sin, value[3] * cos - value[2] * sin
                offset = value[2] * x + value[3] * y - value[1]
                pull1 = information[3] * turn + information[4] * offset
                pull2 += information[3] * offset
                square = pull2 * turn + pull1 * offset
                pull0, pull1 = ahead * pull1, aside * pull1
                a00, a10, a11 = ahead * ahead, ahead * aside, aside * aside
                a00, a10, a11 = information[4] * a00, information[4] * a10, information[4] * a11
                a20, a21 = information[3] * ahead, information[3] * aside
        product *= 1.0 + square / square2
        if product > _LARGE:
            cost, product = cost + math.log(product), 1.0
        weight = square2 / (square2 + square)
        less = 0.0
        if bend > 0.0 and square > 0.0:
            less = min(2.0 / square2, bend / (weight * square))
        pull0, pull1, pull2 = weight * pull0, weight * pull1, weight * pull2
        i00 += weight * a00 - less * pull0 * pull0
        i10 += weight * a10 - less * pull1 * pull0
        i11 += weight * a11 - less * pull1 * pull1
        i20 += weight * a20 - less * pull2 * pull0
        i21 += weight * a21 - less * pull2 * pull1
        i22 += weight * a22 - less * pull2 * pull2
        towards0, towards1, towards2 = towards0 - pull0, towards1 - pull1, towards2 - pull2
    cost = 0.5 * square2 * (cost + math.log(product))
    return (i00, i10, i20, i10, i11, i21, i20, i21, i22), (towards0, towards1, towards2), cost


@compiled
def _add(block: FloatArray, sign: float, matrix: Numbers) -> None:
    _add_column(block, 0, sign, (matrix[0], matrix[3], matrix[6]))
    _add_column(block, 1, sign, (matrix[1], matrix[4], matrix[7]))
    _add_column(block, 2, sign, (matrix[2], matrix[5], matrix[8]))


@compiled
def _add_column(rows: FloatArray, j: int, factor: float, column: Numbers) -> None:
    rows[0, j] += factor * column[0]
    rows[1, j] += factor * column[1]
    rows[2, j] += factor * column[2]


@compiled
def _column(rows: FloatArray, j: int) -> Numbers:
    return rows[0, j], rows[1, j], rows[2, j]


@compiled
def _symmetric(lower: FloatArray) -> Numbers:
    return lower[0], lower[1], lower[3], lower[1], lower[2], lower[4], lower[3], lower[4], lower[5]


@compiled
def _vector(matrix: Numbers, v: Numbers) -> Numbers:
    return (
        matrix[0] * v[0] + matrix[1] * v[1] + matrix[2] * v[2],
        matrix[3] * v[0] + matrix[4] * v[1] + matrix[5] * v[2],
        matrix[6] * v[0] + matrix[7] * v[1] + matrix[8] * v[2],
    )


@compiled
def _product(one: Numbers, other: Numbers) -> Numbers:
    """Of affine ones."""
    a, b, x, y = one
    c, d, z, w = other
    return a * c - b * d, a * d + b * c, a * z + b * w + x, a * w - b * z + y


@compiled
def _times(matrix: Numbers, affine: Numbers) -> Numbers:
    a, b, x, y = affine
    r, s, t, u, v, w, i, j, k = matrix
    return (
        a * r - b * s,
        b * r + a * s,
        x * r + y * s + t,
        a * u - b * v,
        b * u + a * v,
        x * u + y * v + w,
        a * i - b * j,
        b * i + a * j,
        x * i + y * j + k,
    )


@compiled
def _under(affine: Numbers, matrix: Numbers) -> Numbers:
    """transpose(affine) @ matrix."""
    a, b, x, y = affine
    r, s, t, u, v, w, i, j, k = matrix
    return (
        a * r - b * u,
        a * s - b * v,
        a * t - b * w,
        b * r + a * u,
        b * s + a * v,
        b * t + a * w,
        x * r + y * u + i,
        x * s + y * v + j,
        x * t + y * w + k,
    )


@compiled
def _under_vector(affine: Numbers, v: Numbers) -> Numbers:
    """transpose(affine) @ v."""
    a, b, x, y = affine
    return a * v[0] - b * v[1], b * v[0] + a * v[1], x * v[0] + y * v[1] + v[2]


@compiled
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle * (0.5 / math.pi) + 0.5)


@compiled
def _half(half: float) -> tuple[float, float]:
    """Cosine, and sine by the angle."""
    if abs(half) > _SHORT_RAD:
        return math.cos(half), math.sin(half) / half
    h = half * half
    cosine = 1.0 - h / 2.0 * (1.0 - h / 12.0 * (1.0 - h / 30.0 * (1.0 - h / 56.0 * (1.0 - h / 90.0))))
    return cosine, 1.0 - h / 6.0 * (1.0 - h / 20.0 * (1.0 - h / 42.0 * (1.0 - h / 72.0 * (1.0 - h / 110.0))))


@compiled
def _cos_sin(angle: float) -> tuple[float, float]:
    cosine, chord = _half(angle)
    return cosine, chord * angle


@compiled
def _exp(forward: float, left: float, turn: float) -> tuple[float, float, float, float, float, Numbers]:
    """As se2.exp: the pose, its heading's cosine and sine, and the right Jacobian there."""
    cosine, chord = _half(0.5 * turn)
    a, b = chord * cosine, 0.5 * turn * chord * chord
    p = turn / 6.0 if abs(turn) < _SMALL_ANGLE_RAD else (1.0 - a) / turn
    q = 0.5 * chord * chord
    x, y = a * forward - b * left, b * forward + a * left
    return x, y, _wrapped(turn), 1.0 - turn * b, turn * a, (a, b, p * forward - q * left, q * forward + p * left)


@compiled
def _log(x: float, y: float, turn: float) -> tuple[Numbers, Numbers]:
    """As se2.log, of a wrapped turn: the tangent, and the inverse right Jacobian there."""
    half = 0.5 * turn
    cosine, chord = _half(half)
    along = cosine / chord
    forward, left = along * x + half * y, along * y - half * x
    r = turn / 12.0 if abs(turn) < _SMALL_ANGLE_RAD else (1.0 - along) / turn
    return (forward, left, turn), (along, -half, r * forward + 0.5 * left, r * left - 0.5 * forward)
