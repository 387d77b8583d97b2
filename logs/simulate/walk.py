"""A whole game's walk: the player's plan, cut and moved by what happens to it."""

from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS
from logs.simulate.events import Event, Kind, Piece
from logs.simulate.legs import SAMPLE_S, path, standing
from logs.simulate.plan import Player
from logs.simulate.settings import WalkSettings

_SWAY_GROWS_S = 0.3


class Happened(NamedTuple):
    """An event as it went, in nanoseconds of the log's clock; end_ns: when the robot may play on."""

    kind: Kind
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """n samples. poses: (n, 3) without the sway. velocities: (n, 3) of these. stepped: (n, 3) those of them that the
    robot's own legs made. The rest as in Course; carried: (n,); fooled: (n,) fallen, which the walk engine has not
    noticed; jumped: (n,) put down here."""

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    velocities: FloatArray
    stepped: FloatArray
    walking: NDArray[np.bool_]
    upright: NDArray[np.bool_]
    carried: NDArray[np.bool_]
    fooled: NDArray[np.bool_]
    jumped: NDArray[np.bool_]
    happened: tuple[Happened, ...]

    def gait_phase_rad(self, settings: WalkSettings) -> FloatArray:
        """(n,)"""
        grown = np.cumsum(self.walking[:-1] * (pi * settings.steps_hz * SAMPLE_S))
        return np.concatenate([[0.0], grown])

    def swaying(self, settings: WalkSettings) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 3) and velocities (n, 3) of the body that sways over its feet."""
        if settings.sway_m == 0.0:
            return self.poses, self.velocities
        width = max(1, round(_SWAY_GROWS_S / SAMPLE_S))
        kernel = np.hanning(width + 2)[1:-1]
        grown = np.convolve(self.walking, kernel / kernel.sum())[: len(self.walking)]
        sway = np.zeros_like(self.poses)
        sway[:, 1] = settings.sway_m * grown * np.sin(self.gait_phase_rad(settings))
        poses = se2.compose(self.poses, sway)
        velocities = np.zeros_like(poses)
        velocities[:-1] = se2.local(poses[:-1], poses[1:]) / SAMPLE_S
        velocities[:-1][self.jumped[1:]] = 0.0
        return poses, velocities


def take_walk(
    start: FloatArray, stand_s: float, begin_ns: int, duration_s: float, player: Player, events: list[Event]
) -> Walk:
    """From the start (3,), standing there first. One sample every 10 ms, the first at begin_ns, the last at the end."""
    n = round(duration_s / SAMPLE_S) + 1
    film = _Film(start, n)
    waiting = list(events)
    happened = []
    film.add(Piece(standing(stand_s)), walked=True, until=_index(waiting, n))
    while film.at < n:
        if waiting and film.at >= _index(waiting, n):
            begin = film.at
            event = waiting.pop(0)
            for piece in event.make():
                film.add(piece, walked=False, until=n)
            player.think_again()
            happened.append(Happened(event.kind, begin_ns + begin * SAMPLE_NS, begin_ns + film.at * SAMPLE_NS))
            continue
        film.add(Piece(player.next_piece(film.pose)), walked=True, until=_index(waiting, n))
    return film.developed(begin_ns, tuple(happened))


def _index(waiting: list[Event], n: int) -> int:
    return min(n, round(waiting[0].at_s / SAMPLE_S)) if waiting else n


class _Film:
    """The samples taken so far. `at`: how many; `pose`: (3,) where the robot is at the next one."""

    def __init__(self, start: FloatArray, n: int) -> None:
        self.at, self.pose = 0, start
        self._poses, self._velocities = np.zeros((n, 3)), np.zeros((n, 3))
        self._flags = {
            name: np.zeros(n, dtype=np.bool_) for name in ("walked", "upright", "carried", "fooled", "jumped")
        }

    def add(self, piece: Piece, walked: bool, until: int) -> None:
        """As much of the piece as fits in before the sample `until`."""
        velocities = piece.velocities[: max(0, until - self.at)]
        if not len(velocities):
            return
        poses = path(self.pose, velocities)
        here = slice(self.at, self.at + len(velocities))
        self._poses[here], self._velocities[here] = poses[:-1], velocities
        self._flags["walked"][here] = walked
        self._flags["upright"][here] = piece.upright
        self._flags["carried"][here] = piece.carried
        self._flags["fooled"][here] = piece.fooled
        self.at, self.pose = here.stop, poses[-1]
        if piece.put_down is not None and len(velocities) == len(piece.velocities):
            self.pose = piece.put_down
            if self.at < len(self._poses):
                self._flags["jumped"][self.at] = True

    def developed(self, begin_ns: int, happened: tuple[Happened, ...]) -> Walk:
        stepped = np.where(self._flags["walked"][:, None], self._velocities, 0.0)
        return Walk(
            begin_ns + SAMPLE_NS * np.arange(len(self._poses), dtype=np.int64),
            self._poses,
            self._velocities,
            stepped,
            np.asarray(stepped.any(axis=1)),
            self._flags["upright"],
            self._flags["carried"],
            self._flags["fooled"],
            self._flags["jumped"],
            happened,
        )
