"""How everything that was observed can be read: one discrete choice for each observation."""

from dataclasses import dataclass

import numpy as np

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Where a hypothesis was after each of t mixtures, zeros where it was nowhere.

    poses: (t, 3), covariances (t, 3, 3) of them in the robot frame, calibrations (t, c) of the odometry.
    margins: (t,) by how much (log) a choice was better than to take nothing of it for right, where it was the only one;
    zeros where there were others.
    """

    poses: FloatArray
    covariances: FloatArray
    calibrations: FloatArray
    margins: FloatArray

    def later(self, by: int) -> "Way":
        """With so many mixtures more before them."""
        columns = (self.poses, self.covariances, self.calibrations, self.margins)
        return Way(*(np.concatenate([np.zeros((by, *column.shape[1:])), column]) for column in columns))


@dataclass(frozen=True, slots=True, eq=False)
class ModeSequence:
    """One way to read everything observed since the start.

    log_weight: log of its probability among those returned. choices: (t,) per observed mixture, in the order of
    `observe`, the id of the solution, -1 where nothing of it was right or nobody was there to see it.
    births: indices into the observed mixtures at which the hypothesis began: the first is the start, any later one
    means that the robot was found elsewhere. Empty for one that was told where it was and never lost.
    copy: which copy under the map's symmetries, 0 as the choices' poses are, i as moved by field.symmetries[i - 1].
    way: where it was, as copy 0 has it; None where nobody knows.
    """

    log_weight: float
    choices: IntArray
    births: tuple[int, ...]
    copy: int
    way: Way | None = None
