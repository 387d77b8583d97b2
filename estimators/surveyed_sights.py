"""Which landmarks a solved log's scans saw, and how much news each sight of one is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.covariance import propagate, squared_mahalanobis
from fieldloc.field import FieldMap
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation
from fieldloc.scan_noises import LearnedNoise

_GATE = 18.4  # chi-square of two numbers, once in ten thousand
_CLEARER = 9.0  # by how much the next best landmark must fit worse
_THINNED = 0.5  # of the shorter correlation: scans that follow each other closer say hardly more
_BATCH = 4096  # of sights at a time


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """k sights of landmarks, in s scans; nodes: of the chain, landmarks: index on the map, sensors: index, all (k,).

    scans: (k,) from 0 to s - 1, rising. range_bearing: (k, 2) as the log has them. covariance: (k, 2, 2) of each one's
    own error, shared: (k, 2) standard deviations of what all of a scan share. wider, wider_shared: (k, 2) by how much
    the variances of both are to be widened, as sights before had much the same errors. mounts: (k, 3)
    robot_from_sensor.
    """

    nodes: IntArray
    scans: IntArray
    landmarks: IntArray
    sensors: IntArray
    range_bearing: FloatArray
    covariance: FloatArray
    shared: FloatArray
    wider: FloatArray
    wider_shared: FloatArray
    mounts: FloatArray

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "Sights":
        _, scans = np.unique(self.scans[rows], return_inverse=True)
        return replace(Sights(*(getattr(self, column.name)[rows] for column in fields(self))), scans=scans)


def sights(
    scans: Sequence[LandmarkScan],
    stamps_ns: Sequence[int],
    eyes: FloatArray,
    covariances: FloatArray,
    field: FieldMap,
    sensors: Sequence[LearnedNoise],
    correlation: ErrorCorrelation,
) -> Sights:
    """Of scans in order, by sensors of which something was learned.

    stamps_ns: (n,) of the chain's nodes. eyes: (n, 3) where the eyes were, covariances (n, 3, 3) of the poses, robot
    frame. Left out is what may be none of the map's landmarks, or either of two.
    """
    node_of = {stamp_ns: node for node, stamp_ns in enumerate(stamps_ns)}
    seen, undistorted = _collected(scans, node_of, field, sensors, correlation)
    parts = [
        _recognised(seen.take(rows), undistorted[rows], eyes, covariances, field)
        for rows in np.array_split(np.arange(len(seen.nodes)), len(seen.nodes) // _BATCH + 1)
    ]
    landmarks = np.concatenate(parts)
    # two that are taken for the same landmark are neither
    pairs = seen.scans * len(field.landmarks) + landmarks
    _, which, counts = np.unique(pairs, return_inverse=True, return_counts=True)
    kept = (landmarks >= 0) & (counts[which] == 1)
    out = replace(seen, landmarks=landmarks).take(kept)
    at_s = np.array(stamps_ns, dtype=np.float64)[out.nodes] * 1e-9
    by_landmark = _ages_s(out.sensors * len(field.landmarks) + out.landmarks, at_s)
    _, first = np.unique(out.scans, return_index=True)
    by_scan = _ages_s(out.sensors[first], at_s[first])[out.scans]
    return replace(out, wider=_widths(by_landmark, correlation), wider_shared=_widths(by_scan, correlation))


def _collected(
    scans: Sequence[LandmarkScan],
    node_of: Mapping[int, int],
    field: FieldMap,
    sensors: Sequence[LearnedNoise],
    correlation: ErrorCorrelation,
) -> tuple[Sights, FloatArray]:
    """All that may be a landmark, -1 for those without a label, and range and bearing (k, 2) without distortion."""
    index = {one.robot_from_sensor.tobytes(): k for k, one in enumerate(sensors)}
    apart_ns = int(_THINNED * min(correlation.range_s, correlation.bearing_s) * 1e9)
    last_ns: dict[int, int] = {}
    rows: list[tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]] = []
    for count, scan in enumerate(scans):
        node, sensor = node_of.get(scan.stamp_ns), index.get(scan.robot_from_sensor.tobytes())
        if node is None or sensor is None or scan.stamp_ns < last_ns.get(sensor, -apart_ns) + apart_ns:
            continue
        labels = [-1 if label is None else field.index_of(label) for label in scan.labels]
        usable = np.isfinite(scan.range_bearing).all(axis=1) & (scan.range_bearing[:, 0] > 0.0)
        kept = [row for row, label in enumerate(labels) if label is not None and usable[row]]
        if not kept:
            continue
        last_ns[sensor] = scan.stamp_ns
        own, shared = sensors[sensor].noise.of(scan.covariance[kept])
        undistorted = sensors[sensor].distortion.removed(scan.range_bearing[kept])
        whole = np.array([(node, count, labels[row], sensor) for row in kept], dtype=np.intp)
        shared = np.zeros((len(kept), 2)) if shared is None else shared
        mounts = np.tile(scan.robot_from_sensor, (len(kept), 1))
        rows.append((whole, scan.range_bearing[kept], own, shared, mounts, undistorted))
    if not rows:
        return Sights(*(np.zeros(0, dtype=np.intp),) * 4, *(np.zeros((0, *s)) for s in _SHAPES)), np.zeros((0, 2))
    numbers, seen, own, shared, mounts, undistorted = (np.concatenate(each) for each in zip(*rows, strict=True))
    nodes, of_scan, landmarks, of_sensor = numbers.T
    ones = np.ones_like(seen)
    return Sights(nodes, of_scan, landmarks, of_sensor, seen, own, shared, ones, ones.copy(), mounts), undistorted


_SHAPES = ((2,), (2, 2), (2,), (2,), (2,), (3,))


def _recognised(
    seen: Sights, undistorted: FloatArray, eyes: FloatArray, covariances: FloatArray, field: FieldMap
) -> IntArray:
    """(k,) the landmark that each is, -1 for none; field: with the covariances of its landmarks."""
    if not len(seen.nodes) or not len(field.landmarks):
        return np.full(len(seen.nodes), -1)
    at = se2.compose(eyes[seen.nodes], seen.mounts)
    there = se2.apply(se2.inverse(at)[:, None], field.positions)  # (k, m, 2)
    distance = np.maximum(np.hypot(there[..., 0], there[..., 1]), 1e-6)
    bearing = np.arctan2(there[..., 1], there[..., 0])
    error = undistorted[:, None] - np.stack([distance, bearing], axis=-1)
    error[..., 1] = se2.wrap(error[..., 1])
    by_point = polar_jacobian(there)
    by_pose = by_point @ point_by_tangent(there) @ se2.adjoint(se2.inverse(seen.mounts))[:, None]
    by_place = by_point @ np.swapaxes(se2.rotation(at[:, 2]), -1, -2)[:, None]
    whole = (seen.covariance + seen.shared[:, :, None] ** 2 * np.eye(2))[:, None]
    whole = whole + propagate(by_pose, covariances[seen.nodes][:, None])
    whole = whole + propagate(by_place, field.positions_covariance)
    misfit = squared_mahalanobis(error, whole)
    may = (seen.landmarks[:, None] < 0) | (seen.landmarks[:, None] == np.arange(len(field.landmarks)))
    misfit = np.where(may, misfit, np.inf)
    best = np.argmin(misfit, axis=1)
    rows = np.arange(len(best))
    least = misfit[rows, best]
    misfit[rows, best] = np.inf
    return np.where((least < _GATE) & (misfit.min(axis=1) > least + _CLEARER), best, -1)


def polar_jacobian(points: FloatArray) -> FloatArray:
    """(..., 2, 2): change of range and bearing with a point (..., 2) in the sensor's frame."""
    x, y = points[..., 0], points[..., 1]
    d = np.maximum(np.hypot(x, y), 1e-6)
    return np.stack([np.stack([x / d, y / d], axis=-1), np.stack([-y / d**2, x / d**2], axis=-1)], axis=-2)


def point_by_tangent(points: FloatArray) -> FloatArray:
    """(..., 2, 3): change of a point (..., 2) in a frame with that frame's tangent."""
    out = np.zeros((*points.shape[:-1], 2, 3))
    out[..., 0, 0] = out[..., 1, 1] = -1.0
    out[..., 0, 2], out[..., 1, 2] = points[..., 1], -points[..., 0]
    return out


def _ages_s(things: IntArray, stamps_s: FloatArray) -> FloatArray:
    """(k,) seconds since the same thing was last seen, infinity at first."""
    order = np.lexsort((stamps_s, things))
    ages = np.full(len(things), np.inf)
    again = np.flatnonzero(np.diff(things[order]) == 0) + 1
    ages[order[again]] = stamps_s[order[again]] - stamps_s[order[again - 1]]
    return ages


def _widths(age_s: FloatArray, correlation: ErrorCorrelation) -> FloatArray:
    """(k, 2) of range and bearing."""
    return np.stack([inflation(age_s, correlation.range_s), inflation(age_s, correlation.bearing_s)], axis=-1)
