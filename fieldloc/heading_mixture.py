"""A compass reading as a mixture: the heading plus the compass' slowly varying offset, and disturbances."""

import math

import numpy as np

from fieldloc.measurements import Compass
from fieldloc.mixture import MixtureFactor
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import HeadingStack

_DISTURBED = 0.1


def heading_mixture(compass: Compass, wider: float) -> MixtureFactor:
    """wider: by how much its variance is to be widened for being much the same as the last one's."""
    stack = HeadingStack(np.array([compass.heading_rad]), np.array([[[wider * compass.sigma_rad**2]]]))
    return SolutionMixture(
        compass.stamp_ns,
        ((stack, np.log1p([-_DISTURBED])),),
        math.log(_DISTURBED / math.tau),
        symmetric=False,
        area_m2=1.0,
        by_compass=True,
    )
