"""`fieldloc report`: what stands in a result's file is reported as `compare` reports what it has just run."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from real_logs import sample_messages, write

from estimators.base import Estimate
from estimators.config import Config
from estimators.ekf import Ekf
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from logs.comparison import compare
from logs.estimates import write_estimates
from logs.one_run import load_runs, run_names, score_runs
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.report import write_report
from logs.results import ScoredLog, metrics_document
from logs.schema import topic_of
from logs.table_text import format_table
from logs.writer import LogWriter

LOG_NAME = "yard"


@dataclass(frozen=True)
class Files:
    log: LogFile
    result: LogFile
    compared: ScoredLog


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Twenty seconds of the sample, what the EKF made of it in a file, and what `compare` says of the two."""
    folder = tmp_path_factory.mktemp("one_run")
    log = LogFile(write(folder / f"{LOG_NAME}.mcap", sample_messages(20.0)))
    recording = load_recording(log)
    done = replay(recording, Ekf(Config()))
    metadata = {"estimator": "ekf", "log": f"{LOG_NAME}.mcap"}
    write_estimates(folder / "result.mcap", recording, done, metadata)
    return Files(log, LogFile(folder / "result.mcap"), compare(log, {"ekf": Ekf}, Config()).scored)


def metrics(scored: ScoredLog) -> dict[str, object]:
    (run,) = scored.runs
    assert run.metrics is not None
    return dict(run.metrics.to_dict())


def test_a_result_and_its_log_have_the_metrics_that_compare_found(files: Files) -> None:
    scored = score_runs([files.result], truth=files.log)
    assert metrics(scored) == metrics(files.compared)
    assert scored.log.log_name == files.compared.log.log_name == LOG_NAME
    assert [run.run.name for run in scored.runs] == ["ekf"]
    assert scored.log.duration_s == pytest.approx(files.compared.log.duration_s, abs=1.0)
    assert scored.log.field is not None
    assert len(scored.log.field.landmarks) == 17


def test_the_report_of_one_run_has_the_form_of_a_comparison(files: Files, tmp_path: Path) -> None:
    scored = score_runs([files.result], truth=files.log)
    write_report(tmp_path / "one", [scored])
    write_report(tmp_path / "many", [files.compared])
    names = [{file.name for file in (tmp_path / folder).iterdir()} for folder in ("one", "many")]
    assert names[0] == names[1] == {"report.html", "metrics.json", "yard-field.png", "yard-ekf-errors.png"}
    one, many = (json.loads((tmp_path / folder / "metrics.json").read_text()) for folder in ("one", "many"))
    (one_run,), (many_run,) = (document["logs"][0]["estimators"].values() for document in (one, many))
    assert one_run.keys() == many_run.keys()
    page = (tmp_path / "one" / "report.html").read_text()
    assert "<h1>Localization</h1>" in page
    assert f"ekf on {LOG_NAME}" in page


def test_what_a_file_does_not_say_of_the_run_is_left_open_and_not_called_zero(files: Files) -> None:
    scored = score_runs([files.result], truth=files.log)
    run = metrics_document([scored])["logs"][0]["estimators"]["ekf"]  # type: ignore[index,call-overload]
    timings = ("update_median_s", "update_p99_s", "total_s", "log_time_per_total_time")
    assert [run[key] for key in timings] == [None] * 4  # type: ignore[index,call-overload]
    head = format_table([scored]).splitlines()[:3]
    assert not any(word in line for line in head for word in ("total", "update"))


def test_a_total_that_the_file_tells_is_reported(tmp_path: Path) -> None:
    for told, total_s in (("2.5", 2.5), ("nan", 0.0), ("inf", 0.0), ("-1", 0.0), ("soon", 0.0)):
        path = tmp_path / f"{told}.mcap"
        with LogWriter(path, {"total_s": told}) as log:
            log.write("/estimate", Estimate(0, np.zeros(3), np.eye(3)))
        assert load_runs([LogFile(path)]).runs[0].total_s == total_s


def test_a_result_that_holds_the_truth_beside_the_estimates_needs_no_other_log(files: Files, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "merged.mcap", {"estimator": "ekf"}) as merged:
        for log in (files.log, files.result):
            for message in log.messages():
                if not (log is files.result and isinstance(message.record, FieldMap)):
                    merged.write(message.topic, message.record, message.log_time_ns)
    scored = score_runs([LogFile(tmp_path / "merged.mcap")])
    assert metrics(scored) == metrics(files.compared)
    assert scored.log.log_name == "merged"  # no one told another name


def test_without_truth_the_report_shows_the_trajectory_alone(files: Files, tmp_path: Path) -> None:
    scored = score_runs([files.result])
    assert scored.log.truth is None
    assert scored.runs[0].note == "the log has no truth to compare with"
    write_report(tmp_path, [scored])
    assert {file.name for file in tmp_path.iterdir()} == {"report.html", "metrics.json", "yard-field.png"}


def test_runs_of_one_name_are_told_apart_by_their_files(files: Files, tmp_path: Path) -> None:
    def result(path: Path, metadata: dict[str, str]) -> LogFile:
        path.parent.mkdir(exist_ok=True)
        with LogWriter(path, metadata) as log:
            log.write(topic_of(Estimate), Estimate(0, np.zeros(3), np.eye(3)))
        return LogFile(path)

    a = result(tmp_path / "a.mcap", {"estimator": "ekf"})
    b = result(tmp_path / "b.mcap", {"estimator": "ekf"})
    c = result(tmp_path / "c.mcap", {"estimator": "smooth"})
    other_b = result(tmp_path / "sub" / "b.mcap", {"estimator": "ekf"})
    nameless = result(tmp_path / "nameless.mcap", {})
    assert run_names([a, b, c, nameless]) == ["ekf (a)", "ekf (b)", "smooth", "nameless"]
    assert run_names([a, b, other_b]) == ["ekf (a)", "ekf (b) 1", "ekf (b) 2"]
    assert [run.name for run in load_runs([a, c]).runs] == ["ekf", "smooth"]


def test_another_map_may_stand_in_for_the_files_own(files: Files) -> None:
    other = FieldMap("other", np.zeros((0, 2, 2)), np.array([[0.0, 0.0, 1.0]]), ())
    assert load_runs([files.result], field=other).field is other


def test_the_map_is_taken_from_the_truths_log_where_the_result_has_none(files: Files, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "bare.mcap") as log:
        log.write("/estimate", Estimate(0, np.zeros(3), np.eye(3)))
    with LogWriter(tmp_path / "truth.mcap") as log:
        log.write("/field", FieldMap("there", np.zeros((0, 2, 2)), np.array([[0.0, 0.0, 1.0]]), ()), 0)
        log.write("/truth", Truth(0, np.zeros(3)))
    bare, truth = LogFile(tmp_path / "bare.mcap"), LogFile(tmp_path / "truth.mcap")
    assert load_runs([bare]).field is None
    found = load_runs([bare], truth).field
    assert found is not None
    assert found.name == "there"


def test_what_is_missing_is_named_with_its_file(files: Files) -> None:
    with pytest.raises(FieldlocError, match=r"yard\.mcap: no usable message on /estimate; give what fieldloc run"):
        load_runs([files.log])
    with pytest.raises(FieldlocError, match=r"result\.mcap: no usable message on /truth; give a log that holds"):
        load_runs([files.result], truth=files.result)
