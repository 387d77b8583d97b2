"""What estimators made of a log, and how good it was: the input of the tables, the report and metrics.json."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Event
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.association import DEFAULT_MAX_DIFFERENCE_S
from logs.evaluate import Errors, evaluate_errors, match
from logs.metrics import Metrics
from logs.trajectory import Trajectory

Json = float | int | str | None | Sequence["Json"] | dict[str, "Json"]


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """One estimator on one log. update_s: (k,) seconds of each update; total_s: of the run. Unknown: empty, 0.

    ambiguities, events: what it said of its hypotheses while it ran; empty if it has none.
    """

    name: str
    trajectory: Trajectory
    update_s: FloatArray
    total_s: float
    ambiguities: tuple[Ambiguity, ...] = ()
    events: tuple[Event, ...] = ()

    @property
    def mirrored(self) -> float | None:
        """P(mirrored) at the end; None where it was never said."""
        return self.ambiguities[-1].mirrored if self.ambiguities else None


@dataclass(frozen=True, slots=True, eq=False)
class LogResult:
    """The runs on one log, estimators named once each. field, truth: None where the log has none."""

    log_name: str
    duration_s: float
    field: FieldMap | None
    truth: Trajectory | None
    runs: tuple[RunResult, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredRun:
    """A run with its errors and metrics; both None, and `note` says why, where it cannot be compared with truth."""

    run: RunResult
    errors: Errors | None
    metrics: Metrics | None
    note: str = ""

    @property
    def update_median_s(self) -> float | None:
        return float(np.median(self.run.update_s)) if len(self.run.update_s) else None

    @property
    def update_p99_s(self) -> float | None:
        """All but one update in a hundred are faster."""
        return float(np.quantile(self.run.update_s, 0.99)) if len(self.run.update_s) else None


@dataclass(frozen=True, slots=True, eq=False)
class ScoredLog:
    """`runs` are those of `log`, in its order."""

    log: LogResult
    runs: tuple[ScoredRun, ...]


def score(log: LogResult, max_difference_s: float = DEFAULT_MAX_DIFFERENCE_S) -> ScoredLog:
    """Every run against the log's truth. Never fails for a run that has nothing to compare: its note says so."""
    return ScoredLog(log, tuple(_score(run, log.truth, max_difference_s) for run in log.runs))


def metrics_document(logs: Sequence[ScoredLog]) -> dict[str, Json]:
    """The content of metrics.json; `docs/metrics.md` lists the keys."""
    return {"logs": [_log_document(scored) for scored in logs]}


def _score(run: RunResult, truth: Trajectory | None, max_difference_s: float) -> ScoredRun:
    if truth is None or len(truth) == 0:
        return ScoredRun(run, None, None, "the log has no truth to compare with")
    try:
        errors = match(run.trajectory, truth, max_difference_s)
    except FieldlocError as error:
        return ScoredRun(run, None, None, str(error))
    return ScoredRun(run, errors, evaluate_errors(errors, run.trajectory, truth))


def _log_document(scored: ScoredLog) -> dict[str, Json]:
    return {
        "log": scored.log.log_name,
        "duration_s": scored.log.duration_s,
        "estimators": {run.run.name: _run_document(run, scored.log.duration_s) for run in scored.runs},
    }


def _run_document(scored: ScoredRun, duration_s: float) -> dict[str, Json]:
    out: dict[str, Json] = dict(scored.metrics.to_dict()) if scored.metrics else {"note": scored.note}
    total_s = scored.run.total_s
    said: dict[str, Json] = {} if scored.run.mirrored is None else {"mirrored": scored.run.mirrored}
    return out | {
        "updates": len(scored.run.update_s),
        "update_median_s": scored.update_median_s,
        "update_p99_s": scored.update_p99_s,
        "total_s": total_s or None,
        "log_time_per_total_time": duration_s / total_s if total_s > 0 else None,
        **said,
    }
