"""A scan of landmarks as a mixture: which of the map's each of them may be."""

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.solution_mixture import SolutionMixture


class ScanMixture(SolutionMixture):
    def landmarks_seen(self, pose: FloatArray) -> tuple[int, ...]:
        """Map indices of what was seen, by the likeliest explanation for a robot at the pose (3,)."""
        raise NotImplementedError


def scan_mixture(scan: LandmarkScan, field: FieldMap, detection: Detection, wider: FloatArray) -> ScanMixture | None:
    """wider: (m, 2) by how much variances of range and bearing are to be widened, per landmark of the map."""
    raise NotImplementedError
