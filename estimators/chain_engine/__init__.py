"""The batch solution of a chain without a general graph: tens of times faster than gtsam, and the same.

The poses of one robot are a chain: each knows its neighbours only, beside the few numbers that are the same for all of
them. So the normal equations are solved in one sweep there and one back, and so are all marginal covariances.
In machine code where numba is installed (`pip install fieldloc[fast]`), otherwise in arrays, the same to rounding.
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from estimators.chain import Chain
from estimators.chain_engine.descent import solved
from estimators.chain_engine.equations import Arithmetic
from estimators.config import Config
from estimators.linearised import Linearised
from estimators.motion import CALIBRATION, Increment
from estimators.solution import Solution
from fieldloc.factors import HeadingFactor, PoseFactor


def solve(chain: Chain, config: Config, near: Solution | None = None) -> Solution:
    """The most probable poses given all factors, each with its marginal covariance; ValueError where something is not
    finite.

    near: an earlier solution of almost the same chain, whose poses are the chain's guess: it saves the search.
    """
    return solved(chain, config, near, arithmetic())


@cache
def arithmetic() -> Callable[[Linearised, float], Arithmetic]:
    """In numba where it is there and works with the numpy that is there."""
    try:
        from estimators.chain_engine.in_numba import InNumba
    except ImportError:
        from estimators.chain_engine.in_arrays import InArrays

        return InArrays
    return InNumba


def prepare() -> None:
    """Solves chains of two poses, so that all is compiled: the first time on a machine that takes some seconds."""
    step = Increment(np.array([1e-9, 0.0, 0.0]), np.eye(3), np.zeros((3, CALIBRATION)))
    seen = PoseFactor(0, np.zeros(3), np.eye(3), by_sight=True)
    compass = HeadingFactor(0, 0.0, np.eye(1), by_compass=True)
    for factors in ((seen,), (seen, compass)):
        solve(Chain((0, 1), (step,), tuple((0, factor) for factor in factors), np.zeros((2, 3))), Config())
