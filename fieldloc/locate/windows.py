"""Posteriors that are too wide for one Gaussian, cut in pieces that are not.

Two lines and a prior of the attitude say where a camera is across one of them, and along it to a metre; over a metre
distances, heights and attitudes are no linear functions of each other. So the coordinate along the widest direction
gets windows, overlapping Gaussians whose sum is one all along: the posterior times each of them is
short, has its own best state and its own covariance, and its share of the evidence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

_WIDE_M = 0.12  # standard deviation from which a posterior is cut,
_ENDLESS_M = 3.0  # and from which nothing is known
_PIECE_M = 0.25  # apart, unless that would be too many:
_MOST_PIECES, _MOST = 9, 150  # of one, and of all
_OVERLAP = 0.6  # standard deviation of a window to the next one's distance: the sum of all is one to 0.2 %
_ENDS = 2.5  # standard deviations from the middle to the first and the last


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """On along (k, 2) . (x, y): Gaussians about centre (k,) of standard deviation sigma (k,). along is zero where there
    is none."""

    along: FloatArray
    centre: FloatArray
    sigma: FloatArray

    @staticmethod
    def none(count: int) -> "Windows":
        return Windows(np.zeros((count, 2)), np.zeros(count), np.ones(count))

    def repeat(self, times: int) -> "Windows":
        return Windows(*(np.repeat(part, times, axis=0) for part in (self.along, self.centre, self.sigma)))

    def off(self, states: FloatArray) -> FloatArray:
        """(k,) standard deviations from the middle."""
        return np.asarray((np.sum(self.along * states[:, :2], axis=1) - self.centre) / self.sigma)

    @property
    def rows(self) -> FloatArray:
        """(k, 2) change of `off` with x and y."""
        return self.along / self.sigma[:, None]

    def logs(self, states: FloatArray) -> FloatArray:
        """(k,) log of the windows' values."""
        off = self.off(states)
        height = np.where(self.along.any(axis=1), -0.5 * np.log(2.0 * np.pi) - np.log(_OVERLAP), 0.0)
        return np.asarray(height - 0.5 * off * off)


def cut(
    states: FloatArray, covariances: FloatArray, order: NDArray[np.intp]
) -> tuple[FloatArray, Windows, NDArray[np.intp]]:
    """States (n, 6) of pieces of those of states (k, 6) that are too wide, their windows, and of which row each is.

    order: rows that are worth it, the likeliest first.
    """
    values, vectors = np.linalg.eigh(covariances[:, :2, :2])
    wide = np.sqrt(np.maximum(values[:, 1], 0.0))
    parents: list[int] = []
    pieces, along, centres, sigmas = [np.zeros((0, 6))], [np.zeros((0, 2))], [np.zeros(0)], [np.zeros(0)]
    total = 0
    for row in order:
        if not _WIDE_M < wide[row] < _ENDLESS_M:
            continue
        count = min(int(np.ceil(2.0 * _ENDS * wide[row] / _PIECE_M)) + 1, _MOST_PIECES)
        total += count
        if total > _MOST:
            break
        parents += [int(row)] * count
        axis = vectors[row, :, 1]
        places = np.linspace(-_ENDS, _ENDS, count) * wide[row]
        # the state moves with its coordinate as the covariance says
        gain = covariances[row, :, :2] @ axis / wide[row] ** 2
        pieces.append(states[row] + places[:, None] * gain)
        along.append(np.tile(axis, (count, 1)))
        centres.append(axis @ states[row, :2] + places)
        sigmas.append(np.full(count, _OVERLAP * (places[1] - places[0])))
    windows = Windows(np.concatenate(along), np.concatenate(centres), np.concatenate(sigmas))
    return np.concatenate(pieces), windows, np.array(parents, dtype=np.intp)
