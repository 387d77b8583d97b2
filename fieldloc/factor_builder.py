"""Measurements and a map to factors: an analytic fix where there is one, the observations themselves where not."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.association import Belief, seen_in_robot
from fieldloc.camera import Camera
from fieldloc.choice import choose_fix
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap
from fieldloc.fixes.landmarks import LandmarkFix, landmark_fix
from fieldloc.identification import identify
from fieldloc.image_factors import image_factors
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan
from fieldloc.repetition import ErrorCorrelation, Repetition, inflation

_MAX_NONLINEARITY = 0.5  # beyond it a fix's Gaussian is not one, see LandmarkFix
# chance of a good scan to fail is one in ten thousand: chi-square at 2n - 3 degrees of freedom for n = 2, 3, ...
_CHI2_LIMITS = (15.14, 21.11, 25.74, 29.88, 33.72, 37.37, 40.87, 44.26)

_DEFAULT_CORRELATION = ErrorCorrelation()
_ANY_IMAGE = -1  # beside the map's indices


class FactorBuilder:
    """One for a log: knows the map and the camera, counts what it could not use."""

    def __init__(
        self, field: FieldMap, camera: Camera | None = None, correlation: ErrorCorrelation = _DEFAULT_CORRELATION
    ) -> None:
        self._correlation = correlation
        self._repetition = Repetition()
        self._field = field
        self._camera = camera
        self._unknown: Counter[str] = Counter()
        self._images_without_camera = 0

    def warnings(self) -> tuple[str, ...]:
        """What could not be used so far."""
        out = []
        if self._unknown:
            labels = ", ".join(sorted(self._unknown))
            count = self._unknown.total()
            out.append(f"{count} observations left out: landmark {labels} is not on the map {self._field.name}")
        if self._images_without_camera:
            out.append(f"{self._images_without_camera} images left out: the log says nothing about the camera")
        return tuple(out)

    def build(
        self, measurement: LandmarkScan | ImageFeatures | Compass | InitialPose, belief: Belief | None
    ) -> tuple[Factor, ...]:
        """The factors of one measurement, of errors independent of each other.

        belief: where the robot is thought to be at that moment; with it landmarks without a label find theirs.
        """
        match measurement:
            case LandmarkScan():
                self._count_unknown(measurement.labels)
                return self._scan(measurement, belief)
            case ImageFeatures():
                if self._camera is None:
                    self._images_without_camera += 1
                    return ()
                self._count_unknown(post.label for post in measurement.posts)
                return self._image(measurement, self._camera, belief)
            case Compass():
                variance = np.array([[measurement.sigma_rad**2]])
                return (HeadingFactor(measurement.stamp_ns, measurement.heading_rad, variance),)
            case InitialPose():
                turned = se2.rotate_covariance(measurement.covariance, -measurement.pose[2])
                return (PoseFactor(measurement.stamp_ns, measurement.pose, turned),)

    def _count_unknown(self, labels: Iterable[str | None]) -> None:
        self._unknown.update(label for label in labels if label is not None and self._field.index_of(label) is None)

    def _scan(self, scan: LandmarkScan, belief: Belief | None) -> tuple[Factor, ...]:
        on_map = identify(scan, self._field, belief)
        rows = [i for i, index in enumerate(on_map) if index is not None]
        indices = [index for index in on_map if index is not None]
        scan = self._widened(scan, rows, indices)
        while len(rows) >= 2:
            fix = self._fix(scan, rows, indices, belief)
            if fix is None or fix.nonlinearity > _MAX_NONLINEARITY:
                break
            if fix.chi2 < _CHI2_LIMITS[min(len(rows) - 2, len(_CHI2_LIMITS) - 1)]:
                return (PoseFactor.from_fix(scan.stamp_ns, fix),)
            if len(rows) == 2:  # one is wrong, but which?
                break
            worst = int(np.argmax(fix.chi2_each))
            del rows[worst], indices[worst]
        return self._landmarks(scan, rows, indices)

    def _widened(self, scan: LandmarkScan, rows: Sequence[int], indices: Sequence[int]) -> LandmarkScan:
        """The scan with the covariance of what was seen just before made as wide as it is old news."""
        age_s = np.full(len(scan.labels), np.inf)
        age_s[rows] = [self._repetition.age_s(index, scan.stamp_ns) for index in indices]
        for index in indices:
            self._repetition.see(index, scan.stamp_ns)
        by_range = np.sqrt(inflation(age_s, self._correlation.range_s))
        by_bearing = np.sqrt(inflation(age_s, self._correlation.bearing_s))
        scale = np.stack([by_range, by_bearing], axis=-1)
        return replace(scan, covariance=scan.covariance * scale[:, :, None] * scale[:, None, :])

    def _image(self, features: ImageFeatures, camera: Camera, belief: Belief | None) -> tuple[Factor, ...]:
        factors = image_factors(features, camera, self._field, belief)
        if not factors:
            return ()
        age_s = np.array(self._repetition.age_s(_ANY_IMAGE, features.stamp_ns))
        self._repetition.see(_ANY_IMAGE, features.stamp_ns)
        wider = float(inflation(age_s, self._correlation.image_s))
        return tuple(replace(factor, covariance=factor.covariance * wider) for factor in factors)

    def _fix(
        self, scan: LandmarkScan, rows: Sequence[int], indices: Sequence[int], belief: Belief | None
    ) -> LandmarkFix | None:
        fixes = landmark_fix(
            self._field.positions[indices],
            scan.range_bearing[rows],
            scan.covariance[rows],
            self._field.positions_covariance[indices],
            scan.robot_from_sensor,
        )
        return fixes[0] if len(fixes) == 1 else choose_fix(scan.stamp_ns, fixes, belief)

    def _landmarks(self, scan: LandmarkScan, rows: Sequence[int], indices: Sequence[int]) -> tuple[Factor, ...]:
        seen, covariance = seen_in_robot(scan)
        # the map's error turns with the unknown heading: its largest in all directions
        survey = np.linalg.eigvalsh(self._field.positions_covariance[indices])[:, -1]
        return tuple(
            LandmarkFactor(scan.stamp_ns, self._field.positions[index], seen[row], covariance[row] + s * np.eye(2))
            for row, index, s in zip(rows, indices, survey, strict=True)
        )
