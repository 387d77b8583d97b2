"""What a message of someone else's robot needs of the rest of its log: frames, the camera, who the robot is."""

from collections.abc import Callable, Collection
from functools import cached_property
from math import atan2, hypot

import numpy as np

from fieldloc.camera import Camera
from fieldloc.ground import robot_from_camera
from fieldloc.measurements import CameraMount
from logs.foreign.frames import Frames, plain
from logs.foreign.notes import Notes
from logs.foreign.rotations import NO_ROTATION, STILL, Motion, Quaternion, compose, matrix
from logs.foreign.settings import LogMapping, MountSettings

ROBOT_NAMES = ("base_footprint", "base_link", "base")
ODOM_NAMES = ("odom", "odom_combined", "odometry")
FIELD_NAMES = ("map", "field", "world", "")

# the camera's axes (right, down, forward) in the robot's (forward, left, up) while pan, tilt and roll are zero
_LEVEL = robot_from_camera(CameraMount(1.0, 0.0, 0.0, 0.0, np.eye(4)))
_ON_ITS_SIDE_RAD = 1.0  # no robot plays with its camera rolled this far


class Unusable(ValueError):
    """Why a message gives no record."""


class Surroundings:
    """Read from the log when first asked for. FieldlocError then where the log itself is at fault.

    read_frames: all of the log's transforms. read_camera: the log's first camera and its frame.
    """

    def __init__(
        self,
        mapping: LogMapping,
        notes: Notes,
        read_frames: Callable[[], Frames],
        read_camera: Callable[[], tuple[Camera | None, str]],
    ) -> None:
        self.mapping = mapping
        self.notes = notes
        self._read_frames = read_frames
        self._read_camera = read_camera

    @cached_property
    def frames(self) -> Frames:
        frames = self._read_frames()
        for warning in frames.warnings:
            self.notes.say(warning)
        return frames

    @cached_property
    def camera(self) -> Camera | None:
        return self._camera_and_frame[0]

    @cached_property
    def _camera_and_frame(self) -> tuple[Camera | None, str]:
        camera, frame = self._read_camera()
        return self.mapping.camera or camera, frame

    @cached_property
    def robot(self) -> str:
        """The robot's frame; empty where neither the mapping nor a transform names one."""
        return plain(self.mapping.frames.robot) or named(self.frames.names, ROBOT_NAMES)

    def robot_from(self, frame: str, stamp_ns: int) -> Motion:
        """Of a frame at a stamp, the robot's own being on the ground. Unusable where the log does not say."""
        return compose(self._ground_from_robot, self._robot_from(frame, stamp_ns))

    def turned_into_robot(self, frame: str, stamp_ns: int) -> Quaternion:
        """The rotation robot_from_frame; none where no transform ever tells of the frame, with a note."""
        if self.is_robot(frame) or (self.robot and self.frames.are_connected(self.robot, frame)):
            return self.robot_from(frame, stamp_ns).rotation
        self.notes.say(f"no transform leads to frame {frame}: its axes are taken for the robot's")
        return NO_ROTATION

    def child_from_robot(self, child: str, stamp_ns: int) -> Motion:
        """The robot in the frame that a pose or velocity is of; no motion where no transform ever tells of it."""
        if self.is_robot(child) or not self.robot or not self.frames.are_connected(self.robot, child):
            return STILL
        found = self.frames.motion(child, self.robot, stamp_ns)
        if found is None:
            raise Unusable(f"no transform from {plain(child)} to {self.robot} near its stamp")
        return found

    def is_robot(self, frame: str) -> bool:
        """Whether it is the robot's frame by its name alone; a message that names no frame means the robot's."""
        frame, told = plain(frame), plain(self.mapping.frames.robot)
        return not frame or (frame == told if told else last(frame) == ROBOT_NAMES[0])

    def mount(self, frame: str, stamp_ns: int) -> CameraMount:
        """Of the camera whose pictures are in `frame`. Unusable where the log does not say."""
        settings = self.mapping.mount
        if settings.fixed is not None:
            return settings.fixed
        frames = [plain(name) for name in (self.mapping.frames.camera, frame, self._camera_and_frame[1]) if name]
        known = [name for name in frames if self.robot and self.frames.are_connected(self.robot, name)]
        if not known:
            raise Unusable(self._no_way(frames[0] if frames else "the camera"))
        mount = mount_of(self.robot_from(known[0], stamp_ns), settings)
        if abs(mount.roll_rad) > _ON_ITS_SIDE_RAD:
            self.notes.say(
                f"frame {known[0]}: the camera lies on its side; pictures need the camera's optical frame (z forward, "
                "x right, y down): name it in the mapping, [frames] camera"
            )
        if not 0.0 < mount.height_m < 10.0:
            raise Unusable(f"the camera is {mount.height_m:.2f} m above frame {self.robot}, which must be the ground")
        return mount

    @cached_property
    def _ground_from_robot(self) -> Motion:
        return Motion((0.0, 0.0, self.mapping.frames.robot_height_m), NO_ROTATION)

    def _robot_from(self, frame: str, stamp_ns: int) -> Motion:
        frame = plain(frame)
        if self.is_robot(frame):
            return STILL
        if not self.robot or not self.frames.are_connected(self.robot, frame):
            raise Unusable(self._no_way(frame))
        found = self.frames.motion(self.robot, frame, stamp_ns)
        if found is None:
            raise Unusable(f"no transform from {self.robot} to {frame} near its stamp")
        return found

    def _no_way(self, frame: str) -> str:
        if not self.frames.names:
            return f"where {frame} is on the robot is not said: the log has no transforms; give [mount] in a --mapping"
        if not self.robot:
            return f"none of the transforms names {' or '.join(ROBOT_NAMES)}: name it in a --mapping, [frames] robot"
        return f"no transform ever leads from {self.robot} to {frame}: name the frames in a --mapping, [frames]"


def mount_of(robot_from_optical: Motion, settings: MountSettings) -> CameraMount:
    """The same place and attitude as pan, tilt and roll: R = about_z(pan) about_y(tilt) about_x(roll) LEVEL."""
    turned = matrix(robot_from_optical.rotation) @ _LEVEL.T
    x, y, z = robot_from_optical.translation
    return CameraMount(
        height_m=z,
        pan_rad=atan2(turned[1, 0], turned[0, 0]),
        tilt_rad=atan2(-turned[2, 0], hypot(turned[0, 0], turned[1, 0])),
        roll_rad=atan2(turned[2, 1], turned[2, 2]),
        covariance=settings.covariance,
        x_m=x,
        y_m=y,
    )


def last(frame: str) -> str:
    """The name behind a prefix: base_link of robot1/base_link."""
    return frame.rpartition("/")[2]


def named(frames: Collection[str], names: Collection[str]) -> str:
    """The first of the names that a frame has, alone or behind a prefix; empty if there is none."""
    for name in names:
        for frame in sorted(frames, key=lambda frame: (len(frame), frame)):
            if last(frame) == name:
                return frame
    return ""
