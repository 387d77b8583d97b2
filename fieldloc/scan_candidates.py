"""Which of the map's landmarks the things in a scan may be from one pose, by plain numbers.

The same as `scan_pairs` has for many poses, and `scan_assignments.likeliest` where a map has errors.
"""

import math
from collections.abc import Collection, Iterable, Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from fieldloc.mixture import IntArray
from fieldloc.scan_alone import Symmetric, Vector
from fieldloc.scan_model import NEAREST_M, Row, ScanModel

MOST = 256  # observations times landmarks, up to which this is faster than arrays


def matches(model: ScanModel, pose: Vector, covariance: Symmetric) -> IntArray | None:
    """(n,) the only landmark that each observation may be, -1 for none, from a pose of the sensor up to a covariance of
    its tangent, by errors that are not widened. None where one may be two landmarks, or one landmark two of them, and
    where arrays are faster."""
    if model.survey is not None or model.may.size > MOST:
        return None
    p00, p01, p02, p11, p12, p22 = covariance
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    there = []
    for to_x, to_y in model.positions.tolist():
        dx, dy = to_x - x, to_y - y
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        by_x, by_y = aside * p22 - p02, ahead * p22 + p12
        xx, xy = p00 + aside * (by_x - p02), p01 + ahead * p02 - aside * by_y
        there.append((ahead, aside, math.hypot(ahead, aside), xx, xy, p11 + ahead * (by_y + p12)))
    found: list[tuple[int, int]] = []
    for index, ((r, b, rr, rb, bb, longer, turned, _, _, _, gate), options) in enumerate(_each(model)):
        c, s = math.cos(b), math.sin(b)
        at_x, at_y = r * c, r * s
        rr, bb = rr + longer * longer, bb + turned * turned
        for landmark in options:
            ahead, aside, d, xx, xy, yy = there[landmark]
            ex, ey, far = ahead - at_x, aside - at_y, max(d, r)
            across = far * far * bb
            if ex * ex + ey * ey >= gate * (xx + yy + rr + across):
                continue
            mixed = far * rb
            xx += c * c * rr + s * s * across - 2.0 * c * s * mixed
            yy += s * s * rr + c * c * across + 2.0 * c * s * mixed
            xy += c * s * (rr - across) + (c * c - s * s) * mixed
            if (yy * ex - 2.0 * xy * ey) * ex + xx * ey * ey < gate * (xx * yy - xy * xy):
                found.append((index, landmark))
    return _as_array(found, len(model.range_bearing)) if _one_to_one(found) else None


def recognised(model: ScanModel, pose: Vector) -> IntArray:
    """(n,) landmark of each observation, -1 for none, in the best assignment from one pose."""
    x, y, heading = pose
    places, wider = model.positions.tolist(), model.wider.tolist()
    there: dict[int, tuple[float, float]] = {}
    gains: dict[tuple[int, int], float] = {}
    for index, (row, options) in enumerate(_each(model)):
        r, b, rr, rb, bb, longer, turned, longer_widened, turned_widened, log_peak, gate = row
        near = []
        plain_rr, plain_bb = rr + longer * longer, bb + turned * turned
        for landmark in options:
            if landmark not in there:
                dx, dy = places[landmark][0] - x, places[landmark][1] - y
                there[landmark] = max(math.hypot(dx, dy), NEAREST_M), math.atan2(dy, dx) - heading
            d, bearing = there[landmark]
            er = d - r
            if er * er < gate * plain_rr:
                eb = math.remainder(bearing - b, math.tau)
                if _misfit(er, eb, plain_rr, rb, plain_bb)[0] < gate:
                    near.append((landmark, er, eb))
        if not near:
            continue
        det = rr * bb - rb * rb
        by_r, by_b = (max(1.0, *(wider[landmark][k] for landmark, _, _ in near)) for k in (0, 1))
        rr, rb, bb = by_r * rr, math.sqrt(by_r * by_b) * rb, by_b * bb
        own, whole_rr, whole_bb = rr * bb - rb * rb, rr + longer_widened**2, bb + turned_widened**2
        for landmark, er, eb in near:
            misfit, whole = _misfit(er, eb, whole_rr, rb, whole_bb)
            gain = log_peak - 0.5 * (misfit + math.log(whole / own * det))
            if gain > 0.0:
                gains[index, landmark] = gain
    if not _one_to_one(gains):
        every = np.zeros(model.may.shape)
        for pair, gain in gains.items():
            every[pair] = gain
        best = zip(*(side.tolist() for side in linear_sum_assignment(every, maximize=True)), strict=True)
        return _as_array([pair for pair in best if pair in gains], len(every))
    return _as_array(gains, len(model.range_bearing))


def _each(model: ScanModel) -> Iterator[tuple[Row, list[int]]]:
    """Observations, and the landmarks that they may be by their labels."""
    return zip(model.rows, model.options, strict=True)


def _misfit(er: float, eb: float, rr: float, rb: float, bb: float) -> tuple[float, float]:
    """Chi-square of an error by its covariance, and the determinant of that."""
    det = rr * bb - rb * rb
    return (bb * er * er - 2.0 * rb * er * eb + rr * eb * eb) / det, det


def _one_to_one(pairs: Collection[tuple[int, int]]) -> bool:
    return all(len({pair[side] for pair in pairs}) == len(pairs) for side in (0, 1))


def _as_array(pairs: Iterable[tuple[int, int]], count: int) -> IntArray:
    out = np.full(count, -1)
    for index, landmark in pairs:
        out[index] = landmark
    return out
