import os
import resource
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import log_records
import mcap.reader
import numpy as np
import pytest
from children import interruptible
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Compass, Truth
from logs.reader import LogFile
from logs.schema import SCHEMAS, topic_of
from logs.writer import LogWriter

ROOT = Path(__file__).parents[1]


def truth(i):
    return Truth(i * 10**8, np.array([0.1 * i, 1.0, -0.5]))


def write(path, count=10, **metadata):
    with LogWriter(path, metadata) as log:
        for i in range(count):
            log.write("/truth", truth(i))


def write_until(path, error):
    with LogWriter(path) as log:
        log.write("/truth", truth(0))
        raise error


def left_over(folder):
    return sorted(p.name for p in folder.iterdir())


@given(data=st.data())
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_written_is_read_back(data, tmp_path):
    kinds = data.draw(st.lists(st.sampled_from([schema.kind for schema in SCHEMAS]), min_size=1, max_size=6))
    records = [data.draw(log_records.BY_KIND[kind]) for kind in kinds]
    with LogWriter(tmp_path / "log.mcap") as log:
        for i, record in enumerate(records):
            log.write(topic_of(type(record)), record, log_time_ns=i)
    log = LogFile(tmp_path / "log.mcap")
    messages = list(log.messages())
    assert log.warnings == ()
    assert [m.log_time_ns for m in messages] == list(range(len(records)))
    assert all(
        m.topic == topic_of(type(r)) and log_records.same(m.record, r) for m, r in zip(messages, records, strict=True)
    )


def test_log_time_is_the_stamp_unless_given(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/compass", Compass(3, 0.0, 0.1))
        log.write("/compass", Compass(3, 0.0, 0.1), log_time_ns=7)
    messages = list(LogFile(tmp_path / "log.mcap").messages())
    assert [(m.record.stamp_ns, m.log_time_ns) for m in messages] == [(3, 3), (3, 7)]


def test_the_same_calls_give_the_same_bytes(tmp_path):
    write(tmp_path / "a.mcap", estimator="ekf", config="{}")
    write(tmp_path / "b.mcap", estimator="ekf", config="{}")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_metadata_says_how_the_log_was_made(tmp_path):
    write(tmp_path / "log.mcap", estimator="ekf", config='{"gate": 9.0}')
    metadata = LogFile(tmp_path / "log.mcap").metadata["fieldloc"]
    assert metadata["estimator"] == "ekf"
    assert metadata["config"] == '{"gate": 9.0}'
    assert metadata["version"]


def test_a_file_is_made_of_chunks_that_a_killed_program_can_afford_to_lose(tmp_path):
    write(tmp_path / "log.mcap", count=12_000)
    with (tmp_path / "log.mcap").open("rb") as file:
        sizes = [index.uncompressed_size for index in mcap.reader.make_reader(file).get_summary().chunk_indexes]
    assert len(sizes) > 3
    assert max(sizes) < 257 * 1024


def test_nothing_appears_under_the_name_before_the_end(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/truth", truth(0))
        assert not (tmp_path / "log.mcap").exists()
    assert left_over(tmp_path) == ["log.mcap"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_interrupted_block_leaves_no_file_and_an_old_one_untouched(tmp_path, error):
    for path in (tmp_path / "new.mcap", tmp_path / "old.mcap"):
        old = path.name == "old.mcap"
        if old:
            write(path)
            before = path.read_bytes()
        with pytest.raises(error):
            write_until(path, error)
        assert left_over(tmp_path) == (["old.mcap"] if old else [])
    assert (tmp_path / "old.mcap").read_bytes() == before


CHILD = """
    import sys, time
    import numpy as np
    from fieldloc.measurements import Truth
    from logs.writer import LogWriter
    with LogWriter(sys.argv[1]) as log:
        i = 0
        while True:
            log.write("/truth", Truth(i, np.zeros(3)))
            i += 1
            if i == 8000:
                print("running", flush=True)
            if i > 8000:
                time.sleep(0.001)
"""


def run_until_killed(path, number):
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(CHILD), str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=interruptible,
    )
    try:
        assert child.stdout.readline() == b"running\n"
        time.sleep(0.02)
        child.send_signal(number)
        child.communicate(timeout=30)
    finally:
        child.kill()
        child.wait()
    return child.returncode


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, -signal.SIGINT)])
def test_a_signal_leaves_nothing_behind(tmp_path, number, code):
    assert run_until_killed(tmp_path / "log.mcap", number) == code
    assert left_over(tmp_path) == []


def test_a_killed_program_leaves_a_readable_beginning_under_another_name(tmp_path):
    run_until_killed(tmp_path / "log.mcap", signal.SIGKILL)
    (name,) = left_over(tmp_path)
    assert name.startswith(".log.mcap.")
    assert name.endswith(".partial")
    log = LogFile(tmp_path / name)
    assert len(list(log.records(Truth))) > 1000
    assert "cut off" in log.warnings[0]


def test_the_signal_handler_is_gone_afterwards(tmp_path):
    with LogWriter(tmp_path / "log.mcap"):
        assert callable(signal.getsignal(signal.SIGTERM))
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_handler_of_someone_else_stays(tmp_path):
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with LogWriter(tmp_path / "log.mcap"):
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


def test_folders_on_the_way_are_made(tmp_path):
    write(tmp_path / "runs" / "today" / "log.mcap")
    assert LogFile(tmp_path / "runs" / "today" / "log.mcap").has(Truth)


def test_a_place_that_cannot_be_written_is_the_user_s_error(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file" / "log.mcap", tmp_path / "folder"):
        with pytest.raises(FieldlocError, match=str(path)):
            write(path)


def test_a_full_disk_is_the_user_s_error(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))  # the system refuses to write more into any one file
    try:
        with pytest.raises(FieldlocError, match=r"log\.mcap: cannot be written: File too large"):
            write(tmp_path / "log.mcap", count=10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert left_over(tmp_path) == []


def test_a_caller_s_mistakes_are_value_errors(tmp_path):
    field = FieldMap("empty", np.zeros((0, 2, 2)), np.zeros((0, 3)), ())
    with LogWriter(tmp_path / "log.mcap") as log:
        with pytest.raises(ValueError, match="FieldMap has no stamp"):
            log.write("/field", field)
        log.write("/truth", truth(0))
        with pytest.raises(ValueError, match=r"/truth carries fieldloc\.Truth\.v1"):
            log.write("/truth", Compass(0, 0.0, 0.1))
        with pytest.raises(ValueError, match=r"fieldloc\.Estimate\.v1 at 0\.0 s: covariance"):
            log.write("/estimate", Estimate(0, np.zeros(3), -np.eye(3)))
    assert len(list(LogFile(tmp_path / "log.mcap").messages())) == 1
