"""All that an odometry has said, and the motions between any stamps that it makes: many at once, as arrays.

The same as estimators.motion.HeldVelocity says one by one, to rounding: for who looks back.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimators.config import MotionNoise
from estimators.motion import (
    CALIBRATION,
    GAUSS_POINTS,
    MAX_GAP_S,
    MAX_PERIOD_S,
    PARTS,
    SAID,
    Increment,
    noise_density,
    stated_parts,
)
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray


class Said:
    """noise, delay_s: as of HeldVelocity."""

    def __init__(self, noise: MotionNoise, delay_s: float) -> None:
        self._noise = noise
        self._delay_ns = int(max(delay_s, 0.0) * 1e9)
        self._held: list[Odometry] = []  # stamped when they are due
        self._from_ns: list[int] = []  # from when on each is believed
        self._period_s: list[float] = []
        self.stamp_ns: int | None = None

    def advance(self, stamp_ns: int) -> int:
        """The stamp that is reached: one that runs backwards is not."""
        self.stamp_ns = stamp_ns if self.stamp_ns is None else max(stamp_ns, self.stamp_ns)
        return self.stamp_ns

    def hold(self, odometry: Odometry) -> None:
        """After `advance` to its stamp."""
        assert self.stamp_ns is not None
        due_ns = odometry.stamp_ns + self._delay_ns
        period_s = 0.0
        if self._held:
            elapsed_s = (due_ns - self._held[-1].stamp_ns) * 1e-9
            if elapsed_s < 0.0:
                return
            period_s = min(elapsed_s, MAX_PERIOD_S) if elapsed_s > 0.0 else self._period_s[-1]
        self._held.append(Odometry(due_ns, odometry.velocity, odometry.covariance))
        self._from_ns.append(max(due_ns, self.stamp_ns))
        self._period_s.append(period_s)

    def motions(self, stamps_ns: Sequence[int]) -> tuple[Increment, ...]:
        """Between these stamps, which rise."""
        if len(stamps_ns) < 2:
            return ()
        stamps = np.array(stamps_ns, dtype=np.int64)
        since = np.array(self._from_ns, dtype=np.int64)
        until = np.array([one.stamp_ns for one in self._held], dtype=np.int64) + int(self._noise.max_hold_s * 1e9)
        ends = until[until < np.append(since[1:], np.iinfo(np.int64).max)]  # of those that nothing comes after in time
        edges = np.unique(np.concatenate([stamps, since, ends]))
        edges = edges[(edges >= stamps[0]) & (edges <= stamps[-1])]
        start, duration_s = edges[:-1], np.diff(edges) * 1e-9
        which = np.searchsorted(since, start, side="right") - 1
        held = which >= 0
        held[held] = start[held] < until[which[held]]
        moved, covariance, by_calibration, parts = self._pieces(np.where(held, which, -1), duration_s)
        return _joined(np.searchsorted(stamps, start, side="right") - 1, moved, covariance, by_calibration, parts)

    def _pieces(
        self, which: NDArray[np.intp], duration_s: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Motions (m, 3), covariances, changes with the calibration and parts, of what is held (-1 for nothing)."""
        noise, count, held = self._noise, len(which), which >= 0
        velocity, stated = np.zeros((count, 3)), np.zeros((count, 3, 3))
        says = np.array([one.covariance is not None for one in self._held], dtype=bool)
        if held.any():
            velocity[held] = np.array([one.velocity for one in self._held])[which[held]]
        says_so = held.copy()
        says_so[held] = says[which[held]]
        tangent = velocity * duration_s[:, None]
        spread = se2.right_jacobian(tangent)
        density = np.stack(noise_density(noise, *np.abs(velocity).T), axis=-1)
        parts = np.zeros((count, PARTS, 3, 3))
        for point in GAUSS_POINTS:
            to_end = se2.adjoint(se2.inverse(se2.exp(point * tangent)))
            parts[:, 0] += (to_end[:, :, :2] * density[:, None, :2]) @ np.swapaxes(to_end[:, :, :2], 1, 2)
            parts[:, 1:SAID] += (
                density[:, 2:, None, None] * (to_end[:, :, 2:] @ np.swapaxes(to_end[:, :, 2:], 1, 2))[:, None]
            )
        parts *= 0.5 * duration_s[:, None, None, None]
        parts[says_so | ~held] = 0.0
        if says_so.any():
            known = np.array([np.zeros((3, 3)) if one.covariance is None else one.covariance for one in self._held])
            period_s = np.array(self._period_s)[which]
            stated[says_so] = known[which[says_so]]
            scale = np.where(period_s > 0.0, period_s, duration_s) * duration_s
            there = stated_parts(stated * scale[:, None, None])[says_so]
            turn = spread[says_so][:, None]
            parts[says_so] = turn @ there @ np.swapaxes(turn, 2, 3)
        covariance = parts.sum(axis=1)
        silent_s = np.minimum(duration_s, MAX_GAP_S)
        position, heading = noise.silent_m_per_sqrt_s**2, noise.silent_rad_per_sqrt_s**2
        covariance[~held] = np.diag([position, position, heading]) * silent_s[~held, None, None]
        forward, left, turn = tangent.T
        change = np.zeros((count, 3, CALIBRATION))
        change[:, 0, 0], change[:, 0, 3], change[:, 0, 4] = forward, -left, duration_s
        change[:, 1, 0], change[:, 1, 3], change[:, 1, 5] = left, forward, duration_s
        change[:, 2, 1], change[:, 2, 2], change[:, 2, 6] = turn, forward, duration_s
        turning = np.abs(velocity[:, 2])
        change[:, 0, 7], change[:, 1, 7] = -turning * forward, -turning * left
        change[~held] = 0.0
        return se2.exp(tangent), covariance, spread @ change, parts


def _joined(
    group: NDArray[np.intp], moved: FloatArray, covariance: FloatArray, by_calibration: FloatArray, parts: FloatArray
) -> tuple[Increment, ...]:
    """Of each group, which are in order and none of them empty, one after the other."""
    first = np.flatnonzero(np.diff(group, prepend=-1))
    lasts = np.diff(first, append=len(group))
    out = [moved[first], covariance[first], by_calibration[first], parts[first]]
    for k in range(1, int(lasts.max())):
        more = np.flatnonzero(lasts > k)
        piece = first[more] + k
        back = se2.adjoint(se2.inverse(moved[piece]))
        backwards = np.swapaxes(back, 1, 2)
        out[0][more] = se2.compose(out[0][more], moved[piece])
        out[1][more] = back @ out[1][more] @ backwards + covariance[piece]
        out[2][more] = back @ out[2][more] + by_calibration[piece]
        out[3][more] = back[:, None] @ out[3][more] @ backwards[:, None] + parts[piece]
    return tuple(map(Increment, *out))
