"""What a cloud says: the likeliest cluster as the estimate, all clusters and copies as hypotheses, what befell them."""

from collections.abc import Callable

import numpy as np

from estimators.base import Event, EventKind, Hypothesis
from estimators.particles.cloud import Cloud, Moments
from estimators.particles.sides import Copies
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LEAST = 1e-4  # hypotheses of less weight are not worth a word
_DECIDED = 0.99
_NEAR_M, _NEAR_RAD = 0.7, 0.6
_FLOOR = np.diag([1e-4, 1e-4, 1e-4]) ** 2  # a cluster may be a single particle

Carry = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


class Tracks:
    """Numbers for clusters that stay the same as long as most of their particles do, and the events of their lives."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.numbers: IntArray = np.zeros(0, dtype=np.intp)
        self._means = np.zeros((0, 3))
        self._next = 0
        self._decided = -1

    def follow(self, cloud: Cloud, of: Moments, stamp_ns: int) -> None:
        means = of.means[:, :3]
        if len(means) == len(self._means) == 1 and _near(self._means[0], means[0]):
            self._means = means
            return
        numbers = np.full(len(means), -1, dtype=np.intp)
        taken: set[int] = set()
        for cluster in np.argsort(-of.masses, kind="stable"):
            near = [i for i, mean in enumerate(self._means) if i not in taken and _near(mean, means[cluster])]
            if near:
                taken.add(near[0])
                numbers[cluster] = self.numbers[near[0]]
            else:
                numbers[cluster], self._next = self._next, self._next + 1
        if not len(self._means):
            self.events.append(Event(stamp_ns, "start", f"{len(means)} places to be at"))
        elif len(means) > len(self._means):
            self.events.append(Event(stamp_ns, "split", f"{len(self._means)} places to be at become {len(means)}"))
        best = int(numbers[of.best])
        if of.masses[of.best] >= _DECIDED * of.masses.sum() and best != self._decided:
            kind: EventKind = "decision" if self._decided < 0 or len(self._means) != 1 else "recovery"
            self.events.append(Event(stamp_ns, kind, "one place holds 99 %"))
            self._decided = best
        self.numbers, self._means = numbers, means


class Found:
    """hypotheses: likeliest first. mirrored: probability of the copies of the first."""

    def __init__(self, hypotheses: tuple[Hypothesis, ...], mirrored: float) -> None:
        self.hypotheses = hypotheses
        self.mirrored = mirrored


def side_masses(cloud: Cloud, of: Moments) -> FloatArray:
    """(k, c) probability of each cluster at each copy."""
    if cloud.sides.shape[1] == 1:
        return of.masses[:, None]
    by = [np.bincount(cloud.labels, cloud.weights * side, len(of.masses)) for side in cloud.sides.T]
    return np.stack(by, axis=-1)


def best_of(cloud: Cloud, of: Moments, copies: Copies) -> tuple[FloatArray, FloatArray, int]:
    """Pose (3,), covariance (3, 3) in its robot frame, and which copy, of the likeliest."""
    if len(of.masses) == 1 and len(copies) == 1:
        return of.means[0, :3], of.covariances[0, :3, :3] + _FLOOR, 0
    cluster, copy = np.unravel_index(np.argmax(side_masses(cloud, of)), (len(of.masses), len(copies)))
    return copies.of(of.means[cluster, :3])[copy], of.covariances[cluster, :3, :3] + _FLOOR, int(copy)


def hypotheses(
    cloud: Cloud, of: Moments, copies: Copies, tracks: Tracks, lost: float, carry: Carry, mirror: Copies | None = None
) -> Found:
    """mirror: the map's copies where the cloud itself does not fold them."""
    masses = side_masses(cloud, of)
    masses = masses / masses.sum() * (1.0 - lost)
    poses = copies.of(of.means[:, :3])
    shape = masses.shape
    best = np.unravel_index(np.argmax(masses), shape)
    mirrored = 0.0
    mirror = copies if mirror is None else mirror
    if len(mirror) > 1:
        # who stands nearer to the estimate than to its copies is on its side
        flat = poses.reshape(-1, 3)
        back = se2.between(mirror.of(poses[best])[:, None], flat[None])
        side = np.argmin(np.sum(back[..., :2] ** 2, axis=-1) + (2.0 * back[..., 2]) ** 2, axis=0)
        mirrored = float(masses.ravel()[side > 0].sum())
    out: list[Hypothesis] = []
    for at in np.argsort(-masses, axis=None, kind="stable"):
        cluster, copy = np.unravel_index(at, shape)
        weight = float(masses[cluster, copy])
        if weight < _LEAST and out:
            break
        pose, covariance = carry(poses[cluster, copy], of.covariances[cluster, :3, :3] + _FLOOR)
        track = int(tracks.numbers[cluster]) * len(copies) + int(copy)
        out.append(Hypothesis(weight, pose, covariance, track))
    known = sum(one.weight for one in out)
    left = (1.0 - lost) / known if known > 0.0 else 0.0
    every = tuple(Hypothesis(one.weight * left, one.pose, one.covariance, one.track) for one in out)
    return Found(every, mirrored)


def _near(one: FloatArray, other: FloatArray) -> bool:
    x, y, turn = se2.between(one, other)
    return bool(abs(x) < _NEAR_M and abs(y) < _NEAR_M and abs(turn) < _NEAR_RAD)
