"""The fix that the post solvers return, and its way from the sensor that saw the posts to the robot that carries it."""

from dataclasses import dataclass, field, replace

import numpy as np

from fieldloc.covariance import propagate
from fieldloc.fixes.base import Fix
from fieldloc.fixes.inputs import exactly
from fieldloc.pose import FloatArray, compose, inverse


@dataclass(frozen=True, slots=True)
class PostFix(Fix):
    """chi2: the weighted squared residual, chi-square with one degree of freedom; 0 where nothing is redundant.

    first_order_covariance: (3, 3) as the covariance but strictly first-order: the same unless the posts are far or
    small, see `fieldloc.fixes.spread`.
    """

    chi2: float = 0.0
    first_order_covariance: FloatArray = field(default_factory=lambda: np.diag(np.full(3, np.inf)))


def fix_of_robot(fix: PostFix, robot_from_sensor: FloatArray) -> PostFix:
    """The same fix for the robot on which the fixed sensor sits at robot_from_sensor (3,), taken as exact."""
    mount = exactly(robot_from_sensor, (3,), "robot_from_sensor")
    pose = compose(fix.pose, inverse(mount))
    jacobian = np.eye(3)
    # the robot's origin swings around the sensor when the heading turns
    arm = pose[:2] - fix.pose[:2]
    jacobian[:2, 2] = [-arm[1], arm[0]]
    return replace(
        fix,
        pose=pose,
        covariance=propagate(jacobian, fix.covariance),
        first_order_covariance=propagate(jacobian, fix.first_order_covariance),
    )
