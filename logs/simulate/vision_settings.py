"""All about camera, head and detector of a simulated robot. The defaults are a KidSize robot's.

`ideal_vision()` is the same robot without any error: what it reports is what geometry says.
Shares and chances are between 0 and 1. ValueError where numbers make no robot.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace

from fieldloc.camera import Camera

_TILTS = ("far_tilt_rad", "near_tilt_rad", "min_tilt_rad", "max_tilt_rad")


@dataclass(frozen=True, slots=True)
class HeadSettings:
    """Neck and head motion.

    The camera's centre is camera_ahead_m and camera_above_m from the tilt axis while the head is level; that axis is
    neck_height_m above the ground. The head sweeps to both sides by sweep_pan_rad at a constant rate, far_tilt_rad one
    way and near_tilt_rad the other; from time to time it looks at the ball.

    ball_every_s: mean pause between two looks at the ball; 0: never. ball_look_s: how long one takes.
    backlash_rad: between joint sensor and link; the link lags behind by half of it.
    """

    neck_height_m: float = 0.47
    camera_ahead_m: float = 0.03
    camera_above_m: float = 0.08
    sweep_pan_rad: float = 1.1
    sweep_radps: float = 0.9
    far_tilt_rad: float = 0.2
    near_tilt_rad: float = 0.5
    ball_every_s: float = 8.0
    ball_look_s: float = 1.5
    max_pan_rad: float = 1.8
    min_tilt_rad: float = -0.3
    max_tilt_rad: float = 1.1
    max_joint_radps: float = 4.0
    joint_noise_rad: float = 0.002
    backlash_rad: float = 0.006

    def __post_init__(self) -> None:
        _check(self, positive=("neck_height_m", "sweep_radps", "max_joint_radps"), signed=(*_TILTS, "camera_ahead_m"))
        if self.min_tilt_rad > min(self.far_tilt_rad, self.near_tilt_rad):
            raise ValueError("min_tilt_rad is above the tilts of the sweep")
        if self.max_tilt_rad < max(self.far_tilt_rad, self.near_tilt_rad):
            raise ValueError("max_tilt_rad is below the tilts of the sweep")
        if self.sweep_pan_rad > self.max_pan_rad:
            raise ValueError("sweep_pan_rad is beyond max_pan_rad")


@dataclass(frozen=True, slots=True)
class MountSettings:
    """What the robot does not know about where its camera is.

    error_*: standard deviations of the constant error, drawn once a game. sway_*: amplitude of the trunk's motion
    while it walks, roll once a gait cycle, pitch and height twice (once a step). imu_share: how much of the trunk's
    attitude the inertial unit measures; imu_noise_rad: its noise, image by image.
    claimed_*: standard deviations that the robot's driver states in the log.
    """

    error_roll_rad: float = 0.02
    error_tilt_rad: float = 0.025
    error_pan_rad: float = 0.02
    error_height_m: float = 0.01
    sway_roll_rad: float = 0.03
    sway_pitch_rad: float = 0.02
    sway_height_m: float = 0.006
    imu_share: float = 0.8
    imu_noise_rad: float = 0.004
    claimed_height_m: float = 0.012
    claimed_pan_rad: float = 0.022
    claimed_tilt_rad: float = 0.027
    claimed_roll_rad: float = 0.023

    def __post_init__(self) -> None:
        _check(self, shares=("imu_share",))


@dataclass(frozen=True, slots=True)
class TimingSettings:
    """When images are taken, stamped and logged.

    A picture is taken at every 1 / images_hz; its stamp is stamp_delay_s too late and the stamp's jitter comes on top;
    its features are logged latency_s after the stamp, and up to latency_jitter_s later.
    drop_chance: of a single image. outages_per_minute, outage_s: longer silences, mean number and mean length.
    """

    images_hz: float = 15.0
    stamp_delay_s: float = 0.01
    stamp_jitter_s: float = 0.001
    latency_s: float = 0.06
    latency_jitter_s: float = 0.03
    drop_chance: float = 0.02
    outages_per_minute: float = 0.3
    outage_s: float = 1.0

    def __post_init__(self) -> None:
        _check(self, positive=("images_hz",), shares=("drop_chance",), signed=("stamp_delay_s",))


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Pixel noise of edges, feet and line ends.

    sigma_px + sigma_px_per_m * range, and blur_share of the motion blur's length on top. The blur is as long as the
    picture moves during exposure_s. claim_ratio: standard deviation that the detector states over the one it has;
    it never states less than least_claim_px.
    """

    sigma_px: float = 0.8
    sigma_px_per_m: float = 0.1
    foot_sigma_ratio: float = 2.0
    exposure_s: float = 0.008
    blur_share: float = 0.2
    claim_ratio: float = 1.0
    least_claim_px: float = 0.1

    def __post_init__(self) -> None:
        _check(self, positive=("claim_ratio", "least_claim_px", "foot_sigma_ratio"))


@dataclass(frozen=True, slots=True)
class PostSettings:
    """How posts are found: near_chance / (1 + exp((range - half_range_m) / range_scale_m)), halved by blur_half_px of
    motion blur; none is found that is narrower than least_width_px or shows less than least_height_px.

    goal_height_m: of the posts. people: standing beside the field, taken for posts with person_chance each time they
    could be seen; robot_chance the same for another robot's legs. ghost_chance: per image, of a post out of nothing.
    """

    near_chance: float = 0.97
    half_range_m: float = 7.0
    range_scale_m: float = 0.8
    blur_half_px: float = 12.0
    least_width_px: float = 2.0
    least_height_px: float = 12.0
    goal_height_m: float = 1.2
    people: int = 3
    person_width_m: float = 0.14
    person_chance: float = 0.08
    robot_chance: float = 0.02
    ghost_chance: float = 0.02

    def __post_init__(self) -> None:
        _check(
            self,
            positive=("range_scale_m", "blur_half_px", "goal_height_m", "person_width_m"),
            shares=("near_chance", "person_chance", "robot_chance", "ghost_chance"),
        )


@dataclass(frozen=True, slots=True)
class LineSettings:
    """How lines are found: chance and blur as for posts; the range is where the middle of its picture lies.

    least_length_px: no shorter one is found. shortened_share: each end falls short of the visible end by up to this
    share of the picture's length. split_chance: of being found as two lines with a gap. merge_chance: of a line that
    robots cut being found as one. chord_chance: of each of the eight arcs of a circle being found as a straight line.
    border_chance: of each side of the carpet's border, border_m outside the outermost lines. ghost_chance: per image,
    of a line out of nothing (shadows, seams).
    """

    near_chance: float = 0.95
    half_range_m: float = 4.5
    range_scale_m: float = 0.6
    blur_half_px: float = 10.0
    least_length_px: float = 40.0
    shortened_share: float = 0.1
    split_chance: float = 0.08
    merge_chance: float = 0.5
    chord_chance: float = 0.25
    border_m: float = 0.7
    border_chance: float = 0.05
    ghost_chance: float = 0.05

    def __post_init__(self) -> None:
        shares = ("near_chance", "split_chance", "merge_chance", "chord_chance", "border_chance", "ghost_chance")
        _check(self, positive=("range_scale_m", "blur_half_px"), shares=shares)
        if self.shortened_share >= 0.5:
            raise ValueError(f"shortened_share is {self.shortened_share}, must be below 0.5")


@dataclass(frozen=True, slots=True)
class OtherRobotSettings:
    """Other robots in the way: upright cylinders. hide: whether they hide what is behind them."""

    hide: bool = True
    radius_m: float = 0.2
    height_m: float = 0.55

    def __post_init__(self) -> None:
        _check(self, positive=("radius_m", "height_m"))


@dataclass(frozen=True, slots=True)
class VisionSettings:
    """One section for each thing that can be right or wrong about what a robot sees."""

    camera: Camera = field(default_factory=lambda: Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5))
    head: HeadSettings = field(default_factory=HeadSettings)
    mount: MountSettings = field(default_factory=MountSettings)
    timing: TimingSettings = field(default_factory=TimingSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    posts: PostSettings = field(default_factory=PostSettings)
    lines: LineSettings = field(default_factory=LineSettings)
    robots: OtherRobotSettings = field(default_factory=OtherRobotSettings)


def ideal_vision(settings: VisionSettings | None = None) -> VisionSettings:
    """The settings without noise, errors, delay and false finds, where whatever can be seen is found.

    The head still sweeps, the picture still ends where the camera's does, and robots still hide things.
    """
    base = settings or VisionSettings()
    head = replace(base.head, joint_noise_rad=0.0, backlash_rad=0.0)
    mount = replace(
        base.mount,
        error_roll_rad=0.0,
        error_tilt_rad=0.0,
        error_pan_rad=0.0,
        error_height_m=0.0,
        sway_roll_rad=0.0,
        sway_pitch_rad=0.0,
        sway_height_m=0.0,
        imu_noise_rad=0.0,
    )
    timing = TimingSettings(base.timing.images_hz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    noise = replace(base.noise, sigma_px=0.0, sigma_px_per_m=0.0, blur_share=0.0)
    posts = replace(
        base.posts,
        near_chance=1.0,
        half_range_m=1e6,
        blur_half_px=1e9,
        least_width_px=0.0,
        people=0,
        robot_chance=0.0,
        ghost_chance=0.0,
    )
    lines = replace(
        base.lines,
        near_chance=1.0,
        half_range_m=1e6,
        blur_half_px=1e9,
        shortened_share=0.0,
        split_chance=0.0,
        merge_chance=0.0,
        chord_chance=0.0,
        border_chance=0.0,
        ghost_chance=0.0,
    )
    return VisionSettings(base.camera, head, mount, timing, noise, posts, lines, base.robots)


def _check(
    section: object, positive: tuple[str, ...] = (), shares: tuple[str, ...] = (), signed: tuple[str, ...] = ()
) -> None:
    """Every number is finite, and 0 or more unless it is signed; ValueError that names the field."""
    assert is_dataclass(section)
    for each in fields(section):
        name, value = each.name, getattr(section, each.name)
        if isinstance(value, bool):
            continue
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{name} is {value!r}, must be a number")
        if name in positive and value <= 0:
            raise ValueError(f"{name} is {value}, must be above 0")
        if name in shares and not 0 <= value <= 1:
            raise ValueError(f"{name} is {value}, must be between 0 and 1")
        if name not in signed and value < 0:
            raise ValueError(f"{name} is {value}, must not be below 0")
