"""Covariances that stay honest where first-order propagation does not: far, small posts.

The angle between two posts is known to a thousandth of a radian, the ratio of their sizes to some percent. So the error
of a fix runs along the circle of equal angle, and the circle bends: a straight ellipse as thin as first order draws it
misses the true pose by many of its standard deviations. The second moment about the solution, taken over the noise of
the sizes by Gauss-Hermite quadrature and to first order over the rest, covers it. It tends to the first-order
covariance as the noise gets small.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fieldloc.covariance import propagate
from fieldloc.pose import FloatArray, wrap

# pose (..., 3), its Jacobian (..., 3, n) by inputs (..., n), covariance (..., 3, 3) from all else, solvable (...)
Solve = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]]

UNKNOWN = np.diag(np.full(3, np.inf))  # the covariance of a pose of which nothing is known

_HONEST = 1.05  # first order may miss this much of the variance in the direction where it misses most
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)  # out to 2.86 standard deviations
_GRID = np.stack(np.meshgrid(_NODES, _NODES, indexing="ij"), axis=-1).reshape(-1, 2)
_GRID_WEIGHTS = np.outer(_WEIGHTS, _WEIGHTS).ravel() / _WEIGHTS.sum() ** 2


def honest_covariance(solve: Solve, inputs: FloatArray, covariance: FloatArray, weak: tuple[int, int]) -> FloatArray:
    """Covariance (..., 3, 3) of the solution at inputs (..., n) with covariance (..., n, n), field axes.

    First-order where that is honest, else the second moment over the noise of the two weak inputs. Infinite variances
    where that noise reaches inputs without a solution: no finite covariance would be honest.
    """
    _, jacobian, other, solvable = solve(inputs)
    first_order = propagate(jacobian, covariance) + other
    spread = spread_covariance(solve, inputs, covariance, weak)
    reached = solvable & np.isfinite(spread).all((-1, -2))
    safe = np.where(reached[..., None, None], spread, first_order)
    chosen = np.where(is_first_order_honest(first_order, safe)[..., None, None], first_order, safe)
    return np.where(reached[..., None, None], chosen, UNKNOWN)


def is_first_order_honest(first_order: FloatArray, spread: FloatArray) -> NDArray[np.bool_]:
    """(...): whether in no direction the second moment `spread` (..., 3, 3) exceeds `first_order` by over 5 %."""
    # spread - 1.05 first_order has no positive eigenvalue; scaled, so that metres and radians round alike
    variance = np.diagonal(spread, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    excess = (spread - _HONEST * first_order) / (scale[..., :, None] * scale[..., None, :])
    return np.asarray(np.linalg.eigvalsh(excess)[..., -1] <= 1e-12)


def spread_covariance(solve: Solve, inputs: FloatArray, covariance: FloatArray, weak: tuple[int, int]) -> FloatArray:
    """Second moment (..., 3, 3) of the solution's (x_m, y_m, heading_rad) about its value at inputs (..., n).

    Field axes. covariance: (..., n, n) of the inputs; weak: the two inputs whose noise is followed exactly; the noise
    of the others is propagated to first order around each node. Infinite variances where a node has no solution.
    """
    covariance = np.broadcast_to(covariance, (*inputs.shape, inputs.shape[-1]))
    one, rest = list(weak), [i for i in range(inputs.shape[-1]) if i not in weak]
    weak_noise = covariance[..., one, :][..., one]
    cross = covariance[..., rest, :][..., one]
    values, vectors = np.linalg.eigh(weak_noise)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    rest_by_weak = cross @ np.linalg.pinv(weak_noise, rcond=1e-12, hermitian=True)
    rest_noise = covariance[..., rest, :][..., rest] - rest_by_weak @ np.swapaxes(cross, -1, -2)
    weak_steps = np.einsum("...ij,kj->k...i", root, _GRID)
    nodes = np.broadcast_to(inputs, (len(_GRID), *inputs.shape)).copy()
    nodes[..., one] += weak_steps
    nodes[..., rest] += np.einsum("...ij,k...j->k...i", rest_by_weak, weak_steps)
    pose, jacobian, other, solvable = solve(nodes)
    step = pose - solve(inputs)[0]
    step[..., 2] = wrap(step[..., 2])
    moments = step[..., :, None] * step[..., None, :] + propagate(jacobian[..., rest], rest_noise) + other
    total = np.einsum("k,k...->...", _GRID_WEIGHTS, moments)
    reached = np.asarray(solvable.all(0))
    return np.where(reached[..., None, None], total, UNKNOWN)
