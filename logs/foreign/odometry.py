"""Odometry as drivers log it, poses and velocities in any mixture, to velocities that hold from stamp to stamp.

A pose says how far the robot has come whatever was lost between two messages, so where poses move, the velocity of a
stretch is what leads from its first pose to its last. Until they have moved for the first time (many drivers leave
them at zero), where one is not finite and where one has jumped, the velocity that the message states is taken.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np

from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray
from logs.foreign.frames import plain
from logs.foreign.parts import OdometryPart, Part, PosePart, Transforms, TwistPart
from logs.foreign.planar import planar_covariance
from logs.foreign.rotations import STILL, Motion, compose, inverse, matrix, motion, on_the_ground
from logs.foreign.surroundings import ODOM_NAMES, Surroundings, Unusable, last

_SHORTEST_NS = 1_000_000  # a velocity over less than this is noise of the clock
_RESTART_NS = 1_000_000_000  # a stamp that is earlier by more comes from a clock that was set
_JUMP_M, _JUMP_RAD = 0.05, 0.1  # beyond what the top speed explains
_FASTEST = 1e3  # m/s, rad/s: beyond it a velocity is none
_WIDEST = 10.0  # m/s, rad/s: a driver that states more says that it does not know


@dataclass(frozen=True, slots=True)
class _Sample:
    stamp_ns: int
    pose: FloatArray | None
    twist: FloatArray | None
    covariance: FloatArray | None


class OdometryAdapter:
    """One topic; the velocity of a message is known when the next one comes."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._around = surroundings
        self._settings = surroundings.mapping.odometry
        self._before: _Sample | None = None
        self._has_moved = False
        self._has_twist = False
        self._velocity = np.zeros(3)

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[Odometry]:
        match part:
            case OdometryPart():
                yield from self._next(topic, self._sample(stamp_ns, part.pose, part.twist))
            case TwistPart():
                yield from self._next(topic, self._sample(stamp_ns, None, part))
            case PosePart():
                yield from self._next(topic, self._sample(stamp_ns, part, None))
            case Transforms():
                yield from self._of_transforms(topic, stamp_ns, part)

    def finish(self) -> Iterator[Odometry]:
        """The last message: nobody knows for how long its velocity held."""
        if self._before is not None:
            twist = self._before.twist if not self._has_moved else None
            yield self._odometry(self._before, self._velocity if twist is None else twist)
            self._before = None

    def _of_transforms(self, topic: str, log_time_ns: int, part: Transforms) -> Iterator[Odometry]:
        told = plain(self._around.mapping.frames.odom)
        for transform in part.transforms:
            parent = plain(transform.parent)
            if parent != told if told else last(parent) not in ODOM_NAMES:
                continue
            stamp_ns = self._around.notes.stamp(topic, transform.stamp_ns, log_time_ns)
            pose = PosePart(stamp_ns, parent, transform.translation, transform.rotation)
            nothing = TwistPart(stamp_ns, transform.child, np.full(3, np.nan), np.full(3, np.nan))
            yield from self._next(topic, self._sample(stamp_ns, pose, nothing))

    def _sample(self, stamp_ns: int, pose: PosePart | None, twist: TwistPart | None) -> _Sample:
        child = "" if twist is None else twist.frame
        child_from_robot = self._around.child_from_robot(child, stamp_ns)
        on_ground = None
        if pose is not None and (found := motion(pose.position, pose.rotation)) is not None:
            on_ground = on_the_ground(compose(found, child_from_robot))
        velocity = covariance = None
        if twist is not None and _is_velocity(twist.linear) and _is_velocity(twist.angular):
            velocity, turn = _in_robot(twist, child_from_robot)
            if self._settings.use_covariance and twist.covariance is not None:
                covariance = _sane(twist.covariance, turn)
        if on_ground is None and velocity is None:
            raise Unusable("neither pose nor velocity is a number")
        return _Sample(stamp_ns, on_ground, velocity, covariance)

    def _next(self, topic: str, sample: _Sample) -> Iterator[Odometry]:
        self._has_twist = self._has_twist or (sample.twist is not None and bool(sample.twist.any()))
        before = self._before
        if before is not None:
            passed_ns = sample.stamp_ns - before.stamp_ns
            if 0 <= passed_ns < _SHORTEST_NS:
                return  # the same again: the stretch goes on to the message after it
            if passed_ns >= 0:
                yield self._odometry(before, self._over(topic, before, sample, passed_ns * 1e-9))
            elif passed_ns > -_RESTART_NS:
                raise Unusable("its stamp is before that of the message logged before it")
        self._before = sample

    def _over(self, topic: str, a: _Sample, b: _Sample, passed_s: float) -> FloatArray:
        """The velocity (3,) between two messages."""
        if a.pose is not None and b.pose is not None:
            step = se2.local(a.pose, b.pose)
            if self._is_jump(step, passed_s):
                self._around.notes.say(f"{topic}: poses jump, the first time at {a.stamp_ns / 1e9:.3f} s: left out")
                self._velocity = a.twist if a.twist is not None and self._has_twist else self._velocity
                return self._velocity
            self._has_moved = self._has_moved or bool(step.any())
            if self._has_moved or a.twist is None:
                self._velocity = step / passed_s
                return self._velocity
        if a.twist is not None:
            self._velocity = a.twist
        return self._velocity

    def _is_jump(self, step: FloatArray, passed_s: float) -> bool:
        x, y, turn = step.tolist()
        too_far = hypot(x, y) > self._settings.max_speed_mps * passed_s + _JUMP_M
        return too_far or abs(turn) > self._settings.max_turn_radps * passed_s + _JUMP_RAD

    def _odometry(self, sample: _Sample, velocity: FloatArray) -> Odometry:
        return Odometry(sample.stamp_ns, velocity, sample.covariance)


def _is_velocity(vector: FloatArray) -> bool:
    return bool((np.abs(vector) < _FASTEST).all())  # False for NaN too


def _in_robot(twist: TwistPart, child_from_robot: Motion) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) of the robot's origin along its axes, and how the child's axes are turned in them (3, 3)."""
    if child_from_robot is STILL:
        return np.array([twist.linear[0], twist.linear[1], twist.angular[2]]), np.eye(3)
    robot_from_child = matrix(inverse(child_from_robot).rotation)
    linear = robot_from_child @ (twist.linear + np.cross(twist.angular, np.array(child_from_robot.translation)))
    turning = robot_from_child @ twist.angular
    return np.array([linear[0], linear[1], turning[2]]), robot_from_child


def _sane(covariance: FloatArray, robot_from_child: FloatArray) -> FloatArray | None:
    """(3, 3) of forward, left, turn; None where it cannot be meant."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = robot_from_child
    return planar_covariance(turn @ covariance @ turn.T, _WIDEST)
