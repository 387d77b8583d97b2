"""A scan held against a map, in the sensor's frame: what each landmark seen says of a pose if it is this or that.

Arrays over poses (h), observations (n) and landmarks of the map (m). A tangent is that of the sensor's pose. Errors are
each landmark's own, and two that all of a scan share, which are unknowns beside the pose: all ranges too long by so
many standard deviations, all bearings turned by so many.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap
from fieldloc.scan_moments import Upper, determinant, moments, turned, upper_of

BoolArray = NDArray[np.bool_]

GATE = 18.42  # chi-square, 2 degrees of freedom: a right one fails once in ten thousand
NAMED_GATE = 36.0  # one whose label says which it is; what is worth less than clutter then counts as that
_LOG_TWO_PI = float(np.log(2 * np.pi))
_NEAREST_M = 1e-6  # on the landmark any direction will do


class Pairs(NamedTuple):
    """Observations and landmarks that may belong together, in order of pose and observation, (k,) each.

    x, y: where the landmark is, sensor's frame; ex, ey: less where it was seen, metres; xx, xy, yy: covariance of that,
    of its own error, widened. log_peak: log density of range and bearing without an error, relative to clutter, by the
    covariance that is not widened, plus half the log determinant of (xx, xy, yy): less that of the whole error, it is a
    density again. wider: (n, 2) by how much it is widened, None for not at all.
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
    (c, n, 2); weight (c, n, 2, 2): inverse of its covariance, widened. jacobian (c, n, 2, 3), or (c, n, 2, 5) with the
    two shared errors, of unit variance. of_shared: (c, n, 3) what it says of these two by the covariance that is not
    widened, upper triangle; None where nothing is shared.
    """

    log_peak: FloatArray
    error: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    of_shared: FloatArray | None


class Errors(NamedTuple):
    """Of observations as landmarks (k,) at poses (h, 3): range_m and bearing_rad (n, h, k); (ux, uy) the line of sight
    in the field, d the distance, (h, k)."""

    landmarks: IntArray
    ux: FloatArray
    uy: FloatArray
    d: FloatArray
    range_m: FloatArray
    bearing_rad: FloatArray


@dataclass(frozen=True, eq=False)
class ScanModel:
    """range_bearing (n, 2) as LandmarkScan, covariance (n, 2, 2) of each one's own error; may (n, m): which can be
    which, by their labels.

    positions (m, 2), survey (m, 2, 2) of the map, None where it is exact. log_match (n,): logarithm of the prior that
    an observation is of one given landmark of those it may be; log_clutter (n,) of prior and density if it is of none.
    wider (m, 2): by how much variances of range and bearing are widened for each landmark. shared: (n, 2) standard
    deviations in range and bearing of what all share, the same for all bearings; None for nothing. wider_shared: (2,)
    by how much these variances are widened.
    """

    range_bearing: FloatArray
    covariance: FloatArray
    may: BoolArray
    positions: FloatArray
    survey: FloatArray | None
    log_match: FloatArray
    log_clutter: FloatArray
    wider: FloatArray
    shared: FloatArray | None = None
    wider_shared: FloatArray = field(default_factory=lambda: np.ones(2))

    def pairs(self, poses: FloatArray, covariances: FloatArray) -> Pairs:
        """What may be what for robots at poses (h, 3) up to covariances (h, 3, 3), by errors that are not widened."""
        x, y = self._landmarks_from(poses)
        pxx, pxy, pxh, pyy, pyh, phh = upper_of(covariances[:, None])
        xx = pxx + y * (y * phh - 2.0 * pxh)
        xy = pxy - y * pyh + x * pxh - x * y * phh
        yy = pyy + x * (x * phh + 2.0 * pyh)
        if self.survey is not None:
            sxx, sxy, syy = turned(self.survey, poses[:, 2:])
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
        if self.shared is not None:
            seen = self._own[:, row]
        r = seen[2]
        survey = np.zeros((3, 1)) if self.survey is None else np.stack(turned(self.survey[landmark], poses[pose, 2]))
        plain = seen[5:8] + r * (seen[11:14] + r * seen[8:11])
        if self.survey is not None:
            plain += survey
        log_peak = (self.log_match - self.log_clutter - _LOG_TWO_PI)[row] + np.log(r)
        widened = plain
        if wider is not None:
            by_range, by_bearing = wider[row].T
            both = np.sqrt(by_range * by_bearing)
            widened = by_range * seen[5:8] + r * (both * seen[11:14] + r * by_bearing * seen[8:11]) + survey
            log_peak -= 0.5 * np.log(determinant(plain) / determinant(widened))
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

    def news(self, matches: IntArray) -> float:
        """Share of what was seen, on the average, that was not seen before, if it was one of the matches (c, n)."""
        if not self._repeats or not len(matches):
            return 1.0
        row, seen = np.nonzero(matches >= 0)
        wider = np.ones(matches.shape[1])
        np.maximum.at(wider, seen, self.wider[matches[row, seen], 0])
        return float((1.0 / wider).mean())

    def terms(self, poses: FloatArray, matches: IntArray, wider: FloatArray | None) -> Terms:
        """matches: (c, n) landmark of each observation, -1 for none, seen from the poses (c, 3)."""
        matched = matches >= 0
        to = self.positions[matches] - poses[:, None, :2]
        dx, dy = to[..., 0], to[..., 1]
        d = np.maximum(np.hypot(dx, dy), _NEAREST_M)
        bearing = np.arctan2(dy, dx) - poses[:, 2:]
        error = np.empty((*matches.shape, 2))
        error[..., 0], error[..., 1] = d - self.range_bearing[:, 0], wrap(bearing - self.range_bearing[:, 1])
        size = 3 if self.shared is None else 5
        jacobian = np.zeros((*matches.shape, 2, size))
        c, s = np.cos(bearing), np.sin(bearing)
        jacobian[..., 0, 0], jacobian[..., 0, 1] = -c, -s
        jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = s / d, -c / d, -1.0
        every = np.arange(matches.shape[1])
        plain, widened = self._noise(self.covariance, every, matches, dx / d, dy / d, d, wider)
        det = determinant(plain)
        wrr, wrb, wbb = widened
        weight = np.empty((*matches.shape, 2, 2))
        weight[..., 0, 0], weight[..., 1, 1] = wbb, wrr
        weight[..., 0, 1] = weight[..., 1, 0] = -wrb
        weight *= (matched / determinant(widened))[..., None, None]
        of_shared = None
        if self.shared is not None:
            by_range, by_bearing = self.shared.T
            jacobian[..., 0, 3], jacobian[..., 1, 4] = self.shared_widened.T
            rr, rb, bb = plain
            of_shared = np.stack([by_range**2 * bb, -by_range * by_bearing * rb, by_bearing**2 * rr], axis=-1)
            of_shared = of_shared * (matched / det)[..., None]
        peak = self.log_match - self.log_clutter - _LOG_TWO_PI - 0.5 * np.log(det)
        return Terms(np.where(matched, peak, 0.0), error, weight, jacobian, of_shared)

    @cached_property
    def shared_widened(self) -> FloatArray:
        """(n, 2); zeros for nothing."""
        if self.shared is None:
            return np.zeros((len(self.range_bearing), 2))
        return np.asarray(self.shared * np.sqrt(self.wider_shared))

    def near_any(self, poses: FloatArray) -> BoolArray:
        """(n, m): what may be what from one of the poses (h, 3) at least, by errors that are not widened."""
        errors = self.errors(poses, np.arange(len(self.positions)))
        gain = self.log_gains(errors, None, self.whole_covariance)
        peak = self.log_match - self.log_clutter - _LOG_TWO_PI
        best = np.max(gain, axis=1, initial=-np.inf)
        edge = peak - 0.5 * np.log(np.linalg.det(self.whole_covariance)) - 0.5 * self._gates
        return np.asarray(best > edge[:, None]) & self.may

    def errors(self, poses: FloatArray, landmarks: IntArray) -> Errors:
        """Of observations as landmarks (k,), at poses (h, 3)."""
        dx, dy = (self.positions[landmarks, k] - poses[:, k : k + 1] for k in (0, 1))
        d = np.maximum(np.hypot(dx, dy), _NEAREST_M)
        by_bearing = (np.arctan2(dy, dx) - poses[:, 2:]) - self.range_bearing[:, 1:, None]
        by_bearing -= 2 * np.pi * np.rint(by_bearing / (2 * np.pi))
        return Errors(landmarks, dx / d, dy / d, d, d - self.range_bearing[:, :1, None], by_bearing)

    def log_gains(self, errors: Errors, wider: FloatArray | None, covariance: FloatArray) -> FloatArray:
        """(n, h, k) log density of observations as landmarks, relative to clutter, by covariances (n, 2, 2)."""
        plain, (rr, rb, bb) = self.noise_at(errors, wider, covariance)
        error_r, error_b = errors.range_m, errors.bearing_rad
        det = rr * bb - rb * rb
        out = error_r * error_r * (bb / det)
        if rb.any():
            out -= error_r * error_b * (2.0 * rb / det)
        out += error_b * error_b * (rr / det)
        out *= -0.5
        peak = (self.log_match - self.log_clutter - _LOG_TWO_PI)[:, None, None]
        out += peak - 0.5 * np.log(determinant(plain))
        return np.asarray(out)

    def noise_at(self, errors: Errors, wider: FloatArray | None, covariance: FloatArray) -> tuple[Upper, Upper]:
        """Covariances as they are and widened, (n, h, k) or what broadcasts to it."""
        row = np.arange(len(self.range_bearing))[:, None, None]
        return self._noise(covariance, row, errors.landmarks, errors.ux, errors.uy, errors.d, wider)

    def _noise(
        self,
        covariance: FloatArray,
        row: IntArray,
        landmark: IntArray,
        ux: FloatArray,
        uy: FloatArray,
        d: FloatArray,
        wider: FloatArray | None,
    ) -> tuple[Upper, Upper]:
        """Of range and bearing (...), u the line of sight in the field: covariance as it is, and widened."""
        rr, rb, bb = covariance[row, 0, 0], covariance[row, 0, 1], covariance[row, 1, 1]
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
        return (rr, rb, bb), (wrr, wrb, wbb)

    def _landmarks_from(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y (h, m) of the landmarks in the frames of the poses (h, 3)."""
        dx, dy = self.positions[:, 0] - poses[:, :1], self.positions[:, 1] - poses[:, 1:2]
        c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        return c * dx + s * dy, c * dy - s * dx

    @cached_property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Where landmarks were seen (n, 2), sensor's frame, and covariances (n, 2, 2) of that, not widened, up to the
        turn that they share."""
        own = self._own if self.shared is None else moments(self.range_bearing, self._with_shared([1.0, 0.0]))
        r = own[2]
        xx, xy, yy = own[5:8] + r * (own[11:14] + r * own[8:11])
        return own[:2].T, np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)

    @cached_property
    def whole_covariance(self) -> FloatArray:
        """(n, 2, 2) of each by itself, with what it shares."""
        return self.covariance if self.shared is None else self._with_shared([1.0, 1.0])

    def _with_shared(self, share: list[float]) -> FloatArray:
        assert self.shared is not None
        return np.asarray(self.covariance + (self.shared**2 * share)[:, :, None] * np.eye(2))

    @cached_property
    def _gates(self) -> FloatArray:
        return np.where(self.may.sum(axis=1) == 1, NAMED_GATE, GATE)

    @cached_property
    def _repeats(self) -> bool:
        return bool((self.wider > 1.0).any())

    @cached_property
    def _seen(self) -> FloatArray:
        return self._own if self.shared is None else moments(self.range_bearing, self.whole_covariance)

    @cached_property
    def _own(self) -> FloatArray:
        return moments(self.range_bearing, self.covariance)
