"""The mapping of a log of someone else's robot from a TOML file and from --role.

What is given in degrees in the file is in radians in the settings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from types import MappingProxyType

from fieldloc.camera import load_camera
from fieldloc.errors import FieldlocError
from fieldloc.measurements import CameraMount
from fieldloc.toml_table import TomlTable
from logs.foreign.settings import (
    MANY,
    NO_ROLES,
    ROLES,
    CompassSettings,
    DetectionNoise,
    FrameNames,
    InitialPoseSettings,
    LogMapping,
    MountSettings,
    OdometrySettings,
)

__all__ = ["LogMapping", "load_mapping", "with_roles"]


def load_mapping(path: str | Path) -> LogMapping:
    """The defaults with what the file says; FieldlocError names the file and the key for every mistake."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such mapping file; give the path of a TOML file") from None
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a path with a zero byte
        raise FieldlocError(f"{path}: cannot be read as a mapping: {error}") from None
    table = TomlTable.parse(text, str(path))
    mapping = LogMapping(
        roles=_roles(table),
        frames=_frames(table),
        camera=load_camera(path.parent / table.string("camera")) if table.has("camera") else None,
        rectified=table.flag("rectified", False),
        mount=_mount(table),
        detections=_detections(table),
        odometry=_odometry(table),
        compass=_compass(table),
        initial_pose=_initial_pose(table),
    )
    table.finish()
    return mapping


def with_roles(mapping: LogMapping, settings: Sequence[str]) -> LogMapping:
    """With settings like "odometry=/odom"; a role told twice is played by both topics, by none after "odometry="."""
    told: dict[str, tuple[str, ...]] = {}
    for setting in settings:
        role, equals, topic = setting.partition("=")
        if not equals:
            raise FieldlocError(f"--role {setting}: needs ROLE=TOPIC, for example odometry=/odom")
        if role not in ROLES:
            raise FieldlocError(f"--role {setting}: no role '{role}'; there is {', '.join(ROLES)}")
        topics = (*told.get(role, ()), *((topic,) if topic else ()))
        if len(topics) > 1 and role not in MANY:
            raise FieldlocError(f"--role {setting}: {role} is played by one topic, not by {' and '.join(topics)}")
        told[role] = topics
    roles = MappingProxyType({**mapping.roles, **told})
    return replace(mapping, roles=roles, told=mapping.told | told.keys())


def _roles(whole: TomlTable) -> Mapping[str, tuple[str, ...]]:
    if not whole.has("roles"):
        return NO_ROLES
    table = whole.table("roles")
    roles = {role: table.strings(role, "a topic in quotes or a list of topics") for role in ROLES if table.has(role)}
    for role, topics in roles.items():
        if len(topics) > 1 and role not in MANY:
            table.fail(role, f"is played by one topic, got {len(topics)}")
    table.finish()
    return MappingProxyType(roles)


def _frames(whole: TomlTable) -> FrameNames:
    default = FrameNames()
    if not whole.has("frames"):
        return default
    table = whole.table("frames")
    frames = FrameNames(
        field=table.string("field") if table.has("field") else "",
        odom=table.string("odom") if table.has("odom") else "",
        robot=table.string("robot") if table.has("robot") else "",
        camera=table.string("camera") if table.has("camera") else "",
        robot_height_m=table.signed("robot_height_m", default.robot_height_m),
        max_age_s=table.number("max_age_s", default.max_age_s, positive=True),
        field_from_map=_field_from_map(table),
    )
    table.finish()
    return frames


def _field_from_map(whole: TomlTable) -> tuple[float, float, float]:
    if not whole.has("field_from_map"):
        return (0.0, 0.0, 0.0)
    table = whole.table("field_from_map")
    x, y = table.signed("x_m", 0.0), table.signed("y_m", 0.0)
    heading = radians(table.signed("heading_deg", 0.0))
    table.finish()
    return (x, y, heading)


def _mount(whole: TomlTable) -> MountSettings:
    default = MountSettings()
    if not whole.has("mount"):
        return default
    table = whole.table("mount")
    settings = MountSettings(
        height_sigma_m=table.number("height_sigma_m", default.height_sigma_m, positive=True),
        pan_sigma_rad=_angle(table, "pan_sigma_deg", default.pan_sigma_rad),
        tilt_sigma_rad=_angle(table, "tilt_sigma_deg", default.tilt_sigma_rad),
        roll_sigma_rad=_angle(table, "roll_sigma_deg", default.roll_sigma_rad),
    )
    place = {name: table.signed(name, 0.0) for name in ("x_m", "y_m")}
    turn = {name: radians(table.signed(name, 0.0)) for name in ("pan_deg", "tilt_deg", "roll_deg")}
    if table.has("height_m"):
        fixed = CameraMount(
            height_m=table.number("height_m", positive=True),
            pan_rad=turn["pan_deg"],
            tilt_rad=turn["tilt_deg"],
            roll_rad=turn["roll_deg"],
            covariance=settings.covariance,
            **place,
        )
        settings = replace(settings, fixed=fixed)
    elif given := [name for name in (*place, *turn) if table.has(name)]:
        table.fail(given[0], "says where the camera is, which takes height_m too")
    table.finish()
    return settings


def _detections(whole: TomlTable) -> DetectionNoise:
    default = DetectionNoise()
    if not whole.has("detections"):
        return default
    table = whole.table("detections")
    noise = DetectionNoise(
        edge_sigma_px=table.number("edge_sigma_px", default.edge_sigma_px, positive=True),
        foot_sigma_px=table.number("foot_sigma_px", default.foot_sigma_px, positive=True),
        line_sigma_px=table.number("line_sigma_px", default.line_sigma_px, positive=True),
        range_sigma_m=table.number("range_sigma_m", default.range_sigma_m, positive=True),
        range_sigma_relative=table.number("range_sigma_relative", default.range_sigma_relative),
        bearing_sigma_rad=_angle(table, "bearing_sigma_deg", default.bearing_sigma_rad),
        min_confidence=table.number("min_confidence", default.min_confidence),
    )
    table.finish()
    return noise


def _odometry(whole: TomlTable) -> OdometrySettings:
    default = OdometrySettings()
    if not whole.has("odometry"):
        return default
    table = whole.table("odometry")
    settings = OdometrySettings(
        max_speed_mps=table.number("max_speed_mps", default.max_speed_mps, positive=True),
        max_turn_radps=_angle(table, "max_turn_degps", default.max_turn_radps),
        use_covariance=table.flag("use_covariance", default.use_covariance),
    )
    table.finish()
    return settings


def _compass(whole: TomlTable) -> CompassSettings:
    default = CompassSettings()
    if not whole.has("compass"):
        return default
    table = whole.table("compass")
    settings = CompassSettings(
        north_rad=radians(table.signed("north_deg")) if table.has("north_deg") else None,
        imu_heading_rad=radians(table.signed("imu_heading_deg")) if table.has("imu_heading_deg") else None,
        sigma_rad=_angle(table, "sigma_deg", default.sigma_rad),
    )
    table.finish()
    return settings


def _initial_pose(whole: TomlTable) -> InitialPoseSettings:
    default = InitialPoseSettings()
    if not whole.has("initial_pose"):
        return default
    table = whole.table("initial_pose")
    settings = InitialPoseSettings(
        sigma_m=table.number("sigma_m", default.sigma_m, positive=True),
        heading_sigma_rad=_angle(table, "heading_sigma_deg", default.heading_sigma_rad),
    )
    table.finish()
    return settings


def _angle(table: TomlTable, key: str, default_rad: float) -> float:
    """Above 0, in degrees there."""
    return radians(table.number(key, positive=True)) if table.has(key) else default_rad
