"""Measurements and a map to mixtures: all that each of them can mean, whatever is known of the robot's place."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.heading_mixture import heading_mixture
from fieldloc.image_mixture import image_mixture
from fieldloc.magnitudes import check_magnitudes
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Observation
from fieldloc.mixture import MixtureFactor
from fieldloc.mount_correction import MountCorrection
from fieldloc.mount_learning import LearnedMount
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere
from fieldloc.repeated_mixture import RepeatedMixture
from fieldloc.repetition import ErrorCorrelation, Repetition, inflation
from fieldloc.scan_coverage import Misses, Sightings
from fieldloc.scan_distortion import KNOWN, DistortionPrior
from fieldloc.scan_mixture import ScanMixture, scan_mixture
from fieldloc.scan_noise import UNLEARNED, NoisePrior
from fieldloc.scan_noises import LearnedNoise, ScanNoises
from fieldloc.scan_wrong import WrongShare
from fieldloc.tempering import tempered
from fieldloc.told_mixture import told_mixture

_DEFAULT_CORRELATION = ErrorCorrelation()
_DEFAULT_DETECTION = Detection()
_AS_LOGGED = MountCorrection()
_MOUNTS = 16
_NO_NEWS = 0.01  # share of it
_ANY_IMAGE, _COMPASS = -1, -2  # beside the map's indices


class MixtureBuilder:
    """One for a log: knows the map and the camera, remembers what was seen lately, counts what it could not use."""

    def __init__(
        self,
        field: FieldMap,
        camera: Camera | None = None,
        correlation: ErrorCorrelation = _DEFAULT_CORRELATION,
        detection: Detection = _DEFAULT_DETECTION,
        mount: MountCorrection = _AS_LOGGED,
        noise: NoisePrior = UNLEARNED,
        distortion: DistortionPrior = KNOWN,
    ) -> None:
        self._field = field
        self._camera = None if camera is None else mount.camera(camera)
        self._correlation = correlation
        self._detection = detection
        self._mount = mount
        self._learned_mount = None if self._camera is None else LearnedMount(self._camera, field, correlation.image_s)
        self._area_m2 = float(np.exp(anywhere(field).log_volume)) / (2 * np.pi)
        self._repetition = Repetition()
        self._noises = ScanNoises(noise, distortion, correlation)
        self._sightings: dict[bytes, Sightings] = {}  # by where the sensor is mounted
        self._last_scan_ns: int | None = None
        self._wrong = WrongShare()
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

    def scan_noises(self) -> tuple[LearnedNoise, ...]:
        """How noisy the scans of each sensor have turned out to be."""
        return self._noises.learned()

    def build(self, measurement: Observation) -> MixtureFactor | None:
        """None for what says nothing: no landmark of the map, no line, no camera. ValueError for what no arithmetic can
        use."""
        check_magnitudes(measurement)
        stamp_ns = measurement.stamp_ns
        match measurement:
            case LandmarkScan():
                self._count_unknown(measurement.labels)
                return self._scan(measurement)
            case ImageFeatures():
                if self._camera is None:
                    self._images_without_camera += 1
                    return None
                self._count_unknown(post.label for post in measurement.posts)
                return self._image(measurement, self._camera)
            case Compass():
                wider = self._wider(_COMPASS, stamp_ns, self._correlation.compass_s)
                return heading_mixture(measurement, wider, self._area_m2)
            case InitialPose():
                pose, covariance = measurement.pose, measurement.covariance
                return told_mixture(stamp_ns, pose, covariance, self._detection.nothing_right, anywhere(self._field))

    def remember(
        self,
        measurement: Observation,
        mixture: MixtureFactor,
        pose: FloatArray | None,
        covariance: FloatArray | None = None,
    ) -> None:
        """What was seen, by where the robot (3,) is thought to be now: seen again soon, it is little news.

        mixture: what `build` made of the measurement. covariance: (3, 3) of the pose, robot frame, if the robot is
        surely there: then the camera's mount is learned from.
        """
        if pose is not None and not np.isfinite(pose).all():
            pose = None
        match measurement:
            case LandmarkScan() if isinstance(mixture, ScanMixture) and pose is not None:
                seen = mixture.landmarks_seen(pose)
                for index in seen:
                    self._repetition.see(index, mixture.stamp_ns)
                self._wrong.count(wrong=not seen)
                self._noises.learn(mixture, pose)
            case Compass() if pose is not None:  # a heading alone is lost on a robot that knows nothing
                self._repetition.see(_COMPASS, mixture.stamp_ns)
            case ImageFeatures():
                self._repetition.see(_ANY_IMAGE, mixture.stamp_ns)
                if self._learned_mount is not None and pose is not None and covariance is not None:
                    self._learned_mount.learn(self._mounted(measurement), pose, covariance)

    def relearned(self, mixture: MixtureFactor) -> MixtureFactor:
        """One that was built here, with what has been learned of its sensor since."""
        if not isinstance(mixture, ScanMixture):
            return mixture
        return mixture.relearned(*self._noises.of(mixture.scan))

    def _scan(self, scan: LandmarkScan) -> ScanMixture | None:
        wider = self._wider_landmarks(scan.stamp_ns)
        noise, distortion = self._noises.of(scan)
        again = self._noises.wider_shared(scan)
        sightings = self._of_sensor(scan)
        sector = None if sightings is None else sightings.sector
        detection = self._detection
        if (wrong := self._wrong.share(detection.nothing_right)) > detection.nothing_right:
            detection = replace(detection, nothing_right=wrong)
        misses = self._misses(scan)
        mixture = scan_mixture(scan, self._field, detection, wider, misses, noise, again, sector, distortion)
        if mixture is not None and sightings is not None:
            sightings.see(mixture.scan.range_bearing)
        self._last_scan_ns = scan.stamp_ns
        return mixture

    def _misses(self, scan: LandmarkScan) -> Misses | None:
        sightings = self._of_sensor(scan)
        if sightings is None or (coverage := sightings.coverage) is None or not np.isfinite(scan.range_bearing).all():
            return None
        age_s = math.inf if self._last_scan_ns is None else max(scan.stamp_ns - self._last_scan_ns, 0) * 1e-9
        news = 1.0 / inflation(np.array(age_s), self._correlation.hidden_s)
        return Misses(coverage, float(news), scan.range_bearing) if news > _NO_NEWS else None

    def _of_sensor(self, scan: LandmarkScan) -> Sightings | None:
        """None for one that is never mounted in the same way for long: what it covers is not known."""
        mount = scan.robot_from_sensor.tobytes()
        if mount not in self._sightings:
            if len(self._sightings) == _MOUNTS:
                return None
            self._sightings[mount] = Sightings(self._field, self._detection.landmark)
        return self._sightings[mount]

    def _image(self, features: ImageFeatures, camera: Camera) -> MixtureFactor | None:
        wider = self._wider(_ANY_IMAGE, features.stamp_ns, self._correlation.image_s)
        features = self._mounted(features)
        if self._learned_mount is not None:
            features = replace(features, mount=self._learned_mount.applied(features.mount))
        once = image_mixture(features, camera, self._field, self._detection)
        if once is None or wider == 1.0:
            return once
        return RepeatedMixture(tempered(once, wider), once, wider, float(np.log(2 * np.pi * self._area_m2)))

    def _mounted(self, features: ImageFeatures) -> ImageFeatures:
        """As the settings know the camera's mount, beside what is learned of it."""
        return replace(features, mount=self._mount.applied(features.mount))

    def _count_unknown(self, labels: Iterable[str | None]) -> None:
        self._unknown.update(label for label in labels if label is not None and self._field.index_of(label) is None)

    def _wider(self, thing: int, stamp_ns: int, correlation_s: float) -> float:
        return float(inflation(np.array(self._repetition.age_s(thing, stamp_ns)), correlation_s))

    def _wider_landmarks(self, stamp_ns: int) -> FloatArray:
        """(m, 2) by how much to widen the variances of range and bearing of each landmark on the map."""
        age_s = self._repetition.ages_s(len(self._field.landmarks), stamp_ns)
        out = np.empty((len(age_s), 2))
        out[:, 0] = inflation(age_s, self._correlation.range_s)
        out[:, 1] = inflation(age_s, self._correlation.bearing_s)
        return out
