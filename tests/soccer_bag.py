"""A KidSize robot's recording as a ROS 2 team has it: odometry, tf, camera, what its detectors saw, a motion capture.

The robot walks an arc and scans with its head. The hip (base_link) sways; base_footprint is the ground below it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from ros_messages import message, packed, source
from scipy.spatial.transform import Rotation

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import robot_from_camera
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from logs.source import Source
from logs.writer import LogWriter

BEGIN_NS = 1_750_000_000_000_000_000
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
START = np.array([-2.0, -1.0, 0.3])
VELOCITY = np.array([0.25, 0.02, 0.12])
BELIEVED = VELOCITY * [1.1, 1.0, 0.95]  # what the odometry makes of it
OPTICAL = Rotation.from_matrix(robot_from_camera(CameraMount(1.0, 0.0, 0.0, 0.0, np.eye(4))))
"""A camera's axes in those of a robot whose head looks straight ahead."""
POST_HEIGHT_M = 1.1
HIP_HEIGHT_M = 0.35
ODOM_HZ, IMAGE_HZ = 50, 10
TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/goal_posts_in_image": "soccer_vision_2d_msgs/msg/GoalpostArray",
    "/markings_in_image": "soccer_vision_2d_msgs/msg/MarkingArray",
    "/goal_posts_relative": "soccer_vision_3d_msgs/msg/GoalpostArray",
    "/markings_relative": "soccer_vision_3d_msgs/msg/MarkingArray",
    "/mocap/robot": "geometry_msgs/msg/PoseStamped",
    "/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/amcl_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/imu/mag": "sensor_msgs/msg/MagneticField",
}
USUAL = tuple(TYPES)[:8] + ("/mocap/robot",)


def ros_source(topic: str, name: str | None = None) -> Source:
    given = source(name or TYPES[topic])
    return Source(topic, given.message_encoding, given.schema_name, given.schema_encoding, given.schema_data)


SOURCES = {topic: ros_source(topic) for topic in TYPES}


def header(stamp_ns: int, frame: str) -> dict[str, object]:
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": frame}


def xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", map(float, vector), strict=True))


def quaternion(rotation: Rotation) -> dict[str, float]:
    return dict(zip("xyzw", map(float, rotation.as_quat()), strict=True))


def turn(axes: str, *angles_rad: float) -> Rotation:
    return Rotation.from_euler(axes, angles_rad)


def flat_pose(pose: FloatArray) -> dict[str, object]:
    return {"position": xyz(np.array([*pose[:2], 0.0])), "orientation": quaternion(turn("z", pose[2]))}


def transform(stamp_ns: int, parent: str, child: str, position: FloatArray, rotation: Rotation) -> dict[str, object]:
    return {
        "header": header(stamp_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": xyz(position), "rotation": quaternion(rotation)},
    }


@dataclass(frozen=True)
class Moment:
    """Where everything is at a time since the beginning."""

    time_s: float

    @property
    def stamp_ns(self) -> int:
        return BEGIN_NS + round(self.time_s * 1e9)

    @cached_property
    def pose(self) -> FloatArray:
        return se2.retract(START, VELOCITY * self.time_s)

    @property
    def odom(self) -> FloatArray:
        return se2.retract(np.array([0.5, 0.2, 1.0]), BELIEVED * self.time_s)

    @property
    def footprint_from_hip(self) -> tuple[FloatArray, Rotation]:
        sway = 0.05 * np.sin(6.0 * self.time_s)
        return np.array([0.01, 0.02 * np.sin(3.0 * self.time_s), HIP_HEIGHT_M]), turn("yx", 0.1 + sway, 0.5 * sway)

    @property
    def hip_from_camera(self) -> tuple[FloatArray, Rotation]:
        """Optical: z forward, x right, y down."""
        pan = 0.9 * np.sin(1.1 * self.time_s)
        return np.array([0.03, 0.0, 0.25]), turn("ZY", pan, 0.2) * OPTICAL

    @cached_property
    def footprint_from_camera(self) -> tuple[FloatArray, FloatArray]:
        hip, camera = self.footprint_from_hip, self.hip_from_camera
        return hip[0] + hip[1].apply(camera[0]), (hip[1] * camera[1]).as_matrix()

    def pixels(self, field_points: FloatArray, heights_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of points (n, 2) above the field, by the transforms alone, and whether they are on the image."""
        in_robot = np.column_stack([se2.apply(se2.inverse(self.pose), field_points), heights_m])
        place, rotation = self.footprint_from_camera
        return CAMERA.project((in_robot - place) @ rotation)


def boxes(moment: Moment, field: FieldMap) -> list[tuple[float, float, float, float]]:
    """Upright boxes (centre u, v, width, height) around what is seen of the posts, as a detector draws them."""
    out = []
    for mark in field.landmarks:
        away = mark.position - se2.apply(moment.pose, moment.footprint_from_camera[0][:2])
        distance = float(np.linalg.norm(away))
        side = 0.5 * mark.diameter_m * np.array([-away[1], away[0]]) / distance
        front = mark.position - 0.5 * mark.diameter_m * away / distance
        heights_m = np.linspace(0.0, POST_HEIGHT_M, 200)
        points = np.concatenate([np.tile(mark.position + s * side, (200, 1)) for s in (1.0, -1.0)] + [front[None]])
        pixels, seen = moment.pixels(points, np.concatenate([heights_m, heights_m, [0.0]]))
        if distance > 6.0 or not seen[:-1].any():
            continue
        visible = pixels[seen]
        low, high = visible.min(axis=0), visible.max(axis=0)
        if (high - low)[1] > 15.0 and (high - low)[0] > 2.0:
            out.append((*((low + high) / 2), *(high - low)))
    return out


def segments(moment: Moment, field: FieldMap) -> tuple[FloatArray, FloatArray]:
    """Ends of the lines that are seen, in pixels (n, 2, 2) and in metres in the robot's frame (n, 2, 3)."""
    in_image, in_robot = [], []
    for ends in field.lines:
        points = ends[0] + np.linspace(0.0, 1.0, 400)[:, None] * (ends[1] - ends[0])
        pixels, seen = moment.pixels(points, np.zeros(400))
        if seen.sum() > 20 and np.linalg.norm(np.ptp(pixels[seen], axis=0)) > 60.0:
            first, last = np.flatnonzero(seen)[[0, -1]]
            if seen[first : last + 1].all() and np.linalg.norm(points[first] - moment.pose[:2]) < 5.0:
                in_image.append(pixels[[first, last]])
                flat = se2.apply(se2.inverse(moment.pose), points[[first, last]])
                in_robot.append(np.column_stack([flat, np.zeros(2)]))
    return np.array(in_image).reshape(-1, 2, 2), np.array(in_robot).reshape(-1, 2, 3)


def said(topic: str, moment: Moment, field: FieldMap, random: np.random.Generator) -> Mapping[str, object]:
    """What the topic says at that time."""
    stamp_ns = moment.stamp_ns
    hip, camera = moment.footprint_from_hip, moment.hip_from_camera
    odom = np.array([*moment.odom[:2], 0.0])
    in_odom = turn("z", moment.odom[2])
    down = hip[1].inv()
    optical, ground = header(stamp_ns, "camera_optical_frame"), header(stamp_ns, "base_footprint")
    match topic:
        case "/odom":
            return {
                "header": header(stamp_ns, "odom"),
                "child_frame_id": "base_footprint",
                "pose": {"pose": flat_pose(moment.odom)},
                "twist": {
                    "twist": {"linear": xyz([*BELIEVED[:2], 0.0]), "angular": xyz([0.0, 0.0, BELIEVED[2]])},
                    "covariance": np.diag([1e-4] * 6).ravel(),
                },
            }
        case "/cmd_vel":
            return {"linear": xyz([9.0, 0.0, 0.0])}
        case "/tf":
            return {
                "transforms": [
                    transform(stamp_ns, "odom", "base_link", odom + in_odom.apply(hip[0]), in_odom * hip[1]),
                    transform(stamp_ns, "base_link", "base_footprint", -down.apply(hip[0]), down),
                    transform(stamp_ns, "base_link", "head", camera[0], camera[1]),
                ]
            }
        case "/tf_static":
            return {"transforms": [transform(0, "head", "camera_optical_frame", np.zeros(3), turn("z", 0.0))]}
        case "/camera/camera_info":
            return {
                "header": optical,
                "height": CAMERA.height_px,
                "width": CAMERA.width_px,
                "distortion_model": "plumb_bob",
                "d": np.zeros(5),
                "k": np.array([CAMERA.fx_px, 0.0, CAMERA.cx_px, 0.0, CAMERA.fy_px, CAMERA.cy_px, 0.0, 0.0, 1.0]),
            }
        case "/camera/image_raw/compressed":
            return {"header": optical, "format": "jpeg", "data": np.arange(9, dtype=np.uint8)}
        case "/goal_posts_in_image":
            return {
                "header": optical,
                "posts": [
                    {
                        "bb": {"center": {"position": {"x": u, "y": v}}, "size_x": width, "size_y": height},
                        "confidence": {"confidence": 0.9},
                    }
                    for u, v, width, height in (
                        np.array(box) + random.normal(0.0, 1.0, 4) * (np.array(box)[2:].min() > 8.0)
                        for box in boxes(moment, field)
                    )
                ],
            }
        case "/markings_in_image":
            return {
                "header": optical,
                "segments": [
                    {
                        "start": dict(zip("xy", ends[0] + random.normal(0.0, 1.0, 2), strict=True)),
                        "end": dict(zip("xy", ends[1] + random.normal(0.0, 1.0, 2), strict=True)),
                        "confidence": {"confidence": 0.9},
                    }
                    for ends in segments(moment, field)[0]
                ],
            }
        case "/goal_posts_relative":
            return {
                "header": ground,
                "posts": [
                    {"bb": {"center": {"position": xyz([*post, 0.0])}}, "confidence": {"confidence": -1.0}}
                    for post in se2.apply(se2.inverse(moment.pose), field.positions) + random.normal(0.0, 0.03, (4, 2))
                    if np.linalg.norm(post) < 5.0
                ],
            }
        case "/markings_relative":
            return {
                "header": ground,
                "segments": [
                    {"start": xyz(ends[0]), "end": xyz(ends[1]), "confidence": {"confidence": -1.0}}
                    for ends in segments(moment, field)[1]
                ],
            }
        case "/mocap/robot":
            return {"header": header(stamp_ns, "map"), "pose": flat_pose(moment.pose)}
        case "/initialpose":
            return {
                "header": header(stamp_ns, "map"),
                "pose": {"pose": flat_pose(moment.pose), "covariance": np.diag([0.01, 0.01, 0, 0, 0, 0.02]).ravel()},
            }
        case "/amcl_pose":
            return {
                "header": header(stamp_ns, "map"),
                "pose": {"pose": flat_pose(moment.pose), "covariance": np.diag([0.04, 0.04, 0, 0, 0, 0.01]).ravel()},
            }
        case "/imu/data":
            return {
                "header": header(stamp_ns, "base_link"),
                "orientation": quaternion(in_odom * hip[1]),
            }
        case "/imu/mag":
            return {
                "header": header(stamp_ns, "base_link"),
                "magnetic_field": xyz(down.apply(turn("z", -moment.pose[2]).apply([0.0, 2e-5, -4e-5]))),
            }
    raise ValueError(topic)


def write_bag(
    path: Path, field: FieldMap, seconds: float = 20.0, topics: Collection[str] = USUAL, delay_s: float = 0.02
) -> Path:
    """Logged a little after they were measured. Transforms and odometry at 50 Hz, the rest at 10 Hz."""
    random = np.random.default_rng(3)
    with LogWriter(path) as log:
        for tick in range(round(seconds * ODOM_HZ) + 1):
            moment = Moment(tick / ODOM_HZ)
            for topic in topics:
                often = topic in ("/odom", "/tf", "/imu/data", "/imu/mag")
                once = topic in ("/tf_static", "/initialpose")
                if often or (tick == 0 if once else tick % (ODOM_HZ // IMAGE_HZ) == 0):
                    name = TYPES[topic]
                    data = packed(message(name, said(topic, moment, field, random)), name)
                    log.write_raw(SOURCES[topic], moment.stamp_ns + round(delay_s * 1e9), data)
    return path


def write_messages(path: Path, messages: Collection[tuple[str, int, Mapping[str, object]]], **types: str) -> Path:
    """(topic, log time, fields); types: of topics that are not in TYPES, by name without the slash."""
    with LogWriter(path) as log:
        for topic, log_time_ns, fields in messages:
            name = types.get(topic[1:]) or TYPES[topic]
            given = SOURCES[topic] if topic in SOURCES else ros_source(topic, name)
            log.write_raw(given, log_time_ns, packed(message(name, fields), name))
    return path
