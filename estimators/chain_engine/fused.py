"""All of a chain linearised and summed up to its normal equations in one sweep, in numba.

The formulas are those of estimators.linearised, which does the same with arrays and says what they are of.
"""

import math

import numpy as np

from estimators.chain_engine.jit import compiled
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

POSE, LANDMARK, HEADING, LINE = 0, 1, 2, 3
"""Kinds of factors, whose values (4,) are: pose; place on the map and where it was seen; heading; heading, direction of
the normal, offset."""
_SMALL_ANGLE_RAD = 1e-4


@compiled
def add_motions(
    poses: FloatArray,
    moved: FloatArray,
    miscalibrated: FloatArray,
    roots: FloatArray,
    by_common: FloatArray,
    diagonal: FloatArray,
    following: FloatArray,
    border: FloatArray,
    corner: FloatArray,
) -> float:
    """Adds the motions to the blocks; half their squared errors in sigmas.

    miscalibrated: (n - 1, 3) what the calibration changes of them; by_common: (n - 1, 3, c) its change with the
    border's first c columns.
    """
    columns, q = by_common.shape[2], border.shape[2]
    row = np.zeros((3, 7 + columns))
    error = np.empty(3)
    after, before, backwards, right = np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))
    cost = 0.0
    for k in range(len(moved)):
        x, y, turn = _exp(miscalibrated[k, 0], miscalibrated[k, 1], miscalibrated[k, 2], right)
        expected = _composed(moved[k, 0], moved[k, 1], moved[k, 2], x, y, turn)
        walked = _between(poses[k, 0], poses[k, 1], poses[k, 2], poses[k + 1, 0], poses[k + 1, 1], poses[k + 1, 2])
        x, y, turn = _between(expected[0], expected[1], expected[2], walked[0], walked[1], walked[2])
        _log(x, y, turn, error, after)
        # before = -after @ adjoint(inverse(walked))
        c, s = math.cos(walked[2]), math.sin(walked[2])
        across, along = s * walked[0] - c * walked[1], c * walked[0] + s * walked[1]
        for i in range(3):
            before[i, 0] = s * after[i, 1] - c * after[i, 0]
            before[i, 1] = -s * after[i, 0] - c * after[i, 1]
            before[i, 2] = -after[i, 0] * across - after[i, 1] * along - after[i, 2]
        for r in range(3):
            for i in range(3):
                low = high = 0.0
                for m in range(r + 1):
                    low += roots[k, r, m] * before[m, i]
                    high += roots[k, r, m] * after[m, i]
                row[r, i], row[r, 3 + i] = low, high
            value = 0.0
            for m in range(r + 1):
                value -= roots[k, r, m] * error[m]
            row[r, 6 + columns] = value
            cost += 0.5 * value * value
        if columns:
            # the inverse right Jacobian at the error backwards
            backwards[0, 0], backwards[0, 1], backwards[0, 2] = after[0, 0], after[1, 0], after[0, 2] - error[1]
            backwards[1, 0], backwards[1, 1], backwards[1, 2] = after[0, 1], after[1, 1], after[1, 2] + error[0]
            for r in range(3):
                a = b = c = 0.0  # of -root @ backwards, row r
                for m in range(r + 1):
                    a -= roots[k, r, m] * backwards[m, 0]
                    b -= roots[k, r, m] * backwards[m, 1]
                    c -= roots[k, r, m] * backwards[m, 2]
                d = a * right[0, 0] + b * right[1, 0]
                e = a * right[0, 1] + b * right[1, 1]
                f = a * right[0, 2] + b * right[1, 2] + c
                for j in range(columns):
                    row[r, 6 + j] = d * by_common[k, 0, j] + e * by_common[k, 1, j] + f * by_common[k, 2, j]
        for r in range(3):
            for i in range(3):
                low, high = row[r, i], row[r, 3 + i]
                for j in range(3):
                    diagonal[k, i, j] += low * row[r, j]
                    following[k, i, j] += low * row[r, 3 + j]
                    diagonal[k + 1, i, j] += high * row[r, 3 + j]
                for j in range(columns):
                    border[k, i, j] += low * row[r, 6 + j]
                    border[k + 1, i, j] += high * row[r, 6 + j]
                border[k, i, q - 1] += low * row[r, 6 + columns]
                border[k + 1, i, q - 1] += high * row[r, 6 + columns]
            for i in range(columns):
                for j in range(i, columns):
                    corner[i, j] += row[r, 6 + i] * row[r, 6 + j]
                corner[i, q - 1] += row[r, 6 + i] * row[r, 6 + columns]
    return cost


@compiled
def sights(
    moved: FloatArray,
    miscalibrated: FloatArray,
    by_calibration: FloatArray,
    durations_s: FloatArray,
    still: FloatArray,
    by_velocity: FloatArray,
    sensor: FloatArray,
    free: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """As Linearised.sights; the change with the columns of by_calibration (n - 1, 3, c) and the sensor's free ones.

    still: (3, 4) lever of a robot that does not move; by_velocity: (3, 3, 4) its change with the velocity.
    """
    count, c = len(moved) + 1, by_calibration.shape[2]
    turned, by_common = np.zeros((count, 3)), np.zeros((count, 3, c + len(free)))
    velocity, twist = np.zeros(3), np.zeros(3)
    first, right, inverse, both = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):  # of the tangent by the velocity
        for j in range(3):
            for m in range(len(sensor)):
                first[j, i] += by_velocity[i, j, m] * sensor[m]
    for k in range(count):
        before = max(k - 1, 0)
        if count > 1:
            x, y, turn = _exp(miscalibrated[before, 0], miscalibrated[before, 1], miscalibrated[before, 2], right)
            x, y, turn = _composed(moved[before, 0], moved[before, 1], moved[before, 2], x, y, turn)
            _log(x, y, turn, twist, inverse)
            for i in range(3):
                velocity[i] = twist[i] / durations_s[before]
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    for m in range(3):
                        value += inverse[i, m] * right[m, j]
                    both[i, j] = value / durations_s[before]
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    for m in range(3):
                        value += first[i, m] * both[m, j]
                    right[i, j] = value
            for i in range(3):
                for j in range(c):
                    value = 0.0
                    for m in range(3):
                        value += right[i, m] * by_calibration[before, m, j]
                    by_common[k, i, j] = value
        for i in range(3):
            for m in range(len(sensor)):
                lever = still[i, m]
                for j in range(3):
                    lever += by_velocity[j, i, m] * velocity[j]
                turned[k, i] += lever * sensor[m]
                for column in range(len(free)):
                    if free[column] == m:
                        by_common[k, i, c + column] = lever
    return turned, by_common


@compiled
def add_factors(
    poses: FloatArray,
    nodes: IntArray,
    kinds: IntArray,
    sighted: IntArray,
    values: FloatArray,
    roots: FloatArray,
    turned: FloatArray,
    by_common: FloatArray,
    cauchy: float,
    bend: float,
    diagonal: FloatArray,
    border: FloatArray,
    corner: FloatArray,
) -> float:
    """Adds the factors to the blocks; what Cauchy's kernel of `cauchy` sigmas leaves of their errors.

    nodes in order, kinds, sighted (k,), values (k, 4), roots (k, 3, 3): of the factors. turned: (n, 3) from each node
    to where it is seen from, none if that is the same; by_common: (n, 3, c) its change with the border's first c
    columns. bend: see Arithmetic.
    """
    size, count, q = 0, len(nodes), border.shape[2]
    error, jacobian, row = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 4))
    information, pull, towards = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    adjoint, right = np.eye(3), np.zeros((3, 3))
    cost, square2 = 0.0, cauchy * cauchy
    f = 0
    while f < count:
        node, seeing = nodes[f], len(turned) > 0 and sighted[f] != 0
        x, y, heading = poses[node, 0], poses[node, 1], poses[node, 2]
        if seeing:
            moved = _exp(turned[node, 0], turned[node, 1], turned[node, 2], right)
            x, y, heading = _composed(x, y, heading, moved[0], moved[1], moved[2])
            c, s = math.cos(moved[2]), math.sin(moved[2])
            adjoint[0, 0], adjoint[0, 1], adjoint[0, 2] = c, s, s * moved[0] - c * moved[1]
            adjoint[1, 0], adjoint[1, 1], adjoint[1, 2] = -s, c, c * moved[0] + s * moved[1]
        c, s = math.cos(heading), math.sin(heading)
        information[:] = 0.0
        towards[:] = 0.0
        # all that is about one pose goes into one information about that
        while f < count and nodes[f] == node and (len(turned) > 0 and sighted[f] != 0) == seeing:
            kind = kinds[f]
            if kind == POSE:
                size = 3
                at = _between(values[f, 0], values[f, 1], values[f, 2], x, y, heading)
                _log(at[0], at[1], at[2], error, jacobian)
            elif kind == LANDMARK:
                size = 2
                forward, left = values[f, 0] - x, values[f, 1] - y
                forward, left = c * forward + s * left, c * left - s * forward
                error[0], error[1] = forward - values[f, 2], left - values[f, 3]
                jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = -1.0, 0.0, left
                jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = 0.0, -1.0, -forward
            else:
                size = 1
                error[0] = _wrapped(heading - values[f, 0])
                jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 0.0, 0.0, 1.0
                if kind == LINE:
                    size = 2
                    normal_c, normal_s = math.cos(values[f, 1]), math.sin(values[f, 1])
                    error[1] = normal_c * x + normal_s * y - values[f, 2]
                    jacobian[1, 0], jacobian[1, 2] = normal_c * c + normal_s * s, 0.0
                    jacobian[1, 1] = normal_s * c - normal_c * s
            square = 0.0
            for r in range(size):
                for i in range(4):
                    row[r, i] = 0.0
                for m in range(r + 1):
                    root = roots[f, r, m]
                    for i in range(3):
                        row[r, i] += root * jacobian[m, i]
                    row[r, 3] -= root * error[m]
                square += row[r, 3] * row[r, 3]
            cost += 0.5 * square2 * math.log1p(square / square2)
            weight = 1.0 / (1.0 + square / square2)
            for i in range(3):
                pull[i] = 0.0
            for r in range(size):
                for i in range(3):
                    scaled = weight * row[r, i]
                    pull[i] += scaled * row[r, 3]
                    for j in range(3):
                        information[i, j] += scaled * row[r, j]
            less = 0.0
            if bend > 0.0 and square > 0.0:
                less = min(2.0 / square2, bend / (weight * square))
            for i in range(3):
                towards[i] += pull[i]
                for j in range(3):
                    information[i, j] -= less * pull[i] * pull[j]
            f += 1
        if seeing:
            _add_seen(information, towards, adjoint, right, by_common[node], diagonal[node], border[node], corner)
        else:
            for i in range(3):
                for j in range(3):
                    diagonal[node, i, j] += information[i, j]
                border[node, i, q - 1] += towards[i]
    return cost


@compiled
def _add_seen(
    information: FloatArray,
    towards: FloatArray,
    adjoint: FloatArray,
    right: FloatArray,
    by_common: FloatArray,
    diagonal: FloatArray,
    border: FloatArray,
    corner: FloatArray,
) -> None:
    """Adds what is known of a pose that was seen from to the node's blocks: by the tangent there it moves as `adjoint`
    (3, 3) with the node's, as right @ by_common (3, c) with the border."""
    columns, q = by_common.shape[1], border.shape[1]
    for r in range(3):
        for i in range(3):
            value = 0.0
            for m in range(3):
                value += information[r, m] * adjoint[m, i]
            for j in range(3):
                diagonal[j, i] += adjoint[r, j] * value
        for j in range(3):
            border[j, q - 1] += adjoint[r, j] * towards[r]
    for i in range(columns):
        a = right[0, 0] * by_common[0, i] + right[0, 1] * by_common[1, i] + right[0, 2] * by_common[2, i]
        b = right[1, 0] * by_common[0, i] + right[1, 1] * by_common[1, i] + right[1, 2] * by_common[2, i]
        c = by_common[2, i]
        d = information[0, 0] * a + information[0, 1] * b + information[0, 2] * c
        e = information[1, 0] * a + information[1, 1] * b + information[1, 2] * c
        f = information[2, 0] * a + information[2, 1] * b + information[2, 2] * c
        for j in range(3):
            border[j, i] += adjoint[0, j] * d + adjoint[1, j] * e + adjoint[2, j] * f
        # back into the tangent of by_common
        g, h = right[0, 0] * d + right[1, 0] * e, right[0, 1] * d + right[1, 1] * e
        k = right[0, 2] * d + right[1, 2] * e + f
        for j in range(i, columns):
            corner[i, j] += g * by_common[0, j] + h * by_common[1, j] + k * by_common[2, j]
        corner[i, q - 1] += a * towards[0] + b * towards[1] + c * towards[2]


@compiled
def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def _composed(
    x: float, y: float, heading: float, forward: float, left: float, turn: float
) -> tuple[float, float, float]:
    c, s = math.cos(heading), math.sin(heading)
    return x + c * forward - s * left, y + s * forward + c * left, _wrapped(heading + turn)


@compiled
def _between(
    x: float, y: float, heading: float, other_x: float, other_y: float, other_heading: float
) -> tuple[float, float, float]:
    c, s = math.cos(heading), math.sin(heading)
    dx, dy = other_x - x, other_y - y
    return c * dx + s * dy, c * dy - s * dx, _wrapped(other_heading - heading)


@compiled
def _exp(forward: float, left: float, turn: float, right: FloatArray) -> tuple[float, float, float]:
    """As se2.exp; the right Jacobian there goes to `right`."""
    half = 0.5 * turn
    chord = 1.0 if half == 0.0 else math.sin(half) / half
    a, b = chord * math.cos(half), chord * math.sin(half)
    p = turn / 6.0 if abs(turn) < _SMALL_ANGLE_RAD else (1.0 - a) / turn
    q = 0.5 * chord * chord
    _affine(a, b, p * forward - q * left, q * forward + p * left, right)
    return a * forward - b * left, b * forward + a * left, _wrapped(turn)


@compiled
def _log(x: float, y: float, turn: float, error: FloatArray, jacobian: FloatArray) -> None:
    """As se2.log, of a wrapped turn; the inverse right Jacobian there goes to `jacobian`."""
    half = 0.5 * turn
    along = 1.0 if half == 0.0 else half * math.cos(half) / math.sin(half)
    forward, left = along * x + half * y, along * y - half * x
    error[0], error[1], error[2] = forward, left, turn
    r = turn / 12.0 if abs(turn) < _SMALL_ANGLE_RAD else (1.0 - along) / turn
    _affine(along, -half, r * forward + 0.5 * left, r * left - 0.5 * forward, jacobian)


@compiled
def _affine(a: float, b: float, x: float, y: float, out: FloatArray) -> None:
    out[0, 0] = out[1, 1] = a
    out[0, 1], out[1, 0] = b, -b
    out[0, 2], out[1, 2] = x, y
    out[2, 0] = out[2, 1] = 0.0
    out[2, 2] = 1.0
