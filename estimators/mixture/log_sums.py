"""Logarithms of sums of what logarithms are given of. Mostly of one or two numbers: by plain ones, then."""

import math

import numpy as np

from fieldloc.pose import FloatArray

_FEW = 8


def total(log_weights: FloatArray) -> float:
    """Of all; -inf of none."""
    size = log_weights.size
    if size <= 1:
        return log_weights.item() if size else -math.inf
    if size > _FEW:
        return float(np.logaddexp.reduce(np.ravel(log_weights)))
    every: list[float] = np.ravel(log_weights).tolist()
    most = max(every)
    if not math.isfinite(most):
        return most
    return most + math.log(sum([math.exp(one - most) for one in every]))


def either(one: float, other: float) -> float:
    """As np.logaddexp, of two numbers."""
    if one == other:
        return one + math.log(2.0)
    most, least = (one, other) if one > other else (other, one)
    return most + math.log1p(math.exp(least - most))


def of_each(log_weights: FloatArray) -> FloatArray:
    """(h,) of all copies together, of (h, c)."""
    return log_weights[:, 0] if log_weights.shape[1] == 1 else np.asarray(np.logaddexp.reduce(log_weights, axis=1))
