"""What a player does with its time: it goes after a ball that rolls from place to place, and works at it."""

from collections.abc import Iterator
from math import hypot, pi

import numpy as np

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.legs import leg, path, standing
from logs.simulate.settings import WalkSettings

_MARGIN_M = 0.3  # the ball stays so far inside the lines
_SLACK_M = 0.2  # nobody side-steps or backs up further beyond them
_BALL_M = 0.25  # from the robot's middle to a ball at its feet
_ROLLS_M = (0.7, 3.5)  # how far a ball goes at a time
_FACES_RAD = 0.9  # a target further to the side is faced first


class Player:
    """Draws one piece of the walk after the other: (m, 3) body velocities, each from where the last one ended."""

    def __init__(
        self, settings: WalkSettings, bounds: tuple[float, float, float, float], random: np.random.Generator
    ) -> None:
        """bounds: (xmin, ymin, xmax, ymax) of the lines."""
        self._settings = settings
        self._low, self._high = np.array(bounds[:2]), np.array(bounds[2:])
        self._random = random
        self._pieces: Iterator[FloatArray] = iter(())

    def next_piece(self, pose: FloatArray) -> FloatArray:
        """pose: (3,) where the robot is."""
        self._pose = pose
        while True:
            piece = next(self._pieces, None)
            if piece is None:
                self._pieces = self._sortie()
            elif len(piece):
                return piece

    def think_again(self) -> None:
        """Forget what was begun: something happened to the robot."""
        self._pieces = iter(())

    def _sortie(self) -> Iterator[FloatArray]:
        """To the ball, and what is done there."""
        ball = self._next_ball()
        for _ in range(3):  # a weaving walk ends beside it, by less each time
            yield from self._approach(ball)
            if hypot(*se2.apply(se2.inverse(self._pose), ball)) < 2 * _BALL_M:
                break
        random = self._random
        if random.random() < 0.5:  # round the ball, to kick it elsewhere
            turn = random.uniform(0.4, 2.5) * random.choice([-1.0, 1.0])
            yield self._inside(np.array([0.0, -turn * _BALL_M, turn]))
        if random.random() < 0.5:
            yield self._inside(np.array([0.0, random.uniform(-0.2, 0.2), 0.0]))
        yield standing(random.exponential(self._settings.pause_s))
        if random.random() < 0.3:
            yield self._inside(np.array([random.uniform(-0.4, -0.1), 0.0, 0.0]))
        if random.random() < 0.2:  # where is it now?
            yield self._inside(np.array([0.0, 0.0, random.uniform(-pi, pi)]))

    def _approach(self, ball: FloatArray) -> Iterator[FloatArray]:
        random = self._random
        seen = se2.apply(se2.inverse(self._pose), ball)
        bearing = float(np.arctan2(seen[1], seen[0]))
        turns_first, strafes = random.random() < 0.3, random.random() < 0.4
        if abs(bearing) > _FACES_RAD or turns_first:
            yield self._leg(np.array([0.0, 0.0, bearing]))
            seen = se2.apply(se2.inverse(self._pose), ball)
            bearing = float(np.arctan2(seen[1], seen[0]))
        distance = max(hypot(*seen) - _BALL_M, 0.0)
        if distance < 0.02:
            return
        end = distance * np.array([np.cos(bearing), np.sin(bearing)])
        if strafes and distance < 1.5:  # aside without turning
            yield self._leg(np.array([end[0], end[1], 0.0]))
        else:  # the arc that starts along the heading and ends there turned by twice the bearing
            weave_radps = random.uniform(0.0, 0.25) if distance > 0.5 else 0.0
            yield self._leg(se2.log(np.array([end[0], end[1], 2.0 * bearing])), weave_radps)

    def _leg(self, tangent: FloatArray, weave_radps: float = 0.0) -> FloatArray:
        return leg(self._settings, tangent, self._random.uniform(0.7, 1.0), weave_radps)

    def _inside(self, tangent: FloatArray) -> FloatArray:
        """Not done at all if it would lead off the field."""
        velocities = self._leg(tangent)
        end = path(self._pose, velocities)[-1, :2]
        inside = np.all((end > self._low - _SLACK_M) & (end < self._high + _SLACK_M))
        return velocities if inside else velocities[:0]

    def _next_ball(self) -> FloatArray:
        """Some way from the robot, inside the lines."""
        low, high = self._low + _MARGIN_M, self._high - _MARGIN_M
        middle = 0.5 * (low + high)
        low, high = np.minimum(low, middle), np.maximum(high, middle)
        distance_m = self._random.uniform(*_ROLLS_M)
        direction_rad = self._random.uniform(-pi, pi)
        ball = self._pose[:2] + distance_m * np.array([np.cos(direction_rad), np.sin(direction_rad)])
        if np.all((ball > low) & (ball < high)):
            return np.asarray(ball)
        return self._random.uniform(low, high)
