"""The tables of a comparison, one per log and one over all logs: what their cells say, as text or as HTML."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees, inf, log
from typing import Generic, TypeVar

from logs.evaluate import THREE_SIGMA_SHARE
from logs.metrics import Consistency, Metrics, RelativeError
from logs.results import ScoredLog, ScoredRun

NOTHING = "-"

Row = TypeVar("Row")
Number = Callable[[Metrics], float | None]


@dataclass(frozen=True, slots=True)
class Cell:
    """is_best: no other row is better, in a column where one can be."""

    text: str
    is_best: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """headings: (group, title) per column, neighbours of equal group belong together. rows: a cell per column."""

    headings: tuple[tuple[str, str], ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True)
class _Column(Generic[Row]):
    """number: what a row has here, None for nothing. badness: the less the better; None where none is better."""

    group: str
    title: str
    number: Callable[[Row], float | None]
    form: str = "{:.3f}"
    badness: Callable[[float], float] | None = abs


@dataclass(frozen=True, slots=True)
class _Overall:
    """One estimator: its metrics on the logs where it has some, out of all on which it ran."""

    metrics: tuple[Metrics, ...]
    logs: int
    duration_s: float
    total_s: float


def log_table(scored: ScoredLog) -> Table:
    """All estimators on one log."""

    def of(number: Number) -> Callable[[ScoredRun], float | None]:
        return lambda run: number(run.metrics) if run.metrics else None

    duration_s = scored.log.duration_s
    columns: list[_Column[ScoredRun]] = [
        _Column("ATE [m]", "RMSE", of(_ate_rmse)),
        _Column("ATE [m]", "median", of(lambda m: m.ate_m.median)),
        _Column("ATE [m]", "max", of(_ate_max)),
        _Column("heading [deg]", "RMSE", of(_heading_rmse_deg), "{:.2f}"),
        _Column("RPE over 1 m", "[m]", of(_rpe(lambda r: r.translation_rmse_m))),
        _Column("RPE over 1 m", "[deg]", of(_rpe(lambda r: degrees(r.rotation_rmse_rad))), "{:.2f}"),
        _Column("ANEES (95 % band)", "mean", of(_anees), "{:.3g}", _far_from_one),
        _Column("ANEES (95 % band)", "from", of(_consistency(lambda c: c.anees_low)), "{:.3f}", None),
        _Column("ANEES (95 % band)", "to", of(_consistency(lambda c: c.anees_high)), "{:.3f}", None),
        _Column("3 sigma", "[%]", of(_within_3sigma_percent), "{:.1f}", _far_from_three_sigma),
        _Column("known", "[%]", of(lambda m: 100 * m.truth_covered), "{:.1f}", None),
        _Column("update [ms]", "median", lambda run: _milli(run.update_median_s), "{:.2f}", None),
        _Column("update [ms]", "p99", lambda run: _milli(run.update_p99_s), "{:.2f}", None),
        _Column("total", "[s]", lambda run: run.run.total_s or None, "{:.2f}", None),
        _Column("log time", "/ total", lambda run: _ratio(duration_s, run.run.total_s), "{:.0f}", None),
        _Column("mirrored", "at end", lambda run: run.run.mirrored, "{:.3f}", None),
    ]
    return _table([run.run.name for run in scored.runs], columns, scored.runs, [True] * len(scored.runs))


def summary_table(logs: Sequence[ScoredLog]) -> Table | None:
    """Each estimator over all logs; None where there is one log or nothing could be compared."""
    runs = [(scored.log.duration_s, run) for scored in logs for run in scored.runs]
    names = list(dict.fromkeys(run.run.name for _, run in runs))
    overalls = [_overall([(duration_s, run) for duration_s, run in runs if run.run.name == name]) for name in names]
    if len(logs) < 2 or not any(overall.metrics for overall in overalls):
        return None

    def mean(number: Number) -> Callable[[_Overall], float | None]:
        return lambda overall: _mean([n for n in map(number, overall.metrics) if n is not None])

    def worst(number: Number) -> Callable[[_Overall], float | None]:
        return lambda overall: max((n for n in map(number, overall.metrics) if n is not None), default=None)

    columns: list[_Column[_Overall]] = [
        _Column("logs", "compared", lambda o: len(o.metrics), "{:.0f}", None),
        _Column("logs", "of", lambda o: o.logs, "{:.0f}", None),
        _Column("ATE RMSE [m]", "mean", mean(_ate_rmse)),
        _Column("ATE RMSE [m]", "worst", worst(_ate_rmse)),
        _Column("ATE [m]", "max", worst(_ate_max)),
        _Column("heading RMSE [deg]", "mean", mean(_heading_rmse_deg), "{:.2f}"),
        _Column("heading RMSE [deg]", "worst", worst(_heading_rmse_deg), "{:.2f}"),
        _Column("ANEES", "mean", mean(_anees), "{:.3g}", _far_from_one),
        _Column("3 sigma [%]", "mean", mean(_within_3sigma_percent), "{:.1f}", _far_from_three_sigma),
        _Column("total", "[s]", lambda o: o.total_s or None, "{:.2f}", None),
        _Column("log time", "/ total", lambda o: _ratio(o.duration_s, o.total_s), "{:.0f}", None),
    ]
    most = max(len(overall.metrics) for overall in overalls)
    return _table(names, columns, overalls, [len(overall.metrics) == most for overall in overalls])


def _table(
    names: Sequence[str], columns: Sequence[_Column[Row]], rows: Sequence[Row], can_win: Sequence[bool]
) -> Table:
    """Columns in which no row has anything are left out, as those of errors are without truth.

    can_win: whether the row is compared with the others at all; who failed on the hard logs is not better on the rest.
    """
    filled = [column for column in columns if any(column.number(row) is not None for row in rows)]
    cells = [[Cell(name) for name in names], *(_cells(column, rows, can_win) for column in filled)]
    headings = (("", "estimator"), *((column.group, column.title) for column in filled))
    return Table(headings, tuple(zip(*cells, strict=True)))


def _cells(column: _Column[Row], rows: Sequence[Row], can_win: Sequence[bool]) -> list[Cell]:
    numbers = [column.number(row) for row in rows]
    texts = [NOTHING if n is None else column.form.format(n) for n in numbers]
    if column.badness is None or sum(n is not None for n in numbers) < 2:
        return [Cell(text) for text in texts]
    badness = [inf if n is None or not can else column.badness(n) for n, can in zip(numbers, can_win, strict=True)]
    best_texts = {text for text, bad in zip(texts, badness, strict=True) if bad == min(badness)}
    # what reads the same is equally good
    return [Cell(text, can and text in best_texts) for text, can in zip(texts, can_win, strict=True)]


def _overall(runs: Sequence[tuple[float, ScoredRun]]) -> _Overall:
    metrics = tuple(run.metrics for _, run in runs if run.metrics)
    return _Overall(metrics, len(runs), sum(d for d, _ in runs), sum(run.run.total_s for _, run in runs))


def _ate_rmse(m: Metrics) -> float:
    return m.ate_m.rmse


def _ate_max(m: Metrics) -> float:
    return m.ate_m.max


def _heading_rmse_deg(m: Metrics) -> float:
    return degrees(m.heading_rad.rmse)


def _rpe(number: Callable[[RelativeError], float]) -> Number:
    return lambda m: number(m.rpe_metre) if m.rpe_metre else None


def _consistency(number: Callable[[Consistency], float]) -> Number:
    return lambda m: number(m.consistency) if m.consistency else None


_anees = _consistency(lambda c: c.anees)
_within_3sigma_percent = _consistency(lambda c: 100 * c.within_3sigma)


def _far_from_one(anees: float) -> float:
    return abs(log(anees)) if anees > 0 else inf  # half is as wrong as double


def _far_from_three_sigma(percent: float) -> float:
    return abs(percent - 100 * THREE_SIGMA_SHARE)


def _mean(numbers: Sequence[float]) -> float | None:
    return sum(numbers) / len(numbers) if numbers else None


def _milli(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


def _ratio(duration_s: float, total_s: float) -> float | None:
    return duration_s / total_s if total_s > 0 else None
