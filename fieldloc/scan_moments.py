"""Many symmetric matrices by their upper triangles: several times faster than products of small matrices."""

import numpy as np

from fieldloc.pose import FloatArray

Upper = tuple[FloatArray, FloatArray, FloatArray]
"""(xx, xy, yy) of matrices (2, 2)."""


def moments(range_bearing: FloatArray, covariance: FloatArray) -> FloatArray:
    """(14, n): where landmarks were seen x, y, range; variances of range and bearing; then (xx, xy, yy) each of what
    comes of the range's variance, of the bearing's at one metre, and of what they share at one metre."""
    r, b = range_bearing.T
    c, s = np.cos(b), np.sin(b)
    rr, rb, bb = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    along = [c * c * rr, c * s * rr, s * s * rr]
    across = [s * s * bb, -c * s * bb, c * c * bb]
    mixed = [-2.0 * c * s * rb, (c * c - s * s) * rb, 2.0 * c * s * rb]
    return np.stack([r * c, r * s, r, rr, bb, *along, *across, *mixed])


def determinant(upper: Upper | FloatArray) -> FloatArray:
    xx, xy, yy = upper
    return np.asarray(xx * yy - xy * xy)


def upper(covariances: FloatArray) -> Upper:
    """(xx, xy, yy) of (..., 2, 2)."""
    return covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]


def upper_of(covariances: FloatArray) -> tuple[FloatArray, ...]:
    """Six numbers (...) of (..., 3, 3)."""
    flat = covariances.reshape(*covariances.shape[:-2], 9)
    return tuple(flat[..., k] for k in (0, 1, 2, 4, 5, 8))


def turned(covariances: FloatArray, heading_rad: FloatArray) -> Upper:
    """(xx, xy, yy) of covariances (..., 2, 2) in field axes, in axes turned by the heading (...)."""
    xx, xy, yy = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    cc, cs, ss = c * c, c * s, s * s
    return cc * xx + 2.0 * cs * xy + ss * yy, (cc - ss) * xy + cs * (yy - xx), ss * xx - 2.0 * cs * xy + cc * yy
