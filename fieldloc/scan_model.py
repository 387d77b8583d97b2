"""A scan held against a map, in the sensor's frame: what each landmark seen says of a pose if it is this or that.

Arrays over poses (h), observations (n) and landmarks of the map (m). A tangent is that of the sensor's pose.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap

BoolArray = NDArray[np.bool_]

GATE = 18.42  # chi-square, 2 degrees of freedom: a right one fails once in ten thousand
NAMED_GATE = 36.0  # one whose label says which it is; what is worth less than clutter then counts as that
_LOG_TWO_PI = float(np.log(2 * np.pi))
_NEAREST_M = 1e-6  # on the landmark any direction will do


class Pairs(NamedTuple):
    """Observations and landmarks that may belong together, in order of pose and observation, (k,) each.

    x, y: where the landmark is, sensor's frame; ex, ey: less where it was seen, metres; xx, xy, yy: covariance of that,
    widened. log_peak: log density of range and bearing without an error, relative to clutter, by the covariance that is
    not widened, plus half the log determinant of (xx, xy, yy): less that of the whole error, it is a density again.
    wider: (n, 2) by how much it is widened, None for not at all.
    """

    pose: IntArray
    row: IntArray
    landmark: IntArray
    x: FloatArray
    y: FloatArray
    ex: FloatArray
    ey: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray
    log_peak: FloatArray
    wider: FloatArray | None


class Terms(NamedTuple):
    """Observations, as range and bearing, against one landmark each (c, n); zero where it is none.

    log_peak (c, n): density without an error, relative to clutter, by the covariance that is not widened. error
    (c, n, 2); weight (c, n, 2, 2): inverse of its covariance, widened. jacobian (c, n, 2, 3).
    """

    log_peak: FloatArray
    error: FloatArray
    weight: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True, eq=False)
class ScanModel:
    """range_bearing (n, 2), covariance (n, 2, 2) as LandmarkScan; may (n, m): which can be which, by their labels.

    positions (m, 2), survey (m, 2, 2) of the map, None where it is exact. log_match (n,): logarithm of the prior that
    an observation is of one given landmark of those it may be; log_clutter (n,) of prior and density if it is of none.
    wider (m, 2): by how much variances of range and bearing are widened for each landmark.
    """

    range_bearing: FloatArray
    covariance: FloatArray
    may: BoolArray
    positions: FloatArray
    survey: FloatArray | None
    log_match: FloatArray
    log_clutter: FloatArray
    wider: FloatArray

    def pairs(self, poses: FloatArray, covariances: FloatArray) -> Pairs:
        """What may be what for robots at poses (h, 3) up to covariances (h, 3, 3), by errors that are not widened."""
        x, y = self._landmarks_from(poses)
        pxx, pxy, pxh, pyy, pyh, phh = _upper(covariances[:, None])
        xx = pxx + y * (y * phh - 2.0 * pxh)
        xy = pxy - y * pyh + x * pxh - x * y * phh
        yy = pyy + x * (x * phh + 2.0 * pyh)
        if self.survey is not None:
            sxx, sxy, syy = _turned(self.survey, poses[:, 2:])
            xx, xy, yy = xx + sxx, xy + sxy, yy + syy
        seen_x, seen_y, r, rr, bb = self._seen[:5, :, None]
        # first in a circle as wide as the widest axis at most; a bearing's error counts by the farther of both ranges
        far2 = np.maximum((x * x + y * y)[:, None], r * r)
        apart2 = (x[:, None] - seen_x) ** 2 + (y[:, None] - seen_y) ** 2
        near = (apart2 < self._gates[:, None] * ((xx + yy)[:, None] + rr + far2 * bb)) & self.may
        pose, row, landmark = np.nonzero(near)
        x, y, xx, xy, yy = np.stack([x, y, xx, xy, yy])[:, pose, landmark]
        seen = self._seen[:, row]
        ex, ey = x - seen[0], y - seen[1]
        far = np.sqrt(far2[pose, row, landmark])
        far2 = far * far
        xx = xx + seen[5] + far * seen[11] + far2 * seen[8]
        xy = xy + seen[6] + far * seen[12] + far2 * seen[9]
        yy = yy + seen[7] + far * seen[13] + far2 * seen[10]
        keep = (yy * ex - 2.0 * xy * ey) * ex + xx * ey * ey < self._gates[row] * (xx * yy - xy * xy)
        if not keep.all():
            pose, row, landmark, seen = pose[keep], row[keep], landmark[keep], seen[:, keep]
            x, y, ex, ey = x[keep], y[keep], ex[keep], ey[keep]
        wider = self.widening(row, landmark)
        r = seen[2]
        survey = np.zeros((3, 1)) if self.survey is None else np.stack(_turned(self.survey[landmark], poses[pose, 2]))
        plain = seen[5:8] + r * (seen[11:14] + r * seen[8:11])
        if self.survey is not None:
            plain += survey
        log_peak = (self.log_match - self.log_clutter - _LOG_TWO_PI)[row] + np.log(r)
        widened = plain
        if wider is not None:
            by_range, by_bearing = wider[row].T
            both = np.sqrt(by_range * by_bearing)
            widened = by_range * seen[5:8] + r * (both * seen[11:14] + r * by_bearing * seen[8:11]) + survey
            log_peak -= 0.5 * np.log(_determinant(plain) / _determinant(widened))
        return Pairs(pose, row, landmark, x, y, ex, ey, widened[0], widened[1], widened[2], log_peak, wider)

    def widening(self, row: IntArray, landmark: IntArray) -> FloatArray | None:
        """(n, 2) by how much to widen what was seen: as the longest known of the landmarks that it may be from there;
        None where all is news.

        The same for all poses, or those would win by and by that see with an error what the robot is not known to see.
        """
        if not self._repeats:
            return None
        out = np.ones((len(self.range_bearing), 2))
        np.maximum.at(out, row, self.wider[landmark])
        return out

    def terms(self, poses: FloatArray, matches: IntArray, wider: FloatArray | None) -> Terms:
        """matches: (c, n) landmark of each observation, -1 for none, seen from the poses (c, 3)."""
        matched = matches >= 0
        to = self.positions[matches] - poses[:, None, :2]
        dx, dy = to[..., 0], to[..., 1]
        d = np.maximum(np.hypot(dx, dy), _NEAREST_M)
        bearing = np.arctan2(dy, dx) - poses[:, 2:]
        error = np.empty((*matches.shape, 2))
        error[..., 0], error[..., 1] = d - self.range_bearing[:, 0], wrap(bearing - self.range_bearing[:, 1])
        jacobian = np.zeros((*matches.shape, 2, 3))
        c, s = np.cos(bearing), np.sin(bearing)
        jacobian[..., 0, 0], jacobian[..., 0, 1] = -c, -s
        jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = s / d, -c / d, -1.0
        every = np.arange(matches.shape[1])
        plain, (wrr, wrb, wbb) = self._noise(every, matches, dx / d, dy / d, d, wider)
        weight = np.empty((*matches.shape, 2, 2))
        det = wrr * wbb - wrb * wrb
        weight[..., 0, 0], weight[..., 1, 1] = wbb / det, wrr / det
        weight[..., 0, 1] = weight[..., 1, 0] = -wrb / det
        weight *= matched[..., None, None]
        peak = self.log_match - self.log_clutter - _LOG_TWO_PI - 0.5 * np.log(plain)
        return Terms(np.where(matched, peak, 0.0), error, weight, jacobian)

    def near_any(self, poses: FloatArray) -> BoolArray:
        """(n, m): what may be what from one of the poses (h, 3) at least, by errors that are not widened."""
        gain = self.log_gains(poses, np.arange(len(self.positions)), None)
        peak = self.log_match - self.log_clutter - _LOG_TWO_PI
        det = self.covariance[:, 0, 0] * self.covariance[:, 1, 1] - self.covariance[:, 0, 1] ** 2
        best = np.max(gain, axis=1, initial=-np.inf)
        return np.asarray(best > (peak - 0.5 * np.log(det) - 0.5 * self._gates)[:, None]) & self.may

    def log_gains(self, poses: FloatArray, landmarks: IntArray, wider: FloatArray | None) -> FloatArray:
        """(n, h, k) log density of observations as landmarks (k,), relative to clutter, at poses (h, 3)."""
        dx, dy = (self.positions[landmarks, k] - poses[:, k : k + 1] for k in (0, 1))
        d = np.maximum(np.hypot(dx, dy), _NEAREST_M)
        error_r = d - self.range_bearing[:, :1, None]
        error_b = (np.arctan2(dy, dx) - poses[:, 2:]) - self.range_bearing[:, 1:, None]
        error_b -= 2 * np.pi * np.rint(error_b / (2 * np.pi))
        row = np.arange(len(self.range_bearing))[:, None, None]
        plain, (rr, rb, bb) = self._noise(row, landmarks, dx / d, dy / d, d, wider)
        det = rr * bb - rb * rb
        out = error_r * error_r * (bb / det)
        if rb.any():
            out -= error_r * error_b * (2.0 * rb / det)
        error_b *= error_b
        error_b *= rr / det
        out += error_b
        out *= -0.5
        out += (self.log_match - self.log_clutter - _LOG_TWO_PI)[:, None, None] - 0.5 * np.log(plain)
        return np.asarray(out)

    def _noise(
        self, row: IntArray, landmark: IntArray, ux: FloatArray, uy: FloatArray, d: FloatArray, wider: FloatArray | None
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Of range and bearing (...), u the line of sight in the field: determinant as it is, covariance widened."""
        rr, rb, bb = self.covariance[row, 0, 0], self.covariance[row, 0, 1], self.covariance[row, 1, 1]
        wrr, wrb, wbb = rr, rb, bb
        if wider is not None:
            by_r, by_b = wider[row, 0], wider[row, 1]
            wrr, wrb, wbb = rr * by_r, rb * np.sqrt(by_r * by_b), bb * by_b
        if self.survey is not None:
            flat = self.survey[landmark].reshape(*np.shape(landmark), 4)
            sxx, sxy, syy = flat[..., 0], flat[..., 1], flat[..., 3]
            along = ux * ux * sxx + 2.0 * ux * uy * sxy + uy * uy * syy
            mixed = (ux * uy * (syy - sxx) + (ux * ux - uy * uy) * sxy) / d
            across = (uy * uy * sxx - 2.0 * ux * uy * sxy + ux * ux * syy) / d**2
            rr, rb, bb = rr + along, rb + mixed, bb + across
            wrr, wrb, wbb = wrr + along, wrb + mixed, wbb + across
        return np.asarray(rr * bb - rb * rb), (wrr, wrb, wbb)

    def _landmarks_from(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y (h, m) of the landmarks in the frames of the poses (h, 3)."""
        dx, dy = self.positions[:, 0] - poses[:, :1], self.positions[:, 1] - poses[:, 1:2]
        c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        return c * dx + s * dy, c * dy - s * dx

    @cached_property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Where landmarks were seen (n, 2), sensor's frame, and covariances (n, 2, 2) of that, not widened."""
        seen = self._seen
        r = seen[2]
        xx, xy, yy = seen[5:8] + r * (seen[11:14] + r * seen[8:11])
        return seen[:2].T, np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)

    @cached_property
    def _gates(self) -> FloatArray:
        return np.where(self.may.sum(axis=1) == 1, NAMED_GATE, GATE)

    @cached_property
    def _repeats(self) -> bool:
        return bool((self.wider > 1.0).any())

    @cached_property
    def _seen(self) -> FloatArray:
        """(14, n): where landmarks were seen x, y, range; variances of range and bearing; then (xx, xy, yy) each of
        what comes of the range's variance, of the bearing's at one metre, and of what they share at one metre."""
        r, b = self.range_bearing.T
        c, s = np.cos(b), np.sin(b)
        rr, rb, bb = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        along = [c * c * rr, c * s * rr, s * s * rr]
        across = [s * s * bb, -c * s * bb, c * c * bb]
        mixed = [-2.0 * c * s * rb, (c * c - s * s) * rb, 2.0 * c * s * rb]
        return np.stack([r * c, r * s, r, rr, bb, *along, *across, *mixed])


def _determinant(upper: FloatArray) -> FloatArray:
    xx, xy, yy = upper
    return np.asarray(xx * yy - xy * xy)


def _upper(covariances: FloatArray) -> tuple[FloatArray, ...]:
    """Six numbers (...) of (..., 3, 3)."""
    flat = covariances.reshape(*covariances.shape[:-2], 9)
    return tuple(flat[..., k] for k in (0, 1, 2, 4, 5, 8))


def _turned(covariances: FloatArray, heading_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(xx, xy, yy) of covariances (..., 2, 2) in field axes, in axes turned by the heading (...)."""
    xx, xy, yy = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    cc, cs, ss = c * c, c * s, s * s
    return cc * xx + 2.0 * cs * xy + ss * yy, (cc - ss) * xy + cs * (yy - xx), ss * xx - 2.0 * cs * xy + cc * yy
