"""What happens to a player: falls, kidnappings, penalties. When, and what each does to the robot."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from logs.simulate.legs import bump, standing
from logs.simulate.settings import FallSettings, KidnappingSettings, PenaltySettings

Kind = Literal["fall", "kidnapping", "penalty"]
_FALLING_S = 0.6
_QUARTER_TURN_RAD = 0.5 * pi


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """What is done to the robot for a while.

    velocities: (m, 3). upright, carried: all the while, or not. put_down: (3,) where it stands afterwards, None: where
    the velocities led. fooled: the walk engine has not noticed yet.
    """

    velocities: FloatArray
    upright: bool = True
    carried: bool = False
    put_down: FloatArray | None = None
    fooled: bool = False


class Event(NamedTuple):
    at_s: float
    kind: Kind
    make: Callable[[], list[Piece]]


def draw_events(
    duration_s: float,
    bounds: tuple[float, float, float, float],
    falls: tuple[FallSettings, np.random.Generator],
    kidnappings: tuple[KidnappingSettings, np.random.Generator],
    penalties: tuple[PenaltySettings, np.random.Generator],
) -> list[Event]:
    """In the order of time; one that comes while another is going on waits until that is over."""
    fall, for_falls = falls
    kidnapping, for_kidnappings = kidnappings
    penalty, for_penalties = penalties
    times_s = [draw_times(s.per_min, duration_s, random).tolist() for s, random in (falls, kidnappings, penalties)]
    out = [Event(t, "fall", lambda: _fall(fall, for_falls)) for t in (*fall.at_s, *times_s[0])]
    out += [
        Event(t, "kidnapping", lambda: _kidnapping(kidnapping, bounds, for_kidnappings))
        for t in (*kidnapping.at_s, *times_s[1])
    ]
    out += [Event(t, "penalty", lambda: _penalty(penalty, bounds, for_penalties)) for t in (*penalty.at_s, *times_s[2])]
    return sorted((event for event in out if event.at_s < duration_s), key=lambda event: event.at_s)


def draw_times(per_min: float, duration_s: float, random: np.random.Generator) -> FloatArray:
    """(n,) when a Poisson process strikes, rising."""
    return np.sort(random.uniform(0.0, duration_s, random.poisson(per_min * duration_s / 60.0)))


def draw_intervals_ns(
    per_min: float, length_s: tuple[float, float], duration_s: float, random: np.random.Generator
) -> NDArray[np.int64]:
    """(n, 2) begin and end of what strikes like that and lasts, since the game began; they may overlap."""
    begins_s = draw_times(per_min, duration_s, random)
    lengths_s = random.uniform(*length_s, len(begins_s))
    return (np.stack([begins_s, begins_s + lengths_s], axis=-1) * 1e9).astype(np.int64)


def touch_line_pose(bounds: tuple[float, float, float, float], random: np.random.Generator) -> FloatArray:
    """(3,) on one of the touch lines in the own half, facing the field."""
    x_m = random.uniform(0.15, 0.85) * bounds[0]
    side = random.choice([-1.0, 1.0])
    y_m = bounds[3] if side > 0 else bounds[1]
    return np.array([x_m, y_m, -side * 0.5 * pi])


def _fall(settings: FallSettings, random: np.random.Generator) -> list[Piece]:
    slide = np.array([*(settings.move_sigma_m * random.standard_normal(2)), 0.0])
    move = np.array([*(settings.move_sigma_m * random.standard_normal(2)), 0.0])
    # drawn anew beyond a quarter turn, not cut off there: no heap of equal angles
    turn = np.inf
    while abs(turn) > _QUARTER_TURN_RAD:
        turn = min(settings.turn_sigma_rad, _QUARTER_TURN_RAD) * random.standard_normal()
    move[2] = turn
    lying, up = standing(random.uniform(*settings.lying_s)), random.uniform(*settings.get_up_s)
    return [
        Piece(bump(slide, _FALLING_S), upright=False, fooled=True),
        Piece(lying, upright=False, fooled=True),
        Piece(bump(move, up), upright=False),
    ]


def _kidnapping(
    settings: KidnappingSettings, bounds: tuple[float, float, float, float], random: np.random.Generator
) -> list[Piece]:
    carry = standing(random.uniform(*settings.carry_s))
    place = random.uniform([*bounds[:2], -pi], [*bounds[2:], pi])
    return [Piece(carry, carried=True, put_down=place)]


def _penalty(
    settings: PenaltySettings, bounds: tuple[float, float, float, float], random: np.random.Generator
) -> list[Piece]:
    carry, stand = standing(random.uniform(*settings.carry_s)), standing(random.uniform(*settings.stand_s))
    place = touch_line_pose(bounds, random)
    return [Piece(carry, carried=True, put_down=place), Piece(stand)]
