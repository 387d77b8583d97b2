"""How sure an estimator is of what it cannot tell apart, and how right it is with it, over many simulated games.

sides: P(mirrored) over time without a compass from an unknown start, and whether the robot is at one of the copies.
compass: wrong sides from ten seconds of evidence on, with a noisy and disturbed compass, or the half told.
kidnap: seconds from the first image that determines a pose to being right (0.3 m, 15 deg) and staying so for a second.
reliability: expected calibration error of P(mirrored) and of the hypotheses' weights, over all kinds of games.
nees: of the estimate's best copy and of the estimate once the side is decided, with the band of 95 %.
"""

import argparse
import multiprocessing
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from benchmarks.games import GAMES
from benchmarks.scoring import Moment, both_sides, expected_calibration_error, first_right_s, reliability, watch
from benchmarks.timing import table
from estimators.config import Config
from estimators.registry import ONLINE
from fieldloc.errors import FieldlocError

_WHAT = {
    "sides": ("no compass",),
    "compass": ("noisy compass", "own half"),
    "kidnap": ("kidnapped",),
    "reliability": tuple(GAMES),
    "nees": ("no compass", "noisy compass"),
}
_SURE = 0.01
_AFTER_S = 10.0


class Watched(NamedTuple):
    """evidence_ns: see PlayedGame. failure: what an estimator raised, empty if nothing."""

    seed: int
    evidence_ns: tuple[int, ...]
    put_down_ns: tuple[int, ...]
    moments: list[Moment]
    update_s: float
    failure: str


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks ambiguity", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--what", choices=[*_WHAT, "all"], default="all", help="which of these (all)")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="games of each kind (20)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first game's seed (0)")
    parser.add_argument("--duration", type=float, default=30.0, metavar="S", help="length of a game (30)")
    parser.add_argument("--estimator", choices=list(ONLINE), default="mixture", help="which estimator (mixture)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (1)")
    chosen = parser.parse_args(options)
    what = list(_WHAT) if chosen.what == "all" else [chosen.what]
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    games: dict[str, list[Watched]] = {}
    for kind in dict.fromkeys(chain.from_iterable(_WHAT[name] for name in what)):
        games[kind] = _watch_all(kind, seeds, chosen.duration, chosen.estimator, chosen.jobs)
    parts = {"sides": _sides, "compass": _compass, "kidnap": _kidnap, "reliability": _reliability, "nees": _nees}
    text = [f"{chosen.estimator}, {len(seeds)} games of {chosen.duration:g} s each", _cost(games)]
    text += [f"{name}\n{parts[name]({kind: games[kind] for kind in _WHAT[name]})}" for name in what]
    return "\n\n".join(text)


def _watch_all(kind: str, seeds: Sequence[int], duration_s: float, estimator: str, jobs: int) -> list[Watched]:
    one = partial(_watch, kind, duration_s, estimator)
    if jobs == 1:
        return [one(seed) for seed in seeds]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(one, seeds))


def _watch(kind: str, duration_s: float, estimator: str, seed: int) -> Watched:
    game = GAMES[kind](seed, duration_s)
    try:
        moments, update_s = watch(game, ONLINE[estimator], Config())
    except FieldlocError as error:
        return Watched(seed, game.evidence_ns, game.put_down_ns, [], 0.0, str(error))
    return Watched(seed, game.evidence_ns, game.put_down_ns, moments, update_s, "")


def _cost(games: dict[str, list[Watched]]) -> str:
    rows = []
    for kind, watched in games.items():
        failures = [f"seed {one.seed}: {one.failure}" for one in watched if one.failure]
        seconds = [one.update_s for one in watched if not one.failure]
        rows.append((kind, f"{np.mean(seconds) if seconds else np.nan:.2f}", "; ".join(failures) or "none"))
    return table(("games", "seconds of updates a game", "failures"), rows)


def _sides(games: dict[str, list[Watched]]) -> str:
    rows = []
    for one in chain.from_iterable(games.values()):
        after = [moment for moment in one.moments if moment.since_s >= 0.0]
        late = [moment for moment in after if moment.since_s >= _AFTER_S]
        mirrored = [moment.mirrored for moment in after]
        rows.append(
            (
                str(one.seed),
                f"{min(mirrored, default=np.nan):.3f}",
                f"{max(mirrored, default=np.nan):.3f}",
                _share(moment.found for moment in after),
                _share(moment.found for moment in late),
                f"{max((moment.away_m for moment in late), default=np.nan):.2f}",
                f"{np.degrees(max((moment.away_rad for moment in late), default=np.nan)):.0f}",
            )
        )
    head = ("seed", "P(mirrored) from", "to", "at a copy", f"after {_AFTER_S:g} s", "worst m", "worst deg")
    return table(head, rows)


def _compass(games: dict[str, list[Watched]]) -> str:
    rows = []
    for kind, watched in games.items():
        decided = {
            one.seed: [moment for moment in one.moments if moment.since_s >= _AFTER_S] for one in watched if one.moments
        }
        wrong = [seed for seed, late in decided.items() if any(moment.other_side for moment in late)]
        at_end = [seed for seed, late in decided.items() if late and late[-1].other_side]
        moments = list(chain.from_iterable(decided.values()))
        rows.append(
            (
                kind,
                f"{len(wrong)} of {len(decided)}",
                f"{len(at_end)}",
                _share(not moment.other_side for moment in moments),
                _share(moment.found for moment in moments),
                f"{max((moment.mirrored for moment in moments), default=np.nan):.3f}",
                f"{np.median([np.degrees(moment.away_rad) for moment in moments] or [np.nan]):.2f}",
                ", ".join(map(str, wrong)) or "none",
            )
        )
    head = ("games", "ever wrong", "at the end", "right side", "found", "largest P", "median deg", "wrong seeds")
    return f"from {_AFTER_S:g} s of evidence on\n" + table(head, rows)


def _kidnap(games: dict[str, list[Watched]]) -> str:
    rows, times = [], []
    for one in chain.from_iterable(games.values()):
        for evidence_ns, put_down_ns in zip(one.evidence_ns[1:], one.put_down_ns, strict=False):
            times.append(first_right_s(one.moments, evidence_ns))
            late = [moment for moment in one.moments if moment.stamp_ns >= evidence_ns]
            row = (
                str(one.seed),
                f"{(evidence_ns - put_down_ns) * 1e-9:.2f}",
                f"{times[-1]:.2f}",
                _share(moment.right for moment in late),
                "yes" if late and late[-1].right else "no",
            )
            if times[-1] > 2.0 or row[-1] == "no":
                rows.append(row)
    late_share = _share(time > 2.0 for time in times)
    quantiles = ", ".join(f"{np.quantile(times, q, method='higher'):.2f}" for q in (0.5, 0.9, 1.0)) if times else "-"
    text = f"{len(times)} kidnappings; s until right: median, 90 %, most: {quantiles}; more than 2 s: {late_share}"
    head = ("seed", "s unseeing", "s until right", "right", "at the end")
    return text + ("\n" + table(head, rows) if rows else "")


def _reliability(games: dict[str, list[Watched]]) -> str:
    moments = {kind: [m for one in watched for m in one.moments if m.since_s >= 0] for kind, watched in games.items()}
    rows = [
        (
            kind,
            f"{expected_calibration_error(*both_sides(some)):.3f}",
            f"{expected_calibration_error(*_weights(some)):.3f}",
            f"{expected_calibration_error(*_best(some)):.3f}",
            _share(moment.found for moment in some),
        )
        for kind, some in [*moments.items(), ("all", list(chain.from_iterable(moments.values())))]
    ]
    everything = list(chain.from_iterable(moments.values()))
    bins = ("told", "how many", "mean", "true")
    return "\n".join(
        [
            "expected calibration error",
            table(("games", "P(mirrored)", "all places", "best place", "found"), rows),
            "P(mirrored) and its complement, all games",
            table(bins, reliability(*both_sides(everything))),
            "weights of all places, all games",
            table(bins, reliability(*_weights(everything))),
        ]
    )


def _nees(games: dict[str, list[Watched]]) -> str:
    rows = []
    for kind, watched in games.items():
        for at_s in (2.0, 5.0, 10.0, 15.0, 20.0):
            now = [moment for one in watched if (moment := _at(one.moments, at_s)) is not None]
            for name, values in (
                ("side open", [moment.nees_folded for moment in now if moment.mirrored > _SURE]),
                ("side decided", [moment.nees for moment in now if moment.mirrored <= _SURE]),
            ):
                if values:
                    low, high = chi2.ppf([0.025, 0.975], 3 * len(values)) / len(values)
                    rows.append(
                        (
                            f"{kind}, {at_s:g} s",
                            name,
                            str(len(values)),
                            f"{np.mean(values):.2f}",
                            f"{np.median(values):.2f}",
                            f"{low:.2f} to {high:.2f}",
                        )
                    )
    return table(("games, time", "of", "how many", "mean NEES", "median", "band of the mean"), rows)


def _at(moments: Iterable[Moment], at_s: float) -> Moment | None:
    return next((moment for moment in moments if moment.since_s >= at_s), None)


def _weights(moments: Iterable[Moment]) -> tuple[np.ndarray, np.ndarray]:
    told = [moment.told for moment in moments]
    true = [moment.true for moment in moments]
    return np.concatenate([np.zeros(0), *told]), np.concatenate([np.zeros(0, dtype=np.bool_), *true])


def _best(moments: Iterable[Moment]) -> tuple[np.ndarray, np.ndarray]:
    pairs = [(moment.told[0], moment.true[0]) for moment in moments]
    return np.array([told for told, _ in pairs]), np.array([true for _, true in pairs], dtype=np.bool_)


def _share(these: Iterable[bool]) -> str:
    found = list(these)
    return f"{100.0 * sum(found) / len(found):.1f} %" if found else "-"
