"""From the least squares' unknowns to the robot's pose in the field, and how uncertain that is."""

import math
from collections.abc import Sequence

import numpy as np

from fieldloc.fixes.alignment import State, Symmetric

_NODES = tuple(
    zip(*(column.tolist() for column in np.polynomial.hermite_e.hermegauss(9)), strict=True)
)  # to 4.5 sigmas


def robot_pose(state: State, p: Symmetric, middle: complex, mount: Sequence[float]) -> tuple[State, Symmetric]:
    """Pose and covariance, field axes, of the robot that carries the sensor at `mount`.

    robot = middle - arm, arm = R(robot's heading) mount + R(sensor's heading) state: both swing with the heading.
    """
    heading = math.remainder(state[2] - mount[2], math.tau)
    c, s = math.cos(state[2]), math.sin(state[2])
    robot_c, robot_s = math.cos(heading), math.sin(heading)
    arm_x = c * state[0] - s * state[1] + robot_c * mount[0] - robot_s * mount[1]
    arm_y = s * state[0] + c * state[1] + robot_s * mount[0] + robot_c * mount[1]
    p00, p01, p02, p11, p12, p22 = p
    # the state's covariance turned into field axes, with the sign of -R
    xx = c * c * p00 - 2.0 * c * s * p01 + s * s * p11
    xy = c * s * (p00 - p11) + (c * c - s * s) * p01
    yy = s * s * p00 + 2.0 * c * s * p01 + c * c * p11
    xh, yh = -(c * p02 - s * p12), -(s * p02 + c * p12)
    # d robot / d heading = (arm_y, -arm_x)
    covariance = (
        xx + 2.0 * arm_y * xh + arm_y * arm_y * p22,
        xy - arm_x * xh + arm_y * yh - arm_x * arm_y * p22,
        xh + arm_y * p22,
        yy - 2.0 * arm_x * yh + arm_x * arm_x * p22,
        yh - arm_x * p22,
        p22,
    )
    return (middle.real - arm_x, middle.imag - arm_y, heading), covariance


def second_moment(state: State, p: Symmetric, pose: State, middle: complex) -> Symmetric:
    """Mean square of the robot's error, field axes, with the state Gaussian and the turn by its heading exact.

    With d the heading's error, the state's own error is g d + something independent of it, and the robot swings:
    error = arm - R(d) (arm + R g d + R something).
    """
    p00, p01, p02, p11, p12, p22 = p
    turn = complex(math.cos(state[2]), math.sin(state[2]))
    arm = middle - complex(pose[0], pose[1])
    along = turn * complex(p02, p12) / p22
    # a symmetric matrix turned by an angle: its trace stays, its deviator turns by twice the angle
    half_trace = 0.5 * (p00 - p02 * p02 / p22 + p11 - p12 * p12 / p22)
    deviator = turn**2 * complex(0.5 * (p00 - p02 * p02 / p22 - p11 + p12 * p12 / p22), p01 - p02 * p12 / p22)
    sigma = math.sqrt(p22)
    xx = xy = xh = yy = yh = 0.0
    for node, weight in _NODES:
        d = sigma * node
        swing = complex(math.cos(d), math.sin(d))
        error = arm - swing * (arm + along * d)
        turned = swing**2 * deviator
        w = weight / math.sqrt(math.tau)
        xx += w * (error.real**2 + half_trace + turned.real)
        xy += w * (error.real * error.imag + turned.imag)
        yy += w * (error.imag**2 + half_trace - turned.real)
        xh += w * error.real * d
        yh += w * error.imag * d
    return xx, xy, xh, yy, yh, p22


def state_of(pose: State, middle: complex, mount: Sequence[float]) -> State:
    """The inverse of `robot_pose`."""
    heading = pose[2] + mount[2]
    in_robot = (middle - complex(pose[0], pose[1])) * complex(math.cos(pose[2]), -math.sin(pose[2]))
    in_sensor = (in_robot - complex(mount[0], mount[1])) * complex(math.cos(mount[2]), -math.sin(mount[2]))
    return in_sensor.real, in_sensor.imag, heading


def along_heading(pose: State, covariance: Symmetric, sigmas: float) -> State:
    """The likeliest pose whose heading is that many sigmas off."""
    step = sigmas / math.sqrt(covariance[5])
    return pose[0] + step * covariance[2], pose[1] + step * covariance[4], pose[2] + step * covariance[5]
