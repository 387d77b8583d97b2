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
_LOG_TWO_PI = float(np.log(2 * np.pi))
_NEAREST_M = 1e-6  # on the landmark any direction will do


class Pairs(NamedTuple):
    """Observations and landmarks that may belong together, in order of pose and observation, (k,) each.

    error (k, 2), jacobian (k, 2, 3), covariance (k, 2, 2): landmark less where it was seen, metres, sensor's frame.
    log_peak: density of range and bearing without an error, relative to clutter, by the covariance that is not widened,
    and divided by that of the error here: minus half a log determinant of the error's, and it is a density again.
    """

    pose: IntArray
    row: IntArray
    landmark: IntArray
    error: FloatArray
    jacobian: FloatArray
    covariance: FloatArray
    log_peak: FloatArray


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

    def near(self, poses: FloatArray, covariances: FloatArray) -> BoolArray:
        """(h, n, m): what may be what for robots about the poses (h, 3), by errors that are not widened."""
        x, y = self._landmarks_from(poses)
        pxx, pxy, pxh, pyy, pyh, phh = _upper(covariances[:, None])
        xx = pxx - 2.0 * y * pxh + y * y * phh
        xy = pxy - y * pyh + x * pxh - x * y * phh
        yy = pyy + 2.0 * x * pyh + x * x * phh
        if self.survey is not None:
            sxx, sxy, syy = _turned(self.survey, poses[:, 2:])
            xx, xy, yy = xx + sxx, xy + sxy, yy + syy
        seen, along, across, mixed = self._points
        ex, ey = x[:, None] - seen[:, :1], y[:, None] - seen[:, 1:]
        # a bearing's error counts by the true range where the seen one fell short
        far = np.maximum(np.hypot(x, y)[:, None], self.range_bearing[:, :1])
        far2 = far * far
        xx = xx[:, None] + along[0] + far * mixed[0] + far2 * across[0]
        xy = xy[:, None] + along[1] + far * mixed[1] + far2 * across[1]
        yy = yy[:, None] + along[2] + far * mixed[2] + far2 * across[2]
        return np.asarray((yy * ex - 2.0 * xy * ey) * ex + xx * ey * ey < GATE * (xx * yy - xy * xy)) & self.may

    def widening(self, near: BoolArray) -> FloatArray:
        """(n, 2) by how much to widen what was seen: as the longest known of the landmarks that it may be from here.

        The same for all poses, or those would win by and by that see with an error what the robot is not known to see.
        """
        return np.asarray(np.where(np.any(near, axis=0)[..., None], self.wider, 1.0).max(axis=1, initial=1.0))

    def pairs(self, near: BoolArray, poses: FloatArray, wider: FloatArray) -> Pairs:
        """Of (h, n, m), straight about the poses."""
        pose, row, landmark = np.nonzero(near)
        x, y = (part[pose, landmark] for part in self._landmarks_from(poses))
        seen, along, across, mixed = self._points
        r = self.range_bearing[row, 0]
        error = np.stack([x - seen[row, 0], y - seen[row, 1]], axis=-1)
        jacobian = np.zeros((len(row), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = y, -x
        by_range, by_bearing = wider[row].T
        both = np.sqrt(by_range * by_bearing)
        plain, widened = [], []
        survey = (np.zeros(1),) * 3 if self.survey is None else _turned(self.survey[landmark], poses[pose, 2])
        for k in range(3):
            a, c, b = along[k][row, 0], r * mixed[k][row, 0], r * r * across[k][row, 0]
            plain.append(a + b + c + survey[k])
            widened.append(by_range * a + by_bearing * b + both * c + survey[k])
        covariance = np.empty((len(row), 2, 2))
        covariance[:, 0, 0], covariance[:, 1, 1] = widened[0], widened[2]
        covariance[:, 0, 1] = covariance[:, 1, 0] = widened[1]
        log_peak = (self.log_match - self.log_clutter)[row] - _LOG_TWO_PI + np.log(r)
        log_peak -= 0.5 * np.log(
            (plain[0] * plain[2] - plain[1] ** 2) / (widened[0] * widened[2] - widened[1] * widened[1])
        )
        return Pairs(pose, row, landmark, error, jacobian, covariance, log_peak)

    def terms(self, poses: FloatArray, matches: IntArray, wider: FloatArray) -> Terms:
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

    def log_gains(self, poses: FloatArray, row: IntArray, landmark: IntArray, wider: FloatArray) -> FloatArray:
        """(h, k) log density of observations (k,) as landmarks (k,), relative to clutter, at poses (h, 3)."""
        dx, dy = (self.positions[landmark, k] - poses[:, k : k + 1] for k in (0, 1))
        d = np.maximum(np.hypot(dx, dy), _NEAREST_M)
        error_r = d - self.range_bearing[row, 0]
        error_b = wrap(np.arctan2(dy, dx) - poses[:, 2:] - self.range_bearing[row, 1])
        plain, (rr, rb, bb) = self._noise(row, landmark, dx / d, dy / d, d, wider)
        misfit = ((bb * error_r - 2.0 * rb * error_b) * error_r + rr * error_b**2) / (rr * bb - rb * rb)
        peak = (self.log_match - self.log_clutter)[row] - _LOG_TWO_PI - 0.5 * np.log(plain)
        return np.asarray(peak - 0.5 * misfit)

    def _noise(
        self, row: IntArray, landmark: IntArray, ux: FloatArray, uy: FloatArray, d: FloatArray, wider: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """Of range and bearing (...), u the line of sight in the field: determinant as it is, covariance widened."""
        rr, rb, bb = self.covariance[row, 0, 0], self.covariance[row, 0, 1], self.covariance[row, 1, 1]
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
    def _points(self) -> tuple[FloatArray, tuple[FloatArray, ...], tuple[FloatArray, ...], tuple[FloatArray, ...]]:
        """Where landmarks were seen (n, 2), and (xx, xy, yy) of its covariance (n, 1) each: what comes of the range's
        variance, of the bearing's at one metre, and of what they share at one metre."""
        r, b = self.range_bearing.T[..., None]
        c, s = np.cos(b), np.sin(b)
        rr, rb, bb = self.covariance[:, :1, 0], self.covariance[:, :1, 1], self.covariance[:, 1:, 1]
        along = (c * c * rr, c * s * rr, s * s * rr)
        across = (s * s * bb, -c * s * bb, c * c * bb)
        mixed = (-2.0 * c * s * rb, (c * c - s * s) * rb, 2.0 * c * s * rb)
        return np.hstack([r * c, r * s]), along, across, mixed


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
