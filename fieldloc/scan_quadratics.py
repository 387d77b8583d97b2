"""What assignments of a scan say of the sensor's pose, and the two errors that its landmarks share taken out of it.

With these two as unknowns v of unit variance beside the pose's tangent d, landmarks are independent of each other:

    log p(scan | d, v) = constant + gradient . [d v] - 0.5 [d v]' information [d v]

and p(scan | d) is the integral over v of that times its normal density, which is exact: with the blocks of d, v and
both, it is again a quadratic, of

    information_dd - information_dv (1 + information_vv)^-1 information_vd

and so on. By how much the integral is lower at its peak, the determinant of 1 + information_vv tells.
"""

from typing import NamedTuple

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.scan_model import Terms


class Freed(NamedTuple):
    """What is shared, given the pose: covariance (c, 2, 2), and mean (c, 2, 4): minus its change with the pose's
    tangent, then its value where that is zero."""

    covariance: FloatArray
    mean: FloatArray


class Quadratics(NamedTuple):
    """constant (c,), gradient (c, k), information (c, k, k); k is 3, or 5 with the shared errors."""

    constant: FloatArray
    gradient: FloatArray
    information: FloatArray

    def freed(self) -> Freed | None:
        """None where nothing is shared."""
        if self.gradient.shape[1] == 3:
            return None
        covariance = _inverse_of_one_and(self.information[:, 3:, 3:])
        both = np.concatenate([self.information[:, 3:, :3], self.gradient[:, 3:, None]], axis=-1)
        return Freed(covariance, covariance @ both)

    def of_pose(self, freed: Freed | None) -> "Quadratics":
        """Of the pose alone; what is shared only takes its freedom, `log_shared` is in the constant."""
        if freed is None:
            return self
        pulled = self.information[:, :3, 3:] @ freed.mean
        return Quadratics(
            self.constant + 0.5 * (self.gradient[:, 3:] * freed.mean[..., 3]).sum(axis=1),
            self.gradient[:, :3] - pulled[..., 3],
            self.information[:, :3, :3] - pulled[..., :3],
        )


def quadratics(terms: Terms) -> tuple[Quadratics, FloatArray]:
    """Sums over the observations; and each one's Jacobian beside its error, weighted (c, n, 2, k + 1)."""
    shape, size = (len(terms.error), 2 * terms.error.shape[1]), terms.jacobian.shape[-1]
    weighted = terms.weight @ np.concatenate([terms.jacobian, terms.error[..., None]], axis=-1)
    back = np.swapaxes(terms.jacobian.reshape(*shape, size), -1, -2) @ weighted.reshape(*shape, size + 1)
    constant = terms.log_peak.sum(axis=1) - 0.5 * (terms.error * weighted[..., size]).sum(axis=(1, 2))
    if terms.of_shared is not None:
        constant = constant + log_shared(terms.of_shared.sum(axis=1))
    return Quadratics(constant, -back[..., size], back[..., :size]), weighted


def log_shared(of_shared: FloatArray) -> FloatArray:
    """(...) by how much (log) a density's peak is lower for what is shared, from Terms.of_shared summed up (..., 3)."""
    rr, rb, bb = of_shared[..., 0], of_shared[..., 1], of_shared[..., 2]
    return np.asarray(-0.5 * np.log((1.0 + rr) * (1.0 + bb) - rb * rb))


def _inverse_of_one_and(matrix: FloatArray) -> FloatArray:
    """(1 + matrix)^-1 of symmetric ones (c, 2, 2)."""
    a, b, d = 1.0 + matrix[:, 0, 0], matrix[:, 0, 1], 1.0 + matrix[:, 1, 1]
    out = np.empty_like(matrix)
    out[:, 0, 0], out[:, 1, 1] = d, a
    out[:, 0, 1] = out[:, 1, 0] = -b
    out /= (a * d - b * b)[:, None, None]
    return out
