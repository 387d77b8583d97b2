"""Where a sensor surely looks, as what it has seen so far tells; and what it says that a landmark there is not seen.

A log says nothing about its sensor's field of view. But wherever the robot was, what was seen was in view: the middle
of the bearings seen is covered, up to the ranges seen, the fringes may be not. Nothing here knows where the robot is.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray, wrap
from fieldloc.regions import anywhere
from fieldloc.scan_wrong import Sector

_ENOUGH = 50  # sightings before anything is said
_GROWTH = 1.2  # times as many, before it is said anew
_KEPT = 4000
# shares of what was seen: outside the outer ones nothing is thought covered, inside the inner ones all is
_BEARINGS = np.array([0.05, 0.2, 0.8, 0.95])
_FARTHEST = np.array([0.4, 0.75])
_NEAREST = np.array([0.15, 0.3])  # of the far end: nearer things are seen better, until they are beneath the sensor
_LEAST = 1e-3  # m and rad: width of a fade
_BODY_M = 0.15  # half width of what hides things behind it, stand and all
_BODY_RAD = 0.03
_PLACES, _SEED = 400, 4

Place = tuple[float, float, float]
"""A pose by plain numbers."""


@dataclass(frozen=True)
class Coverage:
    """middle_rad: of all bearings. bearings_rad, ranges_m: (4,) rising; covered in full between the inner two, less and
    less towards the outer ones; bearings from the middle. detection: probability that a landmark there is seen.
    positions (m, 2), radii_m (m,) of the landmarks; places (k, 3): poses all over the field."""

    middle_rad: float
    bearings_rad: FloatArray
    ranges_m: FloatArray
    detection: float
    positions: FloatArray
    radii_m: FloatArray
    places: FloatArray

    def log_missed(
        self,
        poses: FloatArray,
        covariances: FloatArray | None,
        seen: FloatArray,
        wanted: NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """(h, m) log probability that a landmark is not seen, from the sensor's poses (h, 3) up to covariances of their
        tangents; 0 for what need not be seen. wanted: (h, m) of which it is asked, None for all; 0 for others.

        seen: (n, 2) range and bearing of what hides things, beside the landmarks themselves. An uncertain pose is held
        to what is covered even if it is one sigma off: the approximation, one that says too little.
        """
        dx, dy = (self.positions[:, k] - poses[:, k : k + 1] for k in (0, 1))
        d2 = dx * dx + dy * dy
        d = np.sqrt(d2)
        bearing = _turned(np.arctan2(dy, dx) - (poses[:, 2:] + self.middle_rad))
        off_m: FloatArray | float = 0.0
        off_rad: FloatArray | float = 0.0
        if covariances is not None:
            place = (covariances[:, 0, 0] + covariances[:, 1, 1])[:, None]
            off_m = np.sqrt(place)
            off_rad = np.sqrt(covariances[:, 2, 2, None] + place / np.maximum(d2, 1e-12))
        inside = _inside(d, self.ranges_m, off_m) * _inside(bearing, self.bearings_rad, off_rad)
        if wanted is not None:
            inside *= wanted
        row, landmark = inside.nonzero()
        if not len(row):
            return inside
        covered = inside[row, landmark] * ~self._hidden(row, landmark, d, bearing, seen)
        inside[row, landmark] = np.log1p(-self.detection * covered)
        return inside

    def _hidden(
        self, row: IntArray, landmark: IntArray, d: FloatArray, bearing: FloatArray, seen: FloatArray
    ) -> NDArray[np.bool_]:
        """Which of the landmarks (k,) seen from the rows (k,) of d and bearing (h, m) are behind something."""
        far, at, radius = d[row, landmark, None], bearing[row, landmark, None], self.radii_m[landmark, None]
        by_map = _behind(d[row], bearing[row] - at, far, radius + self.radii_m)
        if not len(seen):
            return by_map
        return by_map | _behind(seen[:, 0], seen[:, 1] - self.middle_rad - at, far, radius)

    def log_missed_alone(
        self, pose: Place, place_m2: float, heading_rad2: float, seen: FloatArray, found: set[int]
    ) -> float:
        """The sum of `log_missed` over all but the landmarks that were found, from one pose of the sensor with these
        variances: by plain numbers, as few of them are where they should be seen."""
        x, y, heading = pose
        low_m, high_m = float(self.ranges_m[0]), float(self.ranges_m[3])
        off_m = math.sqrt(place_m2)
        total = 0.0
        for index, (to_x, to_y, _) in enumerate(self._landmarks):
            if index in found:
                continue
            dx, dy = to_x - x, to_y - y
            d2 = dx * dx + dy * dy
            d = math.sqrt(d2)
            if not low_m + off_m < d < high_m - off_m:
                continue
            bearing = math.remainder(math.atan2(dy, dx) - heading - self.middle_rad, math.tau)
            off_rad = math.sqrt(heading_rad2 + place_m2 / max(d2, 1e-12))
            covered = _inside_alone(d, self._borders[0], off_m) * _inside_alone(bearing, self._borders[1], off_rad)
            if covered > 0.0 and not self._hides(index, d, bearing, pose, seen):
                total += math.log1p(-self.detection * covered)
        return total

    def _hides(self, landmark: int, far_m: float, bearing_rad: float, pose: Place, seen: FloatArray) -> bool:
        """As `_hidden`, of one landmark from one pose."""
        x, y, heading = pose
        own_m = _BODY_M + self._landmarks[landmark][2]
        for near_m, at in seen.tolist():
            aside = math.remainder(at - self.middle_rad - bearing_rad, math.tau)
            if near_m < far_m and abs(aside) * near_m < own_m + _BODY_RAD * near_m:
                return True
        for other, (to_x, to_y, radius_m) in enumerate(self._landmarks):
            dx, dy = to_x - x, to_y - y
            near_m = math.sqrt(dx * dx + dy * dy)
            if near_m < far_m and other != landmark:
                at = math.atan2(dy, dx) - heading - self.middle_rad
                if abs(math.remainder(at - bearing_rad, math.tau)) * near_m < own_m + radius_m + _BODY_RAD * near_m:
                    return True
        return False

    @cached_property
    def _landmarks(self) -> list[tuple[float, float, float]]:
        """x, y and radius of each."""
        rows = zip(self.positions.tolist(), self.radii_m.tolist(), strict=True)
        return [(x, y, radius_m) for (x, y), radius_m in rows]

    @cached_property
    def _borders(self) -> tuple[list[float], list[float]]:
        return self.ranges_m.tolist(), self.bearings_rad.tolist()

    @cached_property
    def anywhere(self) -> FloatArray:
        """(k,) log probability that from places all over the field nothing is seen of what is covered."""
        return np.asarray(self.log_missed(self.places, None, np.zeros((0, 2))).sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Misses:
    """What one scan says by what it does not show. power: share of it that is news, as the scan before missed much the
    same. seen: (n, 2) its ranges and bearings."""

    coverage: Coverage
    power: float
    seen: FloatArray

    def log_missed(
        self, poses: FloatArray, covariances: FloatArray | None = None, wanted: NDArray[np.bool_] | None = None
    ) -> FloatArray:
        """(h, m) as Coverage.log_missed."""
        return self.power * self.coverage.log_missed(poses, covariances, self.seen, wanted)

    def log_missed_alone(self, pose: Place, place_m2: float, heading_rad2: float, found: set[int]) -> float:
        """As Coverage.log_missed_alone."""
        return self.power * self.coverage.log_missed_alone(pose, place_m2, heading_rad2, self.seen, found)

    @property
    def log_anywhere(self) -> float:
        """Of all that is covered, for a robot that may be anywhere."""
        every = self.power * self.coverage.anywhere
        most = float(every.max())
        return most + math.log(float(np.exp(every - most).mean()))


class Sightings:
    """All that one sensor has seen lately, by range and bearing only."""

    def __init__(self, field: FieldMap, detection: float) -> None:
        self._positions = field.positions
        self._radii_m = np.array([0.5 * landmark.diameter_m for landmark in field.landmarks])
        self._detection = detection
        self._places = _places(field)
        self._seen: list[FloatArray] = []
        self._count = self._next = 0
        self._coverage: Coverage | None = None
        self._sector: Sector | None = None

    @property
    def coverage(self) -> Coverage | None:
        """None until enough was seen."""
        return self._coverage

    @property
    def sector(self) -> Sector | None:
        """None until something was seen."""
        return self._sector

    def see(self, range_bearing: FloatArray) -> None:
        """(n, 2), finite."""
        self._seen.append(range_bearing)
        self._count += len(range_bearing)
        if not self._count or self._count < (self._next if self._coverage else min(self._next, _ENOUGH)):
            return
        self._next = int(np.ceil(_GROWTH * self._count))
        every = np.concatenate(self._seen)
        if len(every) > _KEPT:
            every = every[-_KEPT:]
            self._seen = [every]
        self._sector = Sector.of(every)
        if self._count < _ENOUGH:
            return
        bearings = every[:, 1]
        middle = float(np.arctan2(np.sin(bearings).mean(), np.cos(bearings).mean()))
        far = np.quantile(every[:, 0], _FARTHEST)
        self._coverage = Coverage(
            middle,
            np.quantile(wrap(bearings - middle), _BEARINGS),
            np.append(_NEAREST * far[0], far),
            self._detection,
            self._positions,
            self._radii_m,
            self._places,
        )


def _behind(near_m: FloatArray, aside_rad: FloatArray, far_m: FloatArray, radii_m: FloatArray) -> NDArray[np.bool_]:
    """(k,) whether what is far_m (k, 1) away has something before it."""
    wide = _BODY_M + radii_m + _BODY_RAD * near_m
    return np.asarray(((near_m < far_m) & (np.abs(_turned(aside_rad)) * near_m < wide)).any(axis=1))


def _turned(angle_rad: FloatArray) -> FloatArray:
    """In [-pi, pi], faster than `wrap`."""
    return np.asarray(angle_rad - 2 * np.pi * np.rint(angle_rad * (0.5 / np.pi)))


def _inside(value: FloatArray, border: FloatArray, off: FloatArray | float) -> FloatArray:
    """Between 0 and 1, linear from border to border (4,), for values that may be that far off to either side."""
    low, in_low, in_high, high = border.tolist()
    rising = (value - (low + off)) * (1.0 / max(in_low - low, _LEAST))
    falling = ((high - off) - value) * (1.0 / max(high - in_high, _LEAST))
    return np.asarray(np.minimum(np.maximum(np.minimum(rising, falling), 0.0), 1.0))


def _inside_alone(value: float, border: list[float], off: float) -> float:
    """As `_inside`, of one."""
    low, in_low, in_high, high = border
    rising = (value - (low + off)) * (1.0 / max(in_low - low, _LEAST))
    falling = ((high - off) - value) * (1.0 / max(high - in_high, _LEAST))
    return min(max(min(rising, falling), 0.0), 1.0)


def _places(field: FieldMap) -> FloatArray:
    """(k, 3), the same for the same field."""
    random = np.random.default_rng(_SEED)
    x_min, y_min, x_max, y_max = anywhere(field).boxes[0]
    return random.uniform([x_min, y_min, -np.pi], [x_max, y_max, np.pi], (_PLACES, 3))
