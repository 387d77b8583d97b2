"""What an ambiguous observation says about the pose: all of its solutions at once, with weights.

    p(observation | pose) = sum over solutions of p(observation, solution | pose)  +  p(observation | nothing is right)

Posts look alike, lines look alike, a field looks alike from its two halves: so one image or scan gives one factor of
several solutions, and of one more that says that nothing seen is what it seems to be. Every term is a density of the
same observation, so terms compare across solutions, across poses and with the last one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fieldloc.factors import Factor
from fieldloc.pose import FloatArray

IntArray = NDArray[np.intp]
_IDENTITY = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolutions:
    """Whole poses that explain an observation, the likeliest first.

    poses: (k, 3) field_from_robot. covariances: (k, 3, 3) in the robot frame of each. log_weights: (k,) logarithm of
    the integral over all poses (m^2 rad) of p(observation, solution | pose), so with the posterior's volume in it.
    ids: (k,) what `MixtureFactor.chosen` takes.
    """

    poses: FloatArray
    covariances: FloatArray
    log_weights: FloatArray
    ids: IntArray

    @staticmethod
    def none() -> "PoseSolutions":
        return PoseSolutions(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0, dtype=np.intp))


class After(NamedTuple):
    """What solutions make of a robot's tangent of covariance P; information I.

    shrink: (c, 3, 3) the inverse of 1 + P I: times a covariance before, it is that after. step: (c, 3) its mean after.
    updated: (c, 3, 3) its covariance after, still at the parent's pose. evidence: (c,) log p(observation, solution) of
    a robot that is at the parent's pose up to P."""

    shrink: FloatArray
    step: FloatArray
    updated: FloatArray
    evidence: FloatArray


@dataclass(frozen=True)
class Expansion:
    """Solutions near some poses, each as a quadratic in the robot-frame tangent d at its pose:

        log p(observation, solution | retract(pose, d)) = constant + gradient . d - 0.5 d' information d

    parent: (c,) row of the pose. ids: (c,) what `MixtureFactor.chosen` takes. constant: (c,), gradient: (c, 3),
    information: (c, 3, 3), which has no inverse where a solution leaves a direction free.
    covariance: (c, 3, 3) of the tangent before the observation; what is derived below is under it. known: that, where
    it has been worked out. blind: (h,) log evidence of nothing being right for each of the poses, where that is not the
    mixture's `log_outlier` for all of them.
    """

    parent: IntArray
    ids: IntArray
    constant: FloatArray
    gradient: FloatArray
    information: FloatArray
    covariance: FloatArray
    known: After | None = None
    blind: FloatArray | None = None

    def log_blind(self, mixture: "MixtureFactor", poses: int) -> FloatArray:
        """(h,) log evidence of nothing being right, for each of so many poses that this is the expansion of."""
        return np.full(poses, mixture.log_outlier) if self.blind is None else self.blind

    def take(self, rows: IntArray) -> "Expansion":
        """Those solutions (n,), in rising order."""
        if len(rows) == len(self.parent):
            return self  # and what was derived
        return Expansion(
            self.parent[rows],
            self.ids[rows],
            self.constant[rows],
            self.gradient[rows],
            self.information[rows],
            self.covariance[rows],
            After(*(part[rows] for part in self.after)),
            self.blind,
        )

    def likelier(self, by: FloatArray | float, ids: IntArray) -> "Expansion":
        """The same with constants that are so much higher (c,), under other ids."""
        shrink, step, updated, evidence = self.after
        return Expansion(
            self.parent,
            ids,
            self.constant + by,
            self.gradient,
            self.information,
            self.covariance,
            After(shrink, step, updated, evidence + by),
            self.blind,
        )

    def of(self, mount: FloatArray, back: FloatArray, covariances: FloatArray) -> "Expansion":
        """By another tangent t, of covariances (h, 3, 3) of the parents' poses, where d = mount t and t = back d."""
        after = self.after
        updated = back @ after.updated @ back.T
        return Expansion(
            self.parent,
            self.ids,
            self.constant,
            self.gradient @ mount,
            mount.T @ self.information @ mount,
            covariances[self.parent],
            After(back @ after.shrink @ mount, after.step @ back.T, updated, after.evidence),
            self.blind,
        )

    @cached_property
    def after(self) -> After:
        if self.known is not None:
            return self.known
        shrink = np.asarray(np.linalg.inv(_IDENTITY + self.covariance @ self.information), dtype=np.float64)
        updated = shrink @ self.covariance
        updated = 0.5 * (updated + updated.swapaxes(-1, -2))
        step = (updated @ self.gradient[:, :, None])[..., 0]
        log_det = np.linalg.slogdet(shrink)[1]
        evidence = self.constant + 0.5 * ((self.gradient * step).sum(axis=1) + log_det)
        return After(shrink, step, updated, evidence)

    @property
    def shrink(self) -> FloatArray:
        return self.after.shrink

    @property
    def step(self) -> FloatArray:
        return self.after.step

    @property
    def updated(self) -> FloatArray:
        return self.after.updated

    @property
    def evidence(self) -> FloatArray:
        return self.after.evidence


class MixtureFactor(Protocol):
    """All that one instant's observation can mean."""

    @property
    def stamp_ns(self) -> int: ...

    @property
    def symmetric(self) -> bool:
        """Whether it is the same for a pose and for its copies under the map's symmetries: it tells no sides apart."""

    @property
    def by_compass(self) -> bool:
        """Whether it is about the heading plus the compass' offset, which an estimator may know.

        Its poses are then (x, y, heading + offset).
        """

    @property
    def by_sight(self) -> bool:
        """Whether a sensor on the robot saw it: then it is about the place where that sensor was when it saw it, which
        an estimator that knows its delay and how it is turned can tell from the robot's now."""

    @property
    def log_outlier(self) -> float:
        """log p(observation | nothing of it is right), the prior probability of that included."""

    @property
    def log_integral(self) -> float:
        """Logarithm of the integral of the sum over solutions, without the outlier, over all poses on and about the
        field (m^2 rad): how likely the observation is for a robot that may be anywhere. May cost as much as
        `solutions`."""

    def solutions(self) -> PoseSolutions:
        """All whole poses that explain it: to start from, to start anew from. None where it determines no whole pose.
        May be slow at first; then it is remembered."""

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        """The solutions that robots could have seen who are at poses (h, 3) up to covariances (h, 3, 3), robot frame.

        Gated: what a robot there would see once in ten thousand times or less is left out, so a pose may have none.
        """

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        """(...) log p(observation | pose) with all solutions and the outlier, for poses (..., 3)."""

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        """The solution of that id as plain factors, of errors independent of each other."""
