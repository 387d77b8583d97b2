"""A trajectory as text that other programs read. Times are the log's own, every nanosecond of them."""

import csv
from pathlib import Path

import numpy as np

from fieldloc.errors import FieldlocError
from logs.atomic import atomic_text
from logs.trajectory import Trajectory

CSV_COLUMNS = (
    "stamp_s",
    "stamp_ns",
    "x_m",
    "y_m",
    "heading_rad",
    "cov_x_x_m2",
    "cov_x_y_m2",
    "cov_x_heading_m_rad",
    "cov_y_y_m2",
    "cov_y_heading_m_rad",
    "cov_heading_heading_rad2",
)


def exact_seconds(stamp_ns: int) -> str:
    """The stamp in seconds with nine decimals, not rounded: 1248444187156000000 -> "1248444187.156000000"."""
    seconds, rest_ns = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{rest_ns:09d}"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """`t x y z qx qy qz qw` a line, as evo and the TUM tools read it. FieldlocError when empty or not writable.

    z is 0 and the quaternion turns about z; numbers have as many digits as it takes to read the same double back.
    """
    _check(path, trajectory)
    half = 0.5 * trajectory.poses[:, 2]
    columns = np.column_stack([trajectory.poses[:, :2], np.sin(half), np.cos(half)]).tolist()
    with atomic_text(path) as file:
        for stamp_ns, (x, y, qz, qw) in zip(trajectory.stamps_ns.tolist(), columns, strict=True):
            file.write(f"{exact_seconds(stamp_ns)} {x!r} {y!r} 0.0 0.0 0.0 {qz!r} {qw!r}\n")


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """CSV_COLUMNS; the covariance is of (x_m, y_m, heading_rad) in field axes, its cells empty where none is known.

    FieldlocError when empty or not writable.
    """
    _check(path, trajectory)
    n = len(trajectory)
    upper = np.triu_indices(3)
    known = trajectory.covariances
    covariances = [[""] * 6] * n if known is None else known[:, upper[0], upper[1]].tolist()
    with atomic_text(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(CSV_COLUMNS)
        for stamp_ns, pose, covariance in zip(
            trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), covariances, strict=True
        ):
            writer.writerow([exact_seconds(stamp_ns), stamp_ns, *pose, *covariance])


def _check(path: Path, trajectory: Trajectory) -> None:
    if len(trajectory) == 0:
        raise FieldlocError(f"nothing to write to {path}: the log holds no estimates; run an estimator on it first")
