"""The smoother's engines on the same chains: the chain engine beside gtsam, with and without numba.

Per pose an odometry, a whole pose and two landmarks; the calibrations of odometry and sensor free, as shipped. A time
is that of all of a solution: from the chain's records, with what is built of them, to poses and marginal covariances.
"""

import argparse
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from time import perf_counter

import numpy as np

from benchmarks.long_chain import long_chain
from benchmarks.timing import fastest_s, table
from estimators import chain_engine, graph
from estimators.chain_engine.descent import solved
from estimators.chain_engine.in_arrays import InArrays
from estimators.config import Config
from estimators.solution import Solution
from fieldloc import pose as se2

_HEAD = (
    "poses",
    "gtsam s",
    "chain s",
    "times",
    "us/pose",
    "in arrays s",
    "times",
    "position m",
    "heading rad",
    "covariance",
)


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(prog="python -m benchmarks engines", description=__doc__)
    parser.add_argument("--poses", default="1000,10000,100000", metavar="N,N,...", help="lengths (%(default)s)")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="the fastest of N runs counts (3)")
    chosen = parser.parse_args(options)
    start = perf_counter()
    chain_engine.prepare()
    with_numba = "with numba" if find_spec("numba") else "without numba"
    lines = [f"chain engine {with_numba}, ready in {perf_counter() - start:.1f} s"]
    rows = [_row(int(count), chosen.repeats) for count in chosen.poses.split(",")]
    return "\n".join([*lines, table(_HEAD, rows), "the last three: largest differences from gtsam's answer"])


def _row(count: int, repeats: int) -> tuple[str, ...]:
    chain, _ = long_chain(count)
    config, answers = Config(), dict[str, Solution]()

    def keep(name: str, solve: Callable[[], Solution]) -> None:
        answers[name] = solve()

    engines: dict[str, Callable[[], Solution]] = {
        "gtsam": lambda: graph.solve(chain, config),
        "chain": lambda: chain_engine.solve(chain, config),
        "arrays": lambda: solved(chain, config, None, InArrays),
    }
    works = [partial(keep, name, solve) for name, solve in engines.items()]
    gtsam_s, chain_s, arrays_s = fastest_s(works, repeats)
    one, other = answers["chain"], answers["gtsam"]
    position = np.abs(one.poses[:, :2] - other.poses[:, :2]).max()
    heading = np.abs(se2.wrap(one.poses[:, 2] - other.poses[:, 2])).max()
    whitener = np.linalg.inv(np.linalg.cholesky(other.covariances))
    relative = np.abs(whitener @ one.covariances @ np.swapaxes(whitener, 1, 2) - np.eye(3)).max()
    return (
        f"{count:,}",
        f"{gtsam_s:.3f}",
        f"{chain_s:.4f}",
        f"{gtsam_s / chain_s:.0f}",
        f"{chain_s / count * 1e6:.1f}",
        f"{arrays_s:.3f}",
        f"{gtsam_s / arrays_s:.0f}",
        f"{position:.1e}",
        f"{heading:.1e}",
        f"{relative:.1e}",
    )
