"""What solves a chain: gtsam, or the chain engine. Each is loaded when it is first asked for."""

from collections.abc import Callable

from estimators.chain import Chain
from estimators.config import ENGINES, Config
from estimators.solution import Solution

Solver = Callable[[Chain, Config, Solution | None], Solution]


def solver(config: Config) -> Solver:
    """ValueError if there is no such engine."""
    match config.graph.engine:
        case "gtsam":
            from estimators.graph import solve

            return solve
        case "chain":
            from estimators import chain_engine

            return chain_engine.solve
        case other:
            raise ValueError(f"graph.engine: no engine '{other}'; there is {', '.join(ENGINES)}")


def prepare(config: Config) -> None:
    """Does what an engine needs once: the first time on a machine, numba takes some seconds to compile."""
    if config.graph.engine == "chain":
        from estimators import chain_engine

        chain_engine.prepare()
