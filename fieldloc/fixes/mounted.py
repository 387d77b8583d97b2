"""A fix of a sensor's pose as a fix of the robot that carries it."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fieldloc.covariance import propagate
from fieldloc.fixes.base import Fix
from fieldloc.fixes.inputs import exactly
from fieldloc.pose import FloatArray, compose, inverse

AnyFix = TypeVar("AnyFix", bound=Fix)


def fix_of_robot(fix: AnyFix, robot_from_sensor: FloatArray) -> AnyFix:
    """The same fix for the robot on which the fixed sensor sits at robot_from_sensor (3,), taken as exact."""
    mount = exactly(robot_from_sensor, (3,), "robot_from_sensor")
    pose = compose(fix.pose, inverse(mount))
    jacobian = np.eye(3)
    # the robot's origin swings around the sensor when the heading turns
    arm = pose[:2] - fix.pose[:2]
    jacobian[:2, 2] = [-arm[1], arm[0]]
    return replace(fix, pose=pose, covariance=propagate(jacobian, fix.covariance))
