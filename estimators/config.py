"""The settings of all estimators in one frozen tree: the defaults, the TOML file, what is stored with results."""

import math
from dataclasses import astuple, dataclass, field

import numpy as np

from fieldloc.detection import Detection
from fieldloc.mount_correction import MountCorrection
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_distortion import DistortionPrior
from fieldloc.scan_noise import NoisePrior


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """How far motion can be from what the odometry says, where its driver does not say so itself.

    Each is the standard deviation after one unit of motion and grows with the square root of it: 0.08 m after 1 m
    forward. Wheels on a hard floor that are told what to do; a robot whose odometry states its covariance does not need
    them.

    They are a first guess: estimators learn by what factors the variances along the way, and of the heading as it turns
    and as it goes, are larger or smaller. log_scale_sigma: standard deviation of their logarithms before a log; 0 takes
    them as known.
    """

    forward_m_per_sqrt_m: float = 0.08
    sideways_m_per_sqrt_m: float = 0.05
    turn_rad_per_sqrt_rad: float = 0.08
    turn_rad_per_sqrt_m: float = 0.05
    idle_m_per_sqrt_s: float = 0.001
    idle_rad_per_sqrt_s: float = 0.001
    max_hold_s: float = 2.0
    """A velocity is believed this long; after it the robot may do anything that the two below allow."""
    silent_m_per_sqrt_s: float = 0.3
    silent_rad_per_sqrt_s: float = 0.5
    log_scale_sigma: float = 1.0


@dataclass(frozen=True, slots=True)
class Robust:
    """How factors that disagree with everything else are taken.

    nis_per_dof: above this many times its expected value a factor counts as a partial outlier; its covariance is
    widened in proportion, so that no factor is ever ignored for good.
    restart_after: this many whole-pose factors in a row that disagree with the estimate and agree with each other
    restart it there: it was wrong, or the robot was carried.
    """

    nis_per_dof: float = 4.0
    restart_after: int = 4

    def trust(self, nis: float, size: int) -> float:
        """Share of a factor of so many numbers that is used: 1, or less the more it disagrees."""
        return min(1.0, self.nis_per_dof * size / max(nis, 1e-300))


@dataclass(frozen=True, slots=True)
class Particles:
    """Monte Carlo localization.

    count, max_count: particles at least, at most; in between as many as keep the Kullback-Leibler distance below
    kld_error with the standard normal's kld_quantile, for bins of bin_m and bin_rad (Fox 2003). outlier_share:
    probability that a plain factor has nothing to do with the pose. negligible: clusters with less of the weight are
    given up. kidnaps_per_min: how often a robot is carried away unnoticed. alpha_slow, alpha_fast: of the long and the
    short average of how well observations are explained; when the short one falls below the long one, that much more is
    a kidnapping to be reckoned with (augmented MCL; 0 leaves it to the rate).
    """

    count: int = 500
    max_count: int = 5000
    outlier_share: float = 0.02
    seed: int = 1
    kld_error: float = 0.05
    kld_quantile: float = 2.33
    bin_m: float = 0.1
    bin_rad: float = 0.1
    negligible: float = 1e-4
    kidnaps_per_min: float = 0.2
    alpha_slow: float = 0.01
    alpha_fast: float = 0.2


@dataclass(frozen=True, slots=True)
class Mixture:
    """The bank of hypotheses.

    max_hypotheses: more are never kept, twins under the map's symmetries not counted. prune_below: hypotheses less
    likely than this are dropped. kidnaps_per_min: how often a robot is carried away unnoticed.
    evidence_share: what a scan of landmarks says of hypotheses against each other, and against being lost, counts for
    this share where one was just before it: landmarks that stand beside their places on the map say the same wrong
    thing again and again.
    whole_covariance: 1 makes the covariance of an estimate that of all hypotheses about it, 0 that of the best alone.
    """

    max_hypotheses: int = 64
    prune_below: float = 1e-5
    evidence_share: float = 0.3
    kidnaps_per_min: float = 0.2
    whole_covariance: int = 0


ENGINES = ("gtsam", "chain")
"""gtsam solves general graphs and is the reference; chain is estimators.chain_engine, faster and the same."""


@dataclass(frozen=True, slots=True)
class Graph:
    """node_interval_s: a pose at least this often, besides one at each factor. cauchy: scale of the robust kernel, in
    sigmas of a factor. engine: what solves for all poses together, one of ENGINES."""

    node_interval_s: float = 0.1
    cauchy: float = 2.0
    engine: str = "gtsam"


@dataclass(frozen=True, slots=True)
class Calibration:
    """What odometry gets wrong all the time (estimators.motion.OdometryCalibration): what is known of it before a log,
    and how well, as standard deviations.

    It is estimated along with the poses; where all sigmas are 0 it is taken as known. odometry_delay_s: how much later
    than stamped the robot does what its odometry says. That of an odometry that states no covariance is not known: it
    may be what the robot was told to do.
    """

    scale_sigma: float = 0.1
    turn_scale_sigma: float = 0.1
    veer_sigma_rad_per_m: float = 0.1
    crab_sigma_rad: float = 0.1
    drift_sigma_mps: float = 0.02
    side_drift_sigma_mps: float = 0.02
    turn_drift_sigma_radps: float = 0.02
    turn_slowing_sigma_s: float = 0.3
    scale: float = 0.0
    turn_scale: float = 0.0
    veer_rad_per_m: float = 0.0
    crab_rad: float = 0.0
    drift_mps: float = 0.0
    side_drift_mps: float = 0.0
    turn_drift_radps: float = 0.0
    turn_slowing_s: float = 0.0
    odometry_delay_sigma_s: float = 0.15
    odometry_delay_s: float = 0.0

    def means(self) -> FloatArray:
        """(8,) in the order of OdometryCalibration."""
        return np.array(astuple(self)[8:16])

    def sigmas(self) -> FloatArray:
        """(8,) in the order of OdometryCalibration."""
        return np.array(astuple(self)[:8])


@dataclass(frozen=True, slots=True)
class Sensor:
    """What the eyes get wrong all the time (estimators.sensor.SensorCalibration): what is known of it before a log, and
    how well, as standard deviations.

    It is estimated along with the poses; a sigma of 0 takes it as known.
    """

    forward_sigma_m: float = 0.03
    left_sigma_m: float = 0.03
    bearing_offset_sigma_rad: float = 0.015
    delay_sigma_s: float = 0.05
    forward_m: float = 0.0
    left_m: float = 0.0
    bearing_offset_rad: float = 0.0
    delay_s: float = 0.0

    def means(self) -> FloatArray:
        """(4,) in the order of SensorCalibration."""
        return np.array(astuple(self)[4:])

    def sigmas(self) -> FloatArray:
        """(4,) in the order of SensorCalibration."""
        return np.array(astuple(self)[:4])


@dataclass(frozen=True, slots=True)
class Compass:
    """What all of a compass' readings get wrong alike: iron on the robot, a magnetic north that is not as stated.

    It wanders about zero with the standard deviation offset_sigma_rad and stays alike over offset_s, and is estimated
    along with the poses.
    """

    offset_sigma_rad: float = 0.2
    offset_s: float = 20.0

    def wander(self, duration_s: float) -> tuple[float, float]:
        """What is left of the offset after a time, as a share, and the variance (rad^2) that it has gained by then."""
        left = math.exp(-duration_s / self.offset_s)
        return left, self.offset_sigma_rad**2 * (1.0 - left**2)


@dataclass(frozen=True, slots=True)
class Survey:
    """How far landmarks stand beside their places on a map that does not say how well it knows them: standard
    deviation in x as in y, the same error all through a log. Who puts up posts and tubes by tape or by eye, who takes
    a trunk's middle for its axis, is hardly better than a centimetre. 0 takes such a map as exact."""

    landmark_sigma_m: float = 0.01


@dataclass(frozen=True, slots=True)
class Config:
    motion: MotionNoise = field(default_factory=MotionNoise)
    robust: Robust = field(default_factory=Robust)
    mixture: Mixture = field(default_factory=Mixture)
    particles: Particles = field(default_factory=Particles)
    graph: Graph = field(default_factory=Graph)
    calibration: Calibration = field(default_factory=Calibration)
    sensor: Sensor = field(default_factory=Sensor)
    mount: MountCorrection = field(default_factory=MountCorrection)
    correlation: ErrorCorrelation = field(default_factory=ErrorCorrelation)
    detection: Detection = field(default_factory=Detection)
    scan_noise: NoisePrior = field(default_factory=NoisePrior)
    scan_distortion: DistortionPrior = field(default_factory=DistortionPrior)
    compass: Compass = field(default_factory=Compass)
    survey: Survey = field(default_factory=Survey)
