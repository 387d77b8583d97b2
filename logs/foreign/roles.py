"""Which topic means what, guessed from types and names.

fieldloc's own messages come first, those on the usual topic before others. Of other people's messages these play:

* odometry: odometry messages with "odom" in their name, then others, then a velocity, then the transform from odom to
  the robot, then a commanded velocity. None that is named as truth or as an estimate.
* camera: camera calibrations, no depth, infrared, right or rectified one if there is another.
* image_features: detections in pixels, of posts and of lines a topic each; lines in metres where no pixels tell of any.
* landmarks: posts in metres, where none are seen in pixels by a camera whose place is told.
* compass: a magnetometer, if the mapping says where north is.
* truth: poses and odometry with ground truth, mocap, vicon, ... in the name.
* initial_pose: poses on a topic that ends in initialpose or initial_pose.
* estimate: other poses and odometry that are a localization's by name, with covariance before without.
* tf, image, imu, magnetometer, joints: these types; they give no record by themselves.

At equal merit most messages win, then the alphabet. What fieldloc wrote for viewers (/fieldloc/...) plays nothing,
but for its estimates as ROS 2 messages.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from logs.foreign.parts import (
    CameraPart,
    ImageDetectionsPart,
    ImagePart,
    ImuPart,
    JointsPart,
    MagneticPart,
    OdometryPart,
    Part,
    PosePart,
    SpaceDetectionsPart,
    Transforms,
    TwistPart,
    VideoPart,
)
from logs.foreign.settings import SHOWN, LogMapping
from logs.foreign.wires import known_type, own_schema
from logs.foxglove.topics import PREFIX
from logs.schema import ROS2_ESTIMATES, TOPICS
from logs.source import Source

PLAYERS: Mapping[str, tuple[type[Part], ...]] = {
    "odometry": (OdometryPart, TwistPart, PosePart, Transforms),
    "camera": (CameraPart,),
    "image_features": (ImageDetectionsPart, SpaceDetectionsPart),
    "landmarks": (SpaceDetectionsPart,),
    "compass": (MagneticPart, ImuPart),
    "truth": (PosePart, OdometryPart),
    "estimate": (PosePart, OdometryPart),
    "initial_pose": (PosePart, OdometryPart),
    "hypotheses": (),
    "events": (),
    "field": (),
    "tf": (Transforms,),
    "image": (ImagePart, VideoPart),
    "imu": (ImuPart,),
    "magnetometer": (MagneticPart,),
    "joints": (JointsPart,),
}
"""What the messages of others must be to play a role."""

_TRUTH = re.compile(r"ground_?truth|mocap|motion_?capture|optitrack|vicon|vrpn|qualisys|(^|[/_.])(gt|truth)([/_.]|$)")
_INITIAL = re.compile(r"initial_?pose$")
_ESTIMATE = re.compile(r"amcl|locali[sz]|estimat|global|(^|[/_])(robot_|current_|filtered_)?pose(_with_covariance)?$")
_NOT_ROBOT = re.compile(r"goal|target|ball|cmd|command|set_?point|path|plan|obstacle|opponent|teammate|hand|foot|sole")
_COMMAND = re.compile(r"cmd|command|set_?point|target|goal|joy|teleop")
_SECOND_CAMERA = re.compile(r"depth|infra|right|aligned|rect")


@dataclass(frozen=True, slots=True)
class Roles:
    """topics: who plays each role. candidates: the role that a topic could play if another did not."""

    topics: Mapping[str, tuple[str, ...]]
    candidates: Mapping[str, str]

    def of(self, topic: str) -> tuple[str, ...]:
        """All that the topic plays."""
        return tuple(role for role, topics in self.topics.items() if topic in topics)


@dataclass(frozen=True, slots=True)
class _Channel:
    topic: str
    part: type[Part] | None
    own_role: str | None
    count: int
    schema_name: str

    @property
    def name(self) -> str:
        return self.topic.lower()

    @property
    def is_viewers(self) -> bool:
        return self.topic.startswith(PREFIX) and self.topic != ROS2_ESTIMATES


def guess_roles(
    channels: Sequence[tuple[Source, int]], mapping: LogMapping, has_odometry: Callable[[Collection[str]], bool]
) -> Roles:
    """channels with their number of messages. has_odometry: whether transforms on these topics tell how
    the robot moves; asked only where it matters."""
    known = [
        _Channel(source.topic, known_type(source), _own_role(source), count, source.schema_name)
        for source, count in channels
        if count
    ]
    known.sort(key=lambda channel: (-channel.count, channel.topic))
    able = {role: _able(role, known, mapping) for role in (*TOPICS, *SHOWN)}
    topics = {role: mapping.roles[role] if role in mapping.roles else _first(able[role]) for role in able}
    if "image_features" not in mapping.roles:
        topics["image_features"] = _sights(able["image_features"])
    if "landmarks" not in mapping.roles and _are_placed(topics, able["image_features"], mapping):
        topics["landmarks"] = tuple(t for t in topics["landmarks"] if _plays_own(t, "landmarks", known))
    if "tf" not in mapping.roles:
        topics["tf"] = _topics(able["tf"])
    if "odometry" not in mapping.roles:
        topics["odometry"] = _odometry(able["odometry"], topics["tf"], has_odometry)
    playing = {topic for played in topics.values() for topic in played}
    candidates = {c.topic: role for role in reversed(able) for c in able[role] if c.topic not in playing}
    return Roles({role: played for role, played in topics.items() if played}, candidates)


def is_static(topic: str) -> bool:
    """Whether the transforms on it hold for all times."""
    return "static" in topic.lower()


def _own_role(source: Source) -> str | None:
    """None on the usual topic of another role: that is a mistake, not a hint."""
    schema = own_schema(source)
    if schema is None or (source.topic in TOPICS.values() and source.topic != TOPICS[schema.role]):
        return None
    return schema.role


def is_command(topic: str) -> bool:
    """Whether it says by its name what the robot was told to do."""
    return bool(_COMMAND.search(topic.lower()))


def _able(role: str, channels: Sequence[_Channel], mapping: LogMapping) -> list[_Channel]:
    """Who could play the role, the best first."""
    own = [c for c in channels if c.own_role == role]
    own.sort(key=lambda c: c.topic != TOPICS.get(role))
    others = [c for c in channels if c.part in PLAYERS[role] and not c.is_viewers and _is_likely(role, c, mapping)]
    if role == "odometry":
        others.sort(key=_odometry_rank)
    elif role == "camera":
        others.sort(key=lambda c: bool(_SECOND_CAMERA.search(c.name)))
    elif role == "image":
        others.sort(key=lambda c: (c.part is VideoPart, bool(_SECOND_CAMERA.search(c.name))))
    elif role == "estimate":
        others.sort(key=lambda c: "Covariance" not in c.schema_name)
    return [*own, *others]


def _is_likely(role: str, channel: _Channel, mapping: LogMapping) -> bool:
    """By its name, its type being right."""
    name = channel.name
    truth, initial = bool(_TRUTH.search(name)), bool(_INITIAL.search(name))
    match role:
        case "odometry":
            drives = channel.part in (OdometryPart, TwistPart) and not _ESTIMATE.search(name)
            return drives and not truth
        case "truth":
            return truth
        case "initial_pose":
            return initial
        case "estimate":
            return bool(_ESTIMATE.search(name)) and not (truth or initial or _NOT_ROBOT.search(name))
        case "image_features":
            return channel.part is ImageDetectionsPart or "lines" in _things(channel)
        case "landmarks":
            return "posts" in _things(channel)
        case "compass":
            return channel.part is MagneticPart and mapping.compass.north_rad is not None
        case "magnetometer":
            return mapping.compass.north_rad is None
        case _:
            return True


def _odometry_rank(channel: _Channel) -> tuple[int, bool]:
    if channel.part is OdometryPart:
        return 0, "odom" not in channel.name
    return (2 if is_command(channel.topic) else 1), "odom" not in channel.name


def _odometry(
    able: Sequence[_Channel], tf: tuple[str, ...], has_odometry: Callable[[Collection[str]], bool]
) -> tuple[str, ...]:
    """A commanded velocity is what the robot was told, not what it did: even transforms know better."""
    if able and (able[0].own_role is not None or _odometry_rank(able[0])[0] < 2):
        return _first(able)
    moving = tuple(topic for topic in tf if not is_static(topic))
    return moving[:1] if moving and has_odometry(moving) else _first(able)


def _sights(able: Sequence[_Channel]) -> tuple[str, ...]:
    """Of posts and of lines the first topic that has them, in pixels before in metres; own messages have all."""
    if able and able[0].own_role is not None:
        return (able[0].topic,)
    out: dict[str, None] = {}
    seen: set[str] = set()
    for part in (ImageDetectionsPart, SpaceDetectionsPart):
        for channel in able:
            things = _things(channel) - ({"posts"} if part is SpaceDetectionsPart else set())
            if channel.part is part and things - seen:
                out[channel.topic] = None
                seen |= things
    return tuple(out)


def _things(channel: _Channel) -> set[str]:
    """What its type can hold."""
    name = channel.schema_name.lower()
    if "goalpost" in name or "detection" in name:
        return {"posts"}
    return {"lines"} if "marking" in name else {"posts", "lines"}


def _are_placed(topics: Mapping[str, tuple[str, ...]], sights: Sequence[_Channel], mapping: LogMapping) -> bool:
    """Whether posts are seen in pixels by a camera whose place is told."""
    playing = [c for c in sights if c.topic in topics["image_features"]]
    in_pixels = any(c.own_role or (c.part is ImageDetectionsPart and "posts" in _things(c)) for c in playing)
    has_camera = bool(topics["camera"]) or mapping.camera is not None
    has_mount = bool(topics["tf"]) or mapping.mount.fixed is not None or any(c.own_role for c in playing)
    return in_pixels and has_camera and has_mount


def _plays_own(topic: str, role: str, channels: Sequence[_Channel]) -> bool:
    return any(c.topic == topic and c.own_role == role for c in channels)


def _first(able: Sequence[_Channel]) -> tuple[str, ...]:
    return _topics(able)[:1]


def _topics(able: Sequence[_Channel]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(c.topic for c in able))
