"""A trajectory as arrays: what estimates and truth become before they are compared, exported or drawn."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Truth
from fieldloc.pose import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """field_from_robot over time; n may be 0. ValueError unless shapes agree and the stamps rise strictly.

    stamps_ns: (n,). poses: (n, 3). covariances: (n, 3, 3) of (x_m, y_m, heading_rad) in field axes; None where unknown.
    """

    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        if self.stamps_ns.dtype != np.int64 or self.stamps_ns.ndim != 1:
            raise ValueError("stamps_ns must be one-dimensional int64")
        if self.poses.shape != (n, 3):
            raise ValueError(f"poses have shape {self.poses.shape}, {n} stamps need ({n}, 3)")
        if self.covariances is not None and self.covariances.shape != (n, 3, 3):
            raise ValueError(f"covariances have shape {self.covariances.shape}, {n} stamps need ({n}, 3, 3)")
        if not np.all(np.diff(self.stamps_ns) > 0):
            raise ValueError("stamps_ns must rise strictly")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def select(self, indices: NDArray[np.intp] | slice) -> "Trajectory":
        """The poses at rising indices."""
        covariances = None if self.covariances is None else self.covariances[indices]
        return Trajectory(self.stamps_ns[indices], self.poses[indices], covariances)

    def stamps_s(self) -> FloatArray:
        """(n,) seconds, each the double nearest to the exact decimal: what a reader of the exported text gets."""
        # Python rounds the quotient of two ints correctly; going through a float first would round twice.
        return np.array([ns / 1_000_000_000 for ns in self.stamps_ns.tolist()], dtype=np.float64)


def from_estimates(estimates: Iterable[Estimate]) -> Trajectory:
    """Sorted by stamp; of several estimates at one stamp the last given wins.

    FieldlocError at a pose that is not finite. A covariance that is not passes: evaluation counts it.
    """
    by_stamp = {e.stamp_ns: e for e in estimates}
    kept = [by_stamp[stamp] for stamp in sorted(by_stamp)]
    covariances = np.array([e.covariance for e in kept], dtype=np.float64).reshape(-1, 3, 3)
    return Trajectory(*_stamps_and_poses(kept, "estimate"), covariances)


def from_truth(truths: Iterable[Truth]) -> Trajectory:
    """Sorted by stamp; of several poses at one stamp the last given wins.

    FieldlocError at a pose that is not finite.
    """
    by_stamp = {t.stamp_ns: t for t in truths}
    return Trajectory(*_stamps_and_poses([by_stamp[stamp] for stamp in sorted(by_stamp)], "truth"))


def _stamps_and_poses(records: list[Estimate] | list[Truth], kind: str) -> tuple[IntArray, FloatArray]:
    stamps_ns = np.array([r.stamp_ns for r in records], dtype=np.int64)
    poses = np.array([r.pose for r in records], dtype=np.float64).reshape(-1, 3)
    broken = ~np.isfinite(poses).all(axis=1)
    if broken.any():
        stamp_s = int(stamps_ns[int(np.argmax(broken))]) / 1e9
        raise FieldlocError(
            f"the {kind} at {stamp_s:.3f} s holds a value that is not finite ({int(broken.sum())} such poses): "
            "remove them from the log"
        )
    return stamps_ns, poses
