"""What all steps of one picture's location share."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.locate.cameras import Cameras
from fieldloc.locate.matching import Matches, match
from fieldloc.locate.noise import Noise
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.settings import LocateSettings
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.pose import FloatArray

_SAME_M, _SAME_RAD = 0.1, 0.03
_LOOKED_AT = 3  # times as many as are wanted: the next ones are hardly better than the last of these


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    sight: Sight
    shape: Shape
    prior: CameraPrior
    settings: LocateSettings
    _noises: dict[float, Noise] = field(default_factory=dict, init=False, repr=False)

    def cameras(self, states: FloatArray) -> Cameras:
        return Cameras.at(states, self.sight, self.shape)

    def noise(self, widen_px: float = 0.0) -> Noise:
        if widen_px not in self._noises:  # they remember what they made of the posts
            self._noises[widen_px] = Noise(self.sight, self.shape, self.settings, widen_px)
        return self._noises[widen_px]

    def score(self, states: FloatArray, matches: Matches) -> FloatArray:
        """(k,) how well states explain what they are matched with."""
        off = states[:, 3:] - self.prior.mean
        return np.asarray(matches.gains - 0.5 * np.sum(off @ self.prior.precision * off, axis=1))

    def matched(
        self, states: FloatArray, widen_px: float = 0.0, doubted: NDArray[np.bool_] | None = None
    ) -> tuple[Matches, FloatArray]:
        """doubted: (k,) states whose posts are matched with none."""
        matches = match(self.cameras(states), self.noise(widen_px))
        if doubted is not None and doubted.any():
            matches = matches.without_posts(doubted)
        return matches, self.score(states, matches)

    def best(
        self,
        states: FloatArray,
        scores: FloatArray,
        most: int,
        margin: float,
        kinds: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.intp]:
        """Rows of at most so many, best first, none worse than the best by more than the margin, no two of which are
        the same place or its twin. kinds: (k,) those that differ in it are not the same."""
        order = np.argsort(-scores, kind="stable")[: _LOOKED_AT * most]
        order = order[scores[order] > scores[order[:1]] - margin]
        if len(order) < 2:
            return order
        poses = states[order, :3]
        same = np.zeros((len(order), len(order)), dtype=np.bool_)
        for turn in (np.zeros(3), *self.shape.symmetries):
            turned = se2.compose(turn, poses) if turn.any() else poses
            x, y = turned[:, None, 0] - poses[:, 0], turned[:, None, 1] - poses[:, 1]
            near = x * x + y * y < _SAME_M**2
            if near.any():
                same |= near & (np.abs(se2.wrap(turned[:, None, 2] - poses[:, 2])) < _SAME_RAD)
        if kinds is not None:
            same &= kinds[order, None] == kinds[order]
        kept: list[int] = []
        taken = np.zeros(len(order), dtype=np.bool_)
        for i in range(len(order)):
            if not taken[i]:
                kept.append(i)
                taken |= same[i]
                if len(kept) == most:
                    break
        return np.asarray(order[kept], dtype=np.intp)
