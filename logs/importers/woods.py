"""The "lost in the woods" data set of the University of Toronto (course AER1513): a robot among tubes on a floor.

A laser ranges 17 vertical tubes at 10 Hz, wheels give speed and turning rate, a motion capture system the truth. The
MATLAB file holds everything at common times; r and b are zero where a tube was not seen. Range and bearing are those
of the tubes' middles seen from the laser, which sits d ahead of the robot's centre:
    r = |l - (p + d [cos, sin])|,    b = direction of that vector - heading.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Odometry, Truth
from fieldloc.pose import FloatArray
from logs.importers.result import Cut, Imported, Progress, write_log

LEFT_SIGMA_MPS = 0.03
"""Sideways slip, which the data set does not state: about the r.m.s. of the truth's sideways velocity (0.027 m/s)."""

SOURCE = {
    "source": "Lost in the woods, dataset2.mat",
    "attribution": "University of Toronto Institute for Aerospace Studies, course AER1513",
    "licence": "Apache-2.0",
}
_UNREADABLE = (  # all that scipy was seen to raise on damaged files
    OSError,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    MemoryError,
    NotImplementedError,
    zlib.error,
    MatReadError,
)
_COLUMNS = ("t", "x_true", "y_true", "th_true", "true_valid", "v", "om")
_SCALARS = ("d", "r_var", "b_var", "v_var", "om_var")
_MATRICES = ("l", "r", "b")


def import_woods(
    mat_path: str | Path,
    out: str | Path,
    anonymous: bool = False,
    max_range_m: float | None = None,
    progress: Progress | None = None,
) -> Imported:
    """Write the log; FieldlocError if the file is not that data set.

    The time stamps are the file's own, from 0. The tubes' diameters and the accuracy of their survey are not stated:
    the map has 0 for both. Odometry's covariance and that of ranges and bearings are the file's. A scan in which
    nothing is (or remains) seen is written, empty; truth only where the file says that it is valid.
    """
    cut = Cut(anonymous, max_range_m)
    data = _load(Path(mat_path))
    stamps = [round(t * 1e9) for t in data["t"].tolist()]
    warnings: list[str] = []
    odometry, scans = list(_odometry(data, stamps, warnings)), list(_scans(data, stamps, cut, warnings))
    streams = (odometry, scans, list(_truth(data, stamps)))
    config = {"anonymous": anonymous, "max_range_m": max_range_m, "left_sigma_mps": LEFT_SIGMA_MPS}
    return write_log(out, _field(data), streams, SOURCE, config, warnings, progress)


def _field(data: dict[str, FloatArray]) -> FieldMap:
    tubes = tuple(Landmark(str(i + 1), position, 0.0, np.zeros((2, 2))) for i, position in enumerate(data["l"]))
    return FieldMap("woods", np.zeros((0, 2, 2)), np.zeros((0, 3)), tubes)


def _odometry(data: dict[str, FloatArray], stamps: list[int], warnings: list[str]) -> Iterator[Odometry]:
    covariance = np.diag([float(data["v_var"]), LEFT_SIGMA_MPS**2, float(data["om_var"])])
    velocities = np.stack([data["v"], np.zeros_like(data["v"]), data["om"]], axis=-1)
    good = np.isfinite(velocities).all(axis=-1)
    if not good.all():
        warnings.append(f"{np.count_nonzero(~good)} rows of v and om left out: not numbers")
    for i in np.flatnonzero(good).tolist():
        yield Odometry(stamps[i], velocities[i], covariance)


def _scans(data: dict[str, FloatArray], stamps: list[int], cut: Cut, warnings: list[str]) -> Iterator[LandmarkScan]:
    one = np.diag([float(data["r_var"]), float(data["b_var"])])
    sensor = np.array([float(data["d"]), 0.0, 0.0])
    r, b = data["r"], data["b"]
    good = (r > 0.0) & np.isfinite(r) & np.isfinite(b)
    if bad := np.count_nonzero((r != 0.0) & ~good):
        warnings.append(f"{bad} ranges and bearings left out: not numbers, or behind the sensor")
    for i, stamp in enumerate(stamps):
        seen = [j for j in np.flatnonzero(good[i]).tolist() if cut.keeps(r[i, j])]
        labels = tuple(cut.label(str(j + 1)) for j in seen)
        range_bearing = np.stack([r[i, seen], b[i, seen]], axis=-1)
        yield LandmarkScan(stamp, labels, range_bearing, np.tile(one, (len(seen), 1, 1)), sensor)


def _truth(data: dict[str, FloatArray], stamps: list[int]) -> Iterator[Truth]:
    poses = np.stack([data["x_true"], data["y_true"], data["th_true"]], axis=-1)
    for i in np.flatnonzero((data["true_valid"] != 0.0) & np.isfinite(poses).all(axis=-1)).tolist():
        yield Truth(stamps[i], poses[i])


def _load(path: Path) -> dict[str, FloatArray]:
    """The arrays by name: columns (k,), scalars (), l (n, 2), r and b (k, n); checked to fit each other."""
    names = (*_COLUMNS, *_SCALARS, *_MATRICES)
    try:
        raw = scipy.io.loadmat(str(path), appendmat=False, variable_names=names)
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such file; give the data set's .mat file") from None
    except _UNREADABLE as error:
        raise FieldlocError(f"{path}: cannot be read as a MATLAB file: {error}") from None
    if missing := [name for name in names if name not in raw]:
        raise FieldlocError(f"{path}: not the woods data set: it has no {', '.join(missing)}")
    try:
        data = {name: np.asarray(raw[name], dtype=np.float64) for name in names}
    except (TypeError, ValueError) as error:
        raise FieldlocError(f"{path}: not the woods data set: {error}") from None
    count, tubes = data["t"].size, len(data["l"])
    shapes = dict.fromkeys(_COLUMNS, (count, 1)) | dict.fromkeys(_SCALARS, (1, 1))
    shapes |= {"l": (tubes, 2), "r": (count, tubes), "b": (count, tubes)}
    for name, shape in shapes.items():
        if data[name].shape != shape:
            raise FieldlocError(f"{path}: {name} has shape {data[name].shape}, needs {shape}")
    data |= {name: data[name][:, 0] for name in _COLUMNS} | {name: data[name][0, 0] for name in _SCALARS}
    for name in ("t", "l", *_SCALARS):
        if not np.isfinite(data[name]).all():
            raise FieldlocError(f"{path}: {name} holds a value that is not a number")
    for name in ("r_var", "b_var", "v_var", "om_var"):
        if not data[name] > 0.0:
            raise FieldlocError(f"{path}: {name} is {data[name]}, a variance must be above 0")
    if count == 0 or data["t"][0] < 0.0 or not (np.diff(data["t"]) > 0.0).all():
        raise FieldlocError(f"{path}: t must be increasing, from 0 or later")
    return data
