"""The numbers that make a simulated game what it is, but for what the camera sees. One frozen record a subject.

Ranges are (lowest, highest): a value is drawn evenly from them, once a game or once an event. Rates are Poisson.
ValueError where a number cannot be meant, with the name of it first.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from math import isfinite
from types import MappingProxyType
from typing import Literal, get_args

Range = tuple[float, float]
Heading = Literal["gyro", "steps"]
WhenFallen = Literal["silent", "still", "walking"]

_SIGNED = ("pose", "declination_rad", "veer_rad_per_m")
_SLOWEST = 0.01  # a walk across the field must end some day
_LEAST: Mapping[str, float] = MappingProxyType(
    {
        "forward_mps": _SLOWEST,
        "backward_mps": _SLOWEST,
        "left_mps": _SLOWEST,
        "turn_radps": _SLOWEST,
        "acceleration_mps2": _SLOWEST,
        "turn_acceleration_radps2": _SLOWEST,
        "speed_mps": _SLOWEST,
        "steps_hz": 0.1,
        "steel_radius_m": 1e-3,
        "stated_sigma_rad": 1e-6,
    }
)
_MOST: Mapping[str, float] = MappingProxyType(
    {
        "m": 100.0,
        "mps": 10.0,
        "mps2": 100.0,
        "rad": 1000.0,
        "radps": 100.0,
        "radps2": 1000.0,
        "s": 3600.0,
        "min": 1000.0,
        "hz": 1000.0,
        "count": 100.0,
        "places": 100.0,
    }
)
"""By the last word of the name: what a computer can still make up. Everything else ends at a million."""


class _Checked:
    """Refuses what no number of its kind can be, in the words of whoever wrote it."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for item in fields(self):  # type: ignore[arg-type]  # only dataclasses derive from this
            name, value = item.name, getattr(self, item.name)
            numbers = [x for x in (value if isinstance(value, tuple) else (value,)) if isinstance(x, int | float)]
            if not all(isfinite(x) for x in numbers):
                raise ValueError(f"{name}: needs finite numbers, got {value}")
            least = _LEAST.get(name, 0.0)
            if name not in _SIGNED and any(x < least for x in numbers):
                raise ValueError(f"{name}: needs to be at least {least:g}, got {value}")
            most = 1e6 if name == "at_s" else _MOST.get(name.rpartition("_")[2], 1e6)
            if any(abs(x) > most for x in numbers):
                raise ValueError(f"{name}: needs to be at most {most:g}, got {value}")
            if item.type == Range and (len(value) != 2 or value[0] > value[1]):
                raise ValueError(f"{name}: needs two numbers, the lower one first, got {list(value)}")


@dataclass(frozen=True, slots=True)
class StartSettings(_Checked):
    """pose: x_m, y_m, heading_rad; empty: on a touch line in the own half, facing the field.

    told: the robot is told where it starts, with an error of these standard deviations.
    """

    pose: tuple[float, ...] = ()
    stand_s: float = 2.0
    told: bool = True
    sigma_m: float = 0.1
    sigma_rad: float = 0.05

    def __post_init__(self) -> None:
        _Checked.__post_init__(self)  # super() does not find the class that slots made anew
        if len(self.pose) not in (0, 3):
            raise ValueError(f"pose: needs [x_m, y_m, heading_rad], got {list(self.pose)}")
        if self.told and not (self.sigma_m and self.sigma_rad):
            raise ValueError("sigma_m and sigma_rad: need to be above 0 where the robot is told its start")


@dataclass(frozen=True, slots=True)
class WalkSettings(_Checked):
    """How the player can walk (top speeds and accelerations), and how often it stands: pause_s on average at a ball.

    sway_m: of the body to either side, once in two steps.
    """

    forward_mps: float = 0.35
    backward_mps: float = 0.15
    left_mps: float = 0.15
    turn_radps: float = 1.0
    acceleration_mps2: float = 0.5
    turn_acceleration_radps2: float = 2.0
    steps_hz: float = 3.0
    sway_m: float = 0.01
    pause_s: float = 1.5


@dataclass(frozen=True, slots=True)
class FallSettings(_Checked):
    """per_min: at random. at_s: at these times of the game. While it gets up it turns by turn_sigma_rad (normal, never
    beyond a quarter turn) and moves by move_sigma_m along either axis."""

    per_min: float = 0.0
    at_s: tuple[float, ...] = ()
    lying_s: Range = (1.0, 2.5)
    get_up_s: Range = (3.0, 6.0)
    turn_sigma_rad: float = 0.5
    move_sigma_m: float = 0.08


@dataclass(frozen=True, slots=True)
class KidnappingSettings(_Checked):
    """Someone carries the robot for carry_s to any place on the field, facing anywhere."""

    per_min: float = 0.0
    at_s: tuple[float, ...] = ()
    carry_s: Range = (2.0, 4.0)


@dataclass(frozen=True, slots=True)
class PenaltySettings(_Checked):
    """Someone carries the robot to a touch line in its own half; it stands there, facing the field, until it may go."""

    per_min: float = 0.0
    at_s: tuple[float, ...] = ()
    carry_s: Range = (2.0, 4.0)
    stand_s: Range = (30.0, 45.0)


@dataclass(frozen=True, slots=True)
class OthersSettings(_Checked):
    """count robots walk about at up to speed_mps, pause, and are off the field for absence_s now and then."""

    count: int = 5
    speed_mps: float = 0.35
    pause_s: float = 3.0
    absences_per_min: float = 0.1
    absence_s: Range = (20.0, 45.0)


@dataclass(frozen=True, slots=True)
class OdometrySettings(_Checked):
    """What the walk engine believes.

    *_scale: what it says for each metre or radian. heading "steps": turns are counted in steps, with turn_scale, slips
    and veer_rad_per_m (a turn that it believes in while it walks straight); "gyro": they are measured, with turn_scale,
    a bias (standard deviation; it wanders by walk per square root of a second) and white noise.
    slip_share: each step's length is wrong by that share (standard deviation), slip_rad_per_m: turns by that.
    bump_*: a collision's slip. stated_*: the driver's standard deviations of a message, 0: it states none.
    delay_s: stamps are so much later than the motion. jitter_s: of the moments at which messages are made.
    fallen: what it says meanwhile: nothing, that it stands, or for a while that it still walks.
    """

    rate_hz: float = 50.0
    forward_scale: Range = (0.9, 1.1)
    left_scale: Range = (0.85, 1.1)
    turn_scale: Range = (0.97, 1.03)
    heading: Heading = "gyro"
    veer_rad_per_m: Range = (-0.1, 0.1)
    slip_share: float = 0.1
    slip_rad_per_m: float = 0.1
    gyro_bias_sigma_radps: float = 0.003
    gyro_walk_radps_per_sqrt_s: float = 0.0001
    gyro_noise_rad_per_sqrt_s: float = 0.002
    bump_m: float = 0.05
    bump_rad: float = 0.1
    stated_mps: float = 0.0
    stated_radps: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.001
    drop_share: float = 0.0
    fallen: WhenFallen = "still"

    def __post_init__(self) -> None:
        _Checked.__post_init__(self)
        _check_choice("heading", self.heading, get_args(Heading))
        _check_choice("fallen", self.fallen, get_args(WhenFallen))
        _check_rate("rate_hz", self.rate_hz)
        if not self.drop_share < 1.0:
            raise ValueError(f"drop_share: needs a share below 1, got {self.drop_share}")


@dataclass(frozen=True, slots=True)
class CompassSettings(_Checked):
    """rate_hz 0: none. Magnetic fields are shares of the earth's horizontal one.

    hard_iron: on the robot, turning with it, in any direction; it wanders by walk per square root of a second.
    declination_rad: by how much the field's north is taken wrong. steel_*: places on the field, each with a field of
    that strength in its middle which falls off like a bell of that radius. sigma_rad: white noise; motor_*: more of it
    in bursts while walking. fallen_sigma_rad: the error while not upright.
    """

    rate_hz: float = 10.0
    sigma_rad: float = 0.05
    stated_sigma_rad: float = 0.1
    hard_iron: Range = (0.0, 0.15)
    hard_iron_walk_per_sqrt_s: float = 0.001
    declination_rad: Range = (-0.05, 0.05)
    steel_places: int = 2
    steel_strength: Range = (0.1, 0.5)
    steel_radius_m: float = 0.6
    motor_bursts_per_min: float = 2.0
    motor_burst_s: Range = (0.5, 2.0)
    motor_sigma_rad: float = 0.3
    fallen_sigma_rad: float = 0.8

    def __post_init__(self) -> None:
        _Checked.__post_init__(self)
        if self.rate_hz:
            _check_rate("rate_hz", self.rate_hz)


@dataclass(frozen=True, slots=True)
class DeliverySettings(_Checked):
    """From the measurement to the log: latency_s and up to jitter_s more. In a stall everything waits and comes at its
    end in one burst; in a gap the logger keeps nothing but the truth, which comes from outside the robot."""

    latency_s: float = 0.002
    jitter_s: float = 0.003
    stalls_per_min: float = 0.0
    stall_s: Range = (0.1, 0.5)
    gaps_per_min: float = 0.0
    gap_s: Range = (0.5, 3.0)


def _check_choice(name: str, value: str, choices: Iterable[str]) -> None:
    if value not in choices:
        raise ValueError(f"{name}: needs one of {', '.join(choices)}, got '{value}'")


def _check_rate(name: str, value: float) -> None:
    if value < 0.1:
        raise ValueError(f"{name}: needs to be at least 0.1, got {value}")
