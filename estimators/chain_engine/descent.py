"""The batch solution of a chain without a general graph: Gauss-Newton on what only neighbours and a border know."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from estimators.chain import Chain
from estimators.chain_engine.blocks import IndefiniteError
from estimators.chain_engine.equations import Arithmetic, Equations, State
from estimators.config import Config
from estimators.linearised import Linearised
from estimators.solution import Solution

_MAX_STEPS = 50
_FOUND = np.array([1.0, 1.0, 0.3])  # m, m, rad: when no pose moves more in a step, the search for poses alone ends
_LEVER = np.array([1.0, 1.0, 0.2])  # m and m/rad: a turn moves what is so far away
_NEAR_M = 0.05  # from here on the kernel's bend is one to follow
_SMALL_M = 1e-3  # no such step is refused
_STILL_M = 1e-5  # of what is left then the last step, with the covariances, leaves a fraction
_LAST_M, _MAX_LAST = 5e-5, 5  # the last step
_BEND = 0.95  # see Arithmetic.add_all; makes the last steps few
_ROUNDING = 1e-9  # relative, of the error
_LEAST_DAMPING, _MOST_DAMPING, _DAMPING_FACTOR = 1e-5, 1e9, 10.0


def solved(
    chain: Chain, config: Config, near: Solution | None, arithmetic: Callable[[Linearised, float], Arithmetic]
) -> Solution:
    """As estimators.chain_engine.solve."""
    if not chain.stamps_ns:
        raise ValueError("a chain without poses has no solution")
    equations = Equations(chain, config, arithmetic)
    guess = np.array(chain.guess, dtype=np.float64, order="C")
    state = State(guess, equations.means, np.zeros(len(chain.guess)))
    if near is None:
        state = _descended(equations, state, False)
    else:
        common = np.where(equations.free, [*near.calibration, *near.sensor], equations.means)
        state = State(guess, common, equations.start(near))
    state = _descended(equations, state, True)
    for _ in range(_MAX_LAST):
        # weights alone are what covariances are by; they lead nearly the same way
        blocks, _ = equations.at(state, True, 0.0)
        solution, state, most = equations.last(blocks, state, _SMALL_M / _LEVER)
        if not _LAST_M <= (most * _LEVER).max() < _SMALL_M:
            break
    return solution


def _descended(equations: Equations, state: State, whole: bool) -> State:
    """Where Gauss and Newton's steps lead to; one that would lead up is damped (Levenberg, Marquardt). Poses alone are
    only led near; else as near as it takes by how much smaller the steps become."""
    blocks, cost = equations.at(state, whole, _BEND if whole else 0.0)
    if not np.isfinite(cost):
        raise ValueError("the chain's error is not finite: a factor holds a value that is not")
    damping, before = 0.0, 0.0
    for _ in range(_MAX_STEPS):
        after, moved, after_blocks, after_cost = state, np.inf, blocks, np.inf
        with suppress(IndefiniteError):
            after, most = equations.step(blocks, damping, state)
            moved = float((most * _LEVER).max())
            left = moved * min(1.0, moved / before if before > 0.0 else 1.0)
            if left < _STILL_M or (not whole and (most < _FOUND).all()):
                return after
            after_blocks, after_cost = equations.at(after, whole, _BEND if moved < _NEAR_M else 0.0)
        # the last steps go where the equations hold, which what is left out of them makes not quite the minimum
        if after_cost <= cost + _ROUNDING * max(1.0, cost) or (moved < _SMALL_M and np.isfinite(after_cost)):
            state, blocks, cost = after, after_blocks, after_cost
            before = moved if damping == 0.0 else 0.0
            damping = damping / _DAMPING_FACTOR if damping > _LEAST_DAMPING else 0.0
        else:
            before = 0.0
            damping = max(_LEAST_DAMPING, damping * _DAMPING_FACTOR)
            if damping > _MOST_DAMPING:
                break
    return state
