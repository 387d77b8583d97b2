"""A scan of landmarks as a mixture: which of the map's each of them may be.

    p(scan | pose) = right * sum over one-to-one assignments of the product over its landmarks of
                         clutter * u                                 if it is none of the map's
                         (1 - clutter) / m * N(range, bearing)       if it is that one of the m that it may be
                     + (1 - right) * product of u

with u the density of a thing that may be anywhere: alike over all bearings, and over ranges up to the map's diagonal;
once it is known where the sensor sees things at all, alike over that. Once it is known what it covers, each assignment
also has the probability that of the landmarks covered just the others are not seen; what is all clutter or not right
has that of a robot that may be anywhere.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.factors import Factor, PoseFactor, sighted
from fieldloc.field import FieldMap
from fieldloc.fixes.landmarks import LandmarkFix
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import Expansion, IntArray, PoseSolutions
from fieldloc.one_pose import composed
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere
from fieldloc.scan_assignments import likeliest
from fieldloc.scan_constants import frames_of, on_map_of
from fieldloc.scan_coverage import Misses
from fieldloc.scan_distortion import PERFECT, ScanDistortion
from fieldloc.scan_expansion import expand
from fieldloc.scan_factors import landmark_factors
from fieldloc.scan_fits import CHI2_LIMITS, Fits, whole_poses
from fieldloc.scan_fix import scan_fixes, scan_misfit
from fieldloc.scan_likelihood import log_sum
from fieldloc.scan_model import ScanModel
from fieldloc.scan_moments import determinant, upper
from fieldloc.scan_noise import AS_STATED, ScanNoise
from fieldloc.scan_wrong import Sector

_ANY, _NONE = -1, -2  # instead of a landmark's index: it has no label, or one that is not on the map
_RING_STEPS = 24
_MAX_NONLINEARITY = 0.5  # beyond it a fix's Gaussian is not one, see LandmarkFix


@dataclass(frozen=True, eq=False)
class ScanMixture:
    """scan: its landmarks that can be of the map. log_right: prior of a scan that is right, times the density of all
    landmarks as clutter. misses: None where it is not known what the sensor covers. measured: (n, 2) ranges and
    bearings as the log has them; `scan` has them without their distortion."""

    stamp_ns: int
    scan: LandmarkScan
    field_map: FieldMap
    model: ScanModel
    log_right: float
    log_outlier: float
    symmetric: bool
    measured: FloatArray
    misses: Misses | None = None
    by_compass: bool = False
    by_sight: bool = True
    _ids: dict[bytes, int] = field(default_factory=dict, init=False)
    _matches: list[IntArray] = field(default_factory=list, init=False)

    def solutions(self) -> PoseSolutions:
        return self._solutions

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        frames = frames_of(*self.scan.robot_from_sensor.tolist())
        at, spread = poses, covariances
        if frames is not None:
            mount = self.scan.robot_from_sensor
            at = composed(poses[0], mount)[None] if len(poses) == 1 else se2.compose(poses, mount)
            spread = frames.to_sensor @ covariances @ frames.to_sensor.T
        seen, matches = expand(self.model, at, spread)
        log_more: FloatArray | float
        if len(poses) == 1 and len(matches) == 1:
            log_more = self.log_right + self._log_missed_alone(at[0], seen, matches[0])
        else:
            log_more = self._log_more(at, seen, matches)
        out = seen.likelier(log_more, self._intern(matches))
        return out if frames is None else out.of(frames.to_sensor, frames.to_robot, covariances)

    def _log_more(self, at: FloatArray, seen: Expansion, matches: IntArray) -> FloatArray | float:
        """(c,) what is to be said of solutions near poses (h, 3) of the sensor beside what `seen` says."""
        log_more: FloatArray | float = self.log_right
        if self.misses is not None and len(matches):
            # where they lead, by steps that are taken straight; the constants are its own, its steps are kept as found
            step, there = seen.step, at[seen.parent]
            c, s = np.cos(there[:, 2]), np.sin(there[:, 2])
            there[:, 0] += c * step[:, 0] - s * step[:, 1]
            there[:, 1] += s * step[:, 0] + c * step[:, 1]
            there[:, 2] += step[:, 2]
            log_more = log_more + self._log_missed(there, seen.updated, matches)
        if (repeated := 1.0 - self.model.news(matches)) > 0.0:
            # what it may be was chosen from when it was seen before: that there is much to choose from is no news again
            log_more = log_more - repeated * _choice(seen.parent, seen.evidence + log_more, len(at))
        return log_more

    def _log_missed_alone(self, at: FloatArray, seen: Expansion, matches: IntArray) -> float:
        """As `_log_missed`, of the only solution from the only pose (3,), where it leads."""
        if self.misses is None:
            return 0.0
        (x, y, heading), (forward, left, turn) = at.tolist(), seen.step[0].tolist()
        c, s = math.cos(heading), math.sin(heading)
        there = x + c * forward - s * left, y + s * forward + c * left, heading + turn
        (xx, _, _), (_, yy, _), (_, _, hh) = seen.updated[0].tolist()
        return self.misses.log_missed_alone(there, xx + yy, hh, set(matches.tolist()))

    def relearned(self, noise: ScanNoise, distortion: ScanDistortion) -> "ScanMixture":
        """The same with what has been learned of the sensor since; its solutions keep their ids."""
        seen = distortion.removed(self.measured)
        own, shared = noise.of(self.scan.covariance)
        out = replace(
            self,
            scan=replace(self.scan, range_bearing=seen),
            model=replace(self.model, range_bearing=seen, covariance=own, shared=shared),
        )
        out._ids.update(self._ids)
        out._matches.extend(self._matches)
        return out

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        at = se2.compose(poses.reshape(-1, 3), self.scan.robot_from_sensor)
        wrong = self.log_outlier - self.log_right  # with all clutter in it
        return np.asarray((self.log_right + log_sum(self.model, at, wrong, self.misses)).reshape(poses.shape[:-1]))

    @cached_property
    def log_integral(self) -> float:
        """Lower bound: of `solutions` and what leaves the heading open beside them, and of what explains one landmark
        only. Left out is what explains some, but fewer than `solutions` goes down to."""
        return float(np.logaddexp.reduce([*self._rings().ravel(), *(self._fits.log_weights + self.log_right)]))

    def _log_missed(self, at: FloatArray, spread: FloatArray, matches: IntArray) -> FloatArray | float:
        """(c,) log probability that of what is covered nothing but the matches (c, n) is seen, from the sensor's poses
        (c, 3). Where they lead, not as it changes on the way there: the approximation."""
        if self.misses is None or not len(at):
            return 0.0
        wanted = np.ones((len(at), 1 + self.model.may.shape[1]), dtype=np.bool_)
        wanted[np.arange(len(at))[:, None], matches] = False  # -1 is the last column
        return np.asarray(self.misses.log_missed(at, spread, wanted[:, :-1]).sum(axis=1))

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        """A pose where two or more landmarks determine it, agree, and leave a Gaussian; each by itself else."""
        matches = self.matches(solution)
        rows = np.flatnonzero(matches >= 0)
        which, model, mount = matches[rows], self.model, self.scan.robot_from_sensor
        wider = np.where((matches >= 0)[:, None], model.wider[matches], 1.0)
        repeated = bool((wider > 1.0).any() or (model.wider_shared > 1.0).any())
        if len(rows) >= 2:
            fixes = scan_fixes(model, matches, mount, wider if repeated else None)
            if (
                len(fixes) == 1
                and fixes[0].nonlinearity <= _MAX_NONLINEARITY
                and self._agree(matches, fixes[0], repeated)
            ):
                return (sighted(PoseFactor.from_fix(self.stamp_ns, fixes[0])),)
        root = np.sqrt(wider[rows])
        covariance = model.covariance[rows] * root[:, :, None] * root[:, None, :]
        covariance += (model.shared_widened[rows] ** 2)[:, :, None] * np.eye(2)
        return landmark_factors(self.scan, self.field_map, rows, which, covariance, wider[rows, 0])

    def _agree(self, matches: IntArray, fix: LandmarkFix, repeated: bool) -> bool:
        """Whether landmarks (n,) agree on a fix, by errors that are not widened."""
        limit = CHI2_LIMITS[min(int((matches >= 0).sum()) - 2, len(CHI2_LIMITS) - 1)]
        if not repeated:
            return bool(fix.chi2 < limit)
        mount = self.scan.robot_from_sensor
        if scan_misfit(self.model, matches, mount, fix.pose) < limit:
            return True  # its own best fits better still
        return any(narrow.chi2 < limit for narrow in scan_fixes(self.model, matches, mount, None))

    def matches(self, solution: int) -> IntArray:
        """(n,) per landmark of `scan` the index of the map's in the solution of that id, -1 where it is none."""
        return self._matches[solution]

    def landmarks_seen(self, pose: FloatArray) -> tuple[int, ...]:
        """Map indices of what was seen, by the likeliest explanation for a robot at the pose (3,)."""
        matches = likeliest(self.model, composed(pose, self.scan.robot_from_sensor))
        return tuple(matches[matches >= 0].tolist())

    def _intern(self, matches: IntArray) -> IntArray:
        """Ids (c,) of assignments (c, n)."""
        out = np.empty(len(matches), dtype=np.intp)
        for row, match in enumerate(matches):
            key = match.tobytes()
            if key not in self._ids:
                self._ids[key] = len(self._matches)
                self._matches.append(match.copy())
            out[row] = self._ids[key]
        return out

    def _rings(self) -> FloatArray:
        """(n, m) log of the integral over poses with one landmark explained: a ring, as far as it is on the field."""
        angle = np.linspace(0.0, 2 * np.pi, _RING_STEPS, endpoint=False)
        on_ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        r = self.model.range_bearing[:, 0]
        places = self.model.positions[:, None] + r[:, None, None, None] * on_ring
        x_min, y_min, x_max, y_max = anywhere(self.field_map).boxes[0]
        x, y = places[..., 0], places[..., 1]
        share = ((x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)).mean(axis=-1)
        with np.errstate(divide="ignore"):
            log_share = np.log(np.where(self.model.may, share, 0.0))
        weights = self.log_right + self.model.log_match - self.model.log_clutter + np.log(2 * np.pi * r)
        if self.misses is not None:
            weights = weights + self.misses.log_anywhere
        return np.asarray(weights[:, None] + log_share)

    @cached_property
    def _fits(self) -> Fits:
        found = whole_poses(self.model)
        if self.misses is None or not len(found.poses):
            return found
        weights = found.log_weights + self._log_missed(found.poses, found.covariances, found.matches)
        return found._replace(log_weights=weights).take(np.argsort(-weights, kind="stable"))

    @cached_property
    def _solutions(self) -> PoseSolutions:
        found = self._fits.take(np.flatnonzero(self._fits.whole))
        if not len(found.poses):
            return PoseSolutions.none()
        poses, covariances = found.poses, found.covariances
        if self.scan.robot_from_sensor.any():
            poses = se2.compose(poses, se2.inverse(self.scan.robot_from_sensor))
            back = se2.adjoint(self.scan.robot_from_sensor)
            covariances = back @ covariances @ back.T
        return PoseSolutions(poses, covariances, found.log_weights + self.log_right, self._intern(found.matches))


def _choice(parent: IntArray, evidence: FloatArray, poses: int) -> FloatArray:
    """(c,) entropy of the choice between the solutions near each of so many poses."""
    best = np.full(poses, -np.inf)
    np.maximum.at(best, parent, evidence)
    above = evidence - best[parent]
    share = np.exp(above)
    total = np.bincount(parent, share, poses)
    mean = np.bincount(parent, share * above, poses) / np.maximum(total, 1e-300)
    return np.asarray((np.log(np.maximum(total, 1e-300)) - mean)[parent])


def scan_mixture(
    scan: LandmarkScan,
    field: FieldMap,
    detection: Detection,
    wider: FloatArray,
    misses: Misses | None = None,
    noise: ScanNoise = AS_STATED,
    wider_shared: FloatArray | None = None,
    sector: Sector | None = None,
    distortion: ScanDistortion = PERFECT,
) -> ScanMixture | None:
    """wider: (m, 2) by how much variances of range and bearing are to be widened, per landmark of the map;
    wider_shared: (2,) the same of what all share, None for not at all. misses, sector: None where it is not known what
    the sensor covers, where it sees anything.

    None where no landmark can be of the map. Left out are landmarks with a label that is not on the map, and numbers
    that no sensor can mean. ValueError for a covariance that is not positive definite.
    """
    on_map = on_map_of(field)
    seen, m = scan.range_bearing, len(field.landmarks)
    index = np.array(
        [_ANY if label is None else on_map.row_of.get(label, _NONE) for label in scan.labels], dtype=np.intp
    )
    good = (index != _NONE) & (seen[:, 0] > 0.0) & np.isfinite(seen).all(axis=1)
    if not m or not good.any():
        return None
    used = scan
    if not good.all():
        rows = np.flatnonzero(good)
        index, labels = index[rows], tuple(scan.labels[row] for row in rows)
        used = LandmarkScan(scan.stamp_ns, labels, seen[rows], scan.covariance[rows], scan.robot_from_sensor)
    covariance = used.covariance
    if not ((determinant(upper(covariance)) > 0.0) & (covariance[:, 0, 0] > 0.0)).all():
        raise ValueError("covariance of a range and bearing is not positive definite")
    measured = used.range_bearing
    if distortion is not PERFECT:
        used = replace(used, range_bearing=distortion.removed(measured))
    own, shared = noise.of(covariance)
    may = (np.arange(m) == index[:, None]) | (index[:, None] == _ANY)
    r = used.range_bearing[:, 0]
    log_anywhere = -math.log(2 * math.pi * max(on_map.diagonal_m, float(r.max())))
    log_wrong = np.full(len(index), log_anywhere)
    if sector is not None:
        log_wrong = sector.log_density(used.range_bearing, log_anywhere)
    log_clutter = math.log(detection.clutter) + log_wrong
    model = ScanModel(
        used.range_bearing,
        own,
        may,
        field.positions,
        field.positions_covariance if on_map.matters(own, r) else None,
        math.log1p(-detection.clutter) - np.log(may.sum(axis=1)),
        log_clutter,
        wider,
        shared,
        np.ones(2) if wider_shared is None else wider_shared,
    )
    symmetric = True
    if len(field.symmetries) and len(named := index[index != _ANY]):
        moved = se2.apply(field.symmetries[:, None], field.positions[named]) - field.positions[named]
        symmetric = not (np.abs(moved) > 1e-6).any()
    log_all_clutter = float(log_clutter.sum())
    return ScanMixture(
        scan.stamp_ns,
        used,
        field,
        model,
        math.log1p(-detection.nothing_right) + log_all_clutter,
        float(
            np.logaddexp(
                math.log(detection.nothing_right) + float(log_wrong.sum()),
                math.log1p(-detection.nothing_right) + log_all_clutter,
            )
            + (0.0 if misses is None else misses.log_anywhere)
        ),
        symmetric=symmetric,
        measured=measured,
        misses=misses,
    )
