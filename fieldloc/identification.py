"""Which landmark of the map is which of a scan: by label, by where the robot is, or as the only way to explain all."""

from fieldloc.association import Belief, associate
from fieldloc.choice import choose_fix
from fieldloc.field import FieldMap
from fieldloc.fixes.labelling import label_landmarks
from fieldloc.measurements import LandmarkScan

_ENOUGH = 4  # fewer, and one that is none of the map lets a wrong place look like the only one


def identify(scan: LandmarkScan, field: FieldMap, belief: Belief | None) -> list[int | None]:
    """Map index per landmark of the scan, None where it is not on the map or not known beyond doubt."""
    out = [None if label is None else field.index_of(label) for label in scan.labels]
    if belief is not None:
        taken = frozenset(index for index in out if index is not None)
        for row, index in associate(scan, field, belief, taken).items():
            out[row] = index
    elif len(out) >= _ENOUGH and all(label is None for label in scan.labels):
        solutions = label_landmarks(
            field.positions, scan.range_bearing, scan.covariance, field.positions_covariance, scan.robot_from_sensor
        )
        if (best := choose_fix(scan.stamp_ns, solutions, None)) is not None:
            return list(best.matches)
    return out
