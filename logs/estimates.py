"""Trajectories to logs and back: what `run` and `smooth` write and `evaluate` and `export` read."""

from collections.abc import Mapping
from pathlib import Path

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.replay import Recording, Replay
from logs.schema import topic_of
from logs.trajectory import Trajectory, from_estimates, from_truth
from logs.writer import LogWriter

_PROGRESS_EVERY = 500


def write_estimates(
    path: Path, recording: Recording, done: Replay, metadata: Mapping[str, str], progress: Progress = unwatched
) -> None:
    """The map and the estimates. FieldlocError where the file cannot be written or an estimate is none."""
    with LogWriter(path, metadata) as log:
        log.write(topic_of(FieldMap), recording.field, recording.measurements[0].stamp_ns)
        for i, estimate in enumerate(done.estimates):
            try:
                log.write(topic_of(Estimate), estimate)
            except ValueError as error:
                raise FieldlocError(f"{path}: not written: the estimator gave a broken estimate: {error}") from error
            if i % _PROGRESS_EVERY == 0:
                progress(i, len(done.estimates), "writing")


def read_estimates(log: LogFile) -> Trajectory:
    """FieldlocError where there are none."""
    trajectory = from_estimates(log.records(Estimate))
    if not len(trajectory):
        topic = log.roles["estimate"]
        raise FieldlocError(f"{log.path}: no usable message on {topic}; give what fieldloc run or smooth wrote")
    return trajectory


def read_truth(log: LogFile) -> Trajectory:
    """FieldlocError where there is none."""
    trajectory = from_truth(log.records(Truth))
    if not len(trajectory):
        raise FieldlocError(f"{log.path}: no usable message on {log.roles['truth']}; give a log that holds the truth")
    return trajectory
