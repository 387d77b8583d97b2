"""Several estimators on one log, scored against its truth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from estimators.base import Estimator
from estimators.config import Config
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from fieldloc.pose import FloatArray
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.results import LogResult, RunResult, ScoredLog, score
from logs.trajectory import from_estimates, from_truth


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """failures: why an estimator has no estimates here, one sentence each. warnings: what else went wrong, but for
    the log's own."""

    scored: ScoredLog
    failures: tuple[str, ...]
    warnings: tuple[str, ...]


def compare(
    log: LogFile,
    estimators: Mapping[str, Callable[[Config], Estimator]],
    config: Config,
    field: FieldMap | None = None,
    start: FloatArray | str | None = None,
    progress: Progress = unwatched,
) -> Comparison:
    """Each estimator on the whole log; one that fails is in the result, without estimates.

    FieldlocError where the log is nothing to localize with (`load_recording`), or its truth is broken.
    """
    recording = load_recording(log, field, progress)
    truth = from_truth(log.records(Truth))
    runs, failures = [], []
    warnings = dict.fromkeys(recording.warnings)
    for name, make in estimators.items():
        try:
            done = replay(recording, make(config), start, config, partial(_of, progress, name))
        except FieldlocError as error:
            runs.append(RunResult(name, from_estimates(()), np.zeros(0), 0.0))
            failures.append(f"{name}: {error}")
            continue
        trajectory = from_estimates(done.estimates)
        runs.append(RunResult(name, trajectory, done.update_s, done.total_s, done.ambiguities, done.events))
        warnings |= dict.fromkeys(done.warnings)
    result = LogResult(recording.name, recording.duration_s, recording.field, truth, tuple(runs))
    return Comparison(score(result), tuple(failures), tuple(warnings))


def _of(progress: Progress, name: str, done: int, total: int, doing: str = "") -> None:
    progress(done, total, f"{name} {doing}".strip())
