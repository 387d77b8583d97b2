"""The UTIAS multi-robot data sets MRCLAM 1-9 (Leung, Halpern, Barfoot, Liu, IJRR 30(8), 2011).

Five robots drive among 15 equal tubes in a hall; each has a camera that reads the tubes' and the other robots' barcodes
and ranges them by their size, a log of the velocities it was told to drive, and a motion capture system's truth.
"""

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Odometry, Truth
from fieldloc.pose import FloatArray
from logs.importers.folder import DataFolder, Row
from logs.importers.result import Cut, Imported, Progress, write_log

RANGE_SIGMA_RELATIVE = 0.05
RANGE_SIGMA_FLOOR_M = 0.02
BEARING_SIGMA_RAD = 0.017
"""The data set states no noise. Against its truth ranges scatter by about 4.5 %, mostly because a size tells a depth
and not a distance, and bearings by 0.009 rad, around an offset of each robot's camera of up to 0.0135 rad:
hypot(0.009, 0.0135) rounded up. Ranges are written as the source has them; estimators learn what distorts them."""

SOURCE = {
    "source": "UTIAS Multi-Robot Cooperative Localization and Mapping Dataset",
    "attribution": "K. Leung, Y. Halpern, T. Barfoot, H. Liu: The UTIAS multi-robot cooperative localization and "
    "mapping dataset, IJRR 30(8), 2011",
}
_LANDMARKS = "Landmark_Groundtruth.dat"
_ROBOTS = range(1, 6)  # subjects; the landmarks are 6 and up


@dataclass(frozen=True, slots=True)
class _Noise:
    """Standard deviations; a range has `relative` of itself, at least `floor_m`."""

    relative: float
    floor_m: float
    bearing_rad: float

    def __post_init__(self) -> None:
        if not (self.relative >= 0.0 and self.floor_m > 0.0 and self.bearing_rad > 0.0):
            raise ValueError("standard deviations must be above 0")

    def covariances(self, ranges_m: FloatArray) -> FloatArray:
        """(n, 2, 2) of ranges (n,) and their bearings."""
        out = np.zeros((len(ranges_m), 2, 2))
        out[:, 0, 0] = np.maximum(self.relative * ranges_m, self.floor_m) ** 2
        out[:, 1, 1] = self.bearing_rad**2
        return out


def import_utias(
    path: str | Path,
    robot: int,
    out: str | Path,
    anonymous: bool = False,
    max_range_m: float | None = None,
    range_sigma_relative: float = RANGE_SIGMA_RELATIVE,
    range_sigma_floor_m: float = RANGE_SIGMA_FLOOR_M,
    bearing_sigma_rad: float = BEARING_SIGMA_RAD,
    progress: Progress | None = None,
) -> Imported:
    """Write one robot's log; path is the data set's folder, its .tar.gz or its .zip. FieldlocError names file and line.

    Odometry is the logged commands as they are, without a stated covariance. Observations of equal stamp are one image,
    one scan; what the robot saw of other robots is dropped. A landmark's label is its subject number; its position
    has the survey's standard deviations, its diameter is not stated and 0 on the map. Stamps keep the source's digits.
    A range has the standard deviation range_sigma_relative of itself, at least range_sigma_floor_m.
    """
    cut = Cut(anonymous, max_range_m)
    folder = DataFolder(Path(path), _LANDMARKS)
    if f"Robot{robot}_Odometry.dat" not in folder.names:
        robots = sorted(
            name[5:-13] for name in folder.names if name.startswith("Robot") and name.endswith("_Odometry.dat")
        )
        raise FieldlocError(f"{path}: there is no robot {robot}, only {', '.join(robots) or 'none'}")
    warnings: list[str] = []
    field = _field(folder)
    noise = _Noise(range_sigma_relative, range_sigma_floor_m, bearing_sigma_rad)
    scans = _scans(folder, robot, field, cut, noise, warnings)
    streams = (_odometry(folder, robot), scans, _truth(folder, robot))
    config = {
        "robot": robot,
        "anonymous": anonymous,
        "max_range_m": max_range_m,
        "range_sigma_relative": range_sigma_relative,
        "range_sigma_floor_m": range_sigma_floor_m,
        "bearing_sigma_rad": bearing_sigma_rad,
    }
    return write_log(out, field, streams, SOURCE, config, warnings, progress)


def _field(folder: DataFolder) -> FieldMap:
    landmarks = []
    for row in folder.rows(_LANDMARKS, 5):
        position, sigma = np.array([row.number(1), row.number(2)]), np.array([row.number(3), row.number(4)])
        landmarks.append(Landmark(str(row.integer(0)), position, 0.0, np.diag(sigma**2)))
    try:
        return FieldMap("utias", np.zeros((0, 2, 2)), np.zeros((0, 3)), tuple(landmarks))
    except ValueError as error:
        raise FieldlocError(f"{folder.path}: {_LANDMARKS}: {error}") from None


def _odometry(folder: DataFolder, robot: int) -> list[Odometry]:
    rows = folder.rows(f"Robot{robot}_Odometry.dat", 3)
    records = [Odometry(_stamp_ns(row), np.array([row.number(1), 0.0, row.number(2)])) for row in rows]
    return sorted(records, key=lambda record: record.stamp_ns)


def _truth(folder: DataFolder, robot: int) -> list[Truth]:
    rows = folder.rows(f"Robot{robot}_Groundtruth.dat", 4)
    records = [Truth(_stamp_ns(row), np.array([row.number(1), row.number(2), row.number(3)])) for row in rows]
    return sorted(records, key=lambda record: record.stamp_ns)


def _scans(
    folder: DataFolder, robot: int, field: FieldMap, cut: Cut, noise: _Noise, warnings: list[str]
) -> list[LandmarkScan]:
    """Each image with a barcode in it, also where no landmark remains."""
    subjects = _subjects(folder)
    images: dict[int, list[tuple[str, float, float]]] = {}
    unknown: list[int] = []
    off_map: list[int] = []
    for row in folder.rows(f"Robot{robot}_Measurement.dat", 4):
        barcode, range_m, bearing_rad = row.integer(1), row.number(2), row.number(3)
        if range_m <= 0.0:
            raise row.refuse(f"a range of {range_m:g} m")
        image = images.setdefault(_stamp_ns(row), [])
        subject = subjects.get(barcode)
        if subject is None:
            unknown.append(barcode)
        elif subject in _ROBOTS:
            continue
        elif field.index_of(str(subject)) is None:
            off_map.append(subject)
        elif cut.keeps(range_m):
            image.append((str(subject), range_m, bearing_rad))
    warnings += _dropped(unknown, "barcode", "Barcodes.dat")
    warnings += _dropped(off_map, "subject", _LANDMARKS)
    scans = []
    for stamp, seen in sorted(images.items()):
        range_bearing = np.array([(r, b) for _, r, b in seen]).reshape(-1, 2)
        labels = tuple(cut.label(label) for label, _, _ in seen)
        scans.append(LandmarkScan(stamp, labels, range_bearing, noise.covariances(range_bearing[:, 0])))
    return scans


def _subjects(folder: DataFolder) -> dict[int, int]:
    """Subject by barcode."""
    subjects: dict[int, int] = {}
    for row in folder.rows("Barcodes.dat", 2):
        if row.integer(1) in subjects:
            raise row.refuse(f"barcode {row.integer(1)} a second time")
        subjects[row.integer(1)] = row.integer(0)
    return subjects


def _dropped(numbers: list[int], noun: str, table: str) -> list[str]:
    if not numbers:
        return []
    names = ", ".join(map(str, sorted(set(numbers))))
    plural = "" if len(numbers) == 1 else "s"
    return [f"{len(numbers)} observation{plural} left out: {noun} {names} not in {table}"]


def _stamp_ns(row: Row) -> int:
    """The first column's decimal seconds without a float in between."""
    try:
        stamp_ns = int((Decimal(row.words[0]) * 10**9).to_integral_value())
    except (ArithmeticError, ValueError):  # not a number; NaN or infinity
        raise row.refuse(f"'{row.words[0]}' is not a time") from None
    if not 0 <= stamp_ns < 2**63:
        raise row.refuse(f"{row.words[0]} s is no time that a log can hold")
    return stamp_ns
