"""Runs that stand in files, made ready for the report, as `compare` makes them of estimators."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from estimators.base import Ambiguity, Event
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from logs.association import DEFAULT_MAX_DIFFERENCE_S
from logs.estimates import read_estimates, read_truth
from logs.reader import LogFile
from logs.results import LogResult, RunResult, ScoredLog, score
from logs.trajectory import Trajectory, from_truth
from logs.writer import METADATA


def load_runs(results: Sequence[LogFile], truth: LogFile | None = None, field: FieldMap | None = None) -> LogResult:
    """One run a file, named after its estimator; update times are unknown, the total too where the file is silent.

    truth: the log that holds it; without one the results are searched, as one made with --merge has it. `field` stands
    in for the files' own. FieldlocError where a file has no estimates, or the truth's log no truth.
    """
    if not results:
        raise ValueError("no results")
    runs = []
    for log, name in zip(results, run_names(results), strict=True):
        ambiguities, events = tuple(log.records(Ambiguity)), tuple(log.records(Event))
        runs.append(RunResult(name, read_estimates(log), np.zeros(0), _total_s(log), ambiguities, events))
    true = read_truth(truth) if truth is not None else _own_truth(results)
    maps = [field, *(log.field_map() for log in results)]
    if truth is not None:
        maps.append(truth.field_map())
    first_ns = min(int(run.trajectory.stamps_ns[0]) for run in runs)
    last_ns = max(int(run.trajectory.stamps_ns[-1]) for run in runs)
    known_map = next((one for one in maps if one is not None), None)
    return LogResult(_log_name(results[0]), (last_ns - first_ns) * 1e-9, known_map, true, tuple(runs))


def score_runs(
    results: Sequence[LogFile],
    truth: LogFile | None = None,
    field: FieldMap | None = None,
    max_difference_s: float = DEFAULT_MAX_DIFFERENCE_S,
) -> ScoredLog:
    """`load_runs`, scored: what `logs.report.write_report` and `logs.table_text.format_table` take."""
    return score(load_runs(results, truth, field), max_difference_s)


def run_names(results: Sequence[LogFile]) -> list[str]:
    """The estimators' names, with the files' where two are called the same."""
    names = [log.metadata.get(METADATA, {}).get("estimator") or log.path.stem for log in results]
    unique = [
        name if names.count(name) == 1 else f"{name} ({log.path.stem})"
        for name, log in zip(names, results, strict=True)
    ]
    return [
        name if unique.count(name) == 1 else f"{name} {1 + unique[:i].count(name)}" for i, name in enumerate(unique)
    ]


def _own_truth(results: Sequence[LogFile]) -> Trajectory | None:
    for log in results:
        if log.has(Truth):
            return from_truth(log.records(Truth))
    return None


def _log_name(log: LogFile) -> str:
    """Of the recording that was localized, as `compare` calls it."""
    recorded = log.metadata.get(METADATA, {}).get("log")
    return recorded.removesuffix(".mcap") if recorded else log.path.stem


def _total_s(log: LogFile) -> float:
    """0 where the file does not say."""
    with suppress(ValueError):
        if 0.0 < (total_s := float(log.metadata.get(METADATA, {}).get("total_s", ""))) < np.inf:
            return total_s
    return 0.0
