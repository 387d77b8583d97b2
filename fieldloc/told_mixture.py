"""A pose that the robot is told as a mixture: that pose, or it was told wrongly and is anywhere."""

import numpy as np

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import PoseStack


def told_mixture(
    stamp_ns: int, pose: FloatArray, covariance: FloatArray, wrong: float, anywhere: Region
) -> SolutionMixture:
    """pose: (3,); covariance: (3, 3) of it in field axes. wrong: prior of a mistake; `anywhere`: where it is then."""
    stack = PoseStack(pose[None], se2.rotate_covariance(covariance[None], -pose[None, 2]))
    log_volume = anywhere.log_volume
    return SolutionMixture(
        stamp_ns,
        ((stack, np.log1p([-wrong])),),
        float(np.log(wrong)) - log_volume,
        symmetric=not len(anywhere.symmetries),
        area_m2=float(np.exp(log_volume)) / (2 * np.pi),
    )
