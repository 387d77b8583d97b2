"""The covariance on the ground out of one in space."""

import numpy as np

from fieldloc.pose import FloatArray

_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and the turn about z of a 6 x 6
_SINGULAR = 1e-9  # smallest eigenvalue of a correlation matrix that has an inverse worth having


def planar_covariance(covariance: FloatArray, widest: float = 1e6) -> FloatArray | None:
    """(3, 3) of x, y, heading out of (6, 6); None where it is none, has no inverse, or a sigma is above `widest`."""
    planar = np.asarray(covariance[_ROWS])
    planar = 0.5 * (planar + planar.T)
    variances = planar.diagonal()
    if not ((variances > 1.0 / widest**4) & (variances <= widest**2)).all():  # False for NaN too
        return None
    scale = 1.0 / np.sqrt(variances)
    correlation = planar * scale[:, None] * scale
    if not (np.abs(correlation) <= 1.0 + _SINGULAR).all():
        return None
    return planar if np.linalg.eigvalsh(correlation)[0] > _SINGULAR else None
