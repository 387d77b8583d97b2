"""What a solver of a chain gives back, and what solvers agree on: the numbers that a chain's factors are of.

A solver is a function `solve(chain, config, near) -> Solution`. Beside the poses it solves for what is the same over
the whole chain, `GLOBALS` numbers in this order: the odometry's calibration (8), the sensor's (4). Their priors have
the means `global_means` and the sigmas `global_sigmas`; a sigma of 0 takes the number at its mean. A compass' offset
over time comes on top (estimators.compass_knots).

* motion k between nodes k and k + 1: local(retract(before_from_after, by_calibration @ calibration),
  between(pose k, pose k + 1)), covariance + MOTION_FLOOR.
* factor at node k: error(pose k), Jacobian by its tangent. One that is `by_sight` is about the pose that was seen
  from, s = retract(pose k, lever @ sensor) with lever = chain.levers(calibration)[k], (3, 4), instead: its Jacobian by
  the tangent of the pose is jacobian(s) @ adjoint(inverse(exp(lever @ sensor))), its Jacobian by the sensor's
  calibration is jacobian(s) @ right_jacobian(lever @ sensor) @ lever. Levers change with the odometry's calibration,
  as delays are a matter of how fast the robot really is: jacobian(s) @ right_jacobian(lever @ sensor) @ (change of
  lever @ sensor) is its Jacobian by the odometry's.
* a HeadingFactor that is `by_compass`: heading plus the offset there.
* all factors but motions are under Cauchy's kernel of `config.graph.cauchy` sigmas.
* first pose: weak prior about the guess, sigmas WEAK_SIGMAS.
"""

from dataclasses import dataclass

import numpy as np

from estimators.config import Config
from estimators.motion import CALIBRATION, OdometryCalibration
from estimators.sensor import SENSOR, SensorCalibration
from fieldloc.pose import FloatArray

GLOBALS = CALIBRATION + SENSOR
MOTION_FLOOR = np.diag([1e-4, 1e-4, 1e-4]) ** 2
"""(3, 3) added to each motion's covariance. A robot that stands still for a moment moves less; a system with much
smaller ones is indeterminate to a solver."""
WEAK_SIGMAS = np.array([100.0, 100.0, 10.0])
"""Of a prior that keeps a chain determined whose factors leave a direction free."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """poses: (n, 3) of the chain's nodes; covariances: (n, 3, 3) marginal, robot frame; what they have of the
    map's errors comes on top (estimators.surveyed_errors).

    global_covariance: (GLOBALS, GLOBALS) marginal of the odometry's calibration and the sensor's, in that order; zeros
    for what was not free.
    """

    poses: FloatArray
    covariances: FloatArray
    calibration: OdometryCalibration
    sensor: SensorCalibration
    global_covariance: FloatArray
    compass_rad: FloatArray
    compass_variance_rad2: FloatArray
    """Both (k,): the compass' offset over time, a value each `compass_knots.knot_s` from the chain's start on; none
    without a compass."""
    log_determinant: float
    """Of the information about poses, calibrations and offsets together, robust weights and weak priors included."""
    late_s: float = 0.0
    """How much later than stamped the robot did what its odometry says (estimators.lateness). The motions that were
    solved for are so much later, and the sensor's delay is what is beyond it."""


def global_means(config: Config) -> FloatArray:
    """(GLOBALS,) prior means: what is known beforehand of odometry and sensor. The motions are uncalibrated."""
    return np.concatenate([config.calibration.means(), config.sensor.means()])


def global_sigmas(config: Config) -> FloatArray:
    """(GLOBALS,) prior standard deviations; 0 is not free."""
    return np.concatenate([config.calibration.sigmas(), config.sensor.sigmas()])
