"""When a compass' offset has a value of its own: at knots in time, so many that it moves little between two."""

from collections.abc import Sequence

import numpy as np

from estimators.config import Compass
from fieldloc.pose import FloatArray

_KNOTS_PER_OFFSET = 20  # between two knots the offset gains a tenth of its variance: little beside a compass' noise


def knot_s(config: Compass) -> float:
    """Time between two values of the offset."""
    return config.offset_s / _KNOTS_PER_OFFSET


def at_nodes(
    stamps_ns: Sequence[int], compass_rad: FloatArray, variances: FloatArray, config: Compass
) -> tuple[FloatArray, FloatArray]:
    """The offset and its variance at each node (n,): that of the nearest knot; what is believed of any without one."""
    if not len(compass_rad):
        return np.zeros(len(stamps_ns)), np.full(len(stamps_ns), config.offset_sigma_rad**2)
    elapsed_s = (np.array(stamps_ns) - stamps_ns[0]) * 1e-9
    knots = np.round(elapsed_s / knot_s(config)).astype(int)
    return compass_rad[knots], variances[knots]
