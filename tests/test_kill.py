"""Programs that are killed at random moments: what they read is untouched, what they write is absent or whole.

FIELDLOC_KILLS says how often each is killed.
"""

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import mcap.exceptions
import numpy as np
import pytest
from children import interruptible
from edit_logs import contents
from mcap.stream_reader import StreamReader

from fieldloc.measurements import Odometry
from logs.reader.container import open_container
from logs.samples import sample_path
from logs.writer import LogWriter

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
KILLS = int(os.environ.get("FIELDLOC_KILLS", "10"))
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
ALIVE = """
    import sys, time
    import numpy as np
    from fieldloc.measurements import Truth
    from logs.writer import LogWriter
    with LogWriter(sys.argv[1]) as log:
        for i in range(100_000):
            log.write("/truth", Truth(i, np.array([0.1 * i, 0.0, 0.0])))
            if i % 50 == 0:
                print(time.monotonic(), i + 1, flush=True)
                time.sleep(0.005)
"""


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        preexec_fn=interruptible,
    )


def finish(*arguments):
    child = start(*arguments)
    child.communicate(timeout=300)
    assert child.returncode == 0


def kill_after(child, seconds, number):
    """What it had printed by then."""
    try:
        time.sleep(seconds)
        child.send_signal(number)
        return child.communicate(timeout=60)[0].decode()
    finally:
        child.kill()
        child.wait()


def messages_by_mcap(path):
    """How many messages mcap's own reader of streams gets out of an unfinished file before it gives up.

    Ours may get more, never fewer: a kill in the midst of a chunk leaves its beginning, which mcap drops whole.
    """
    count = 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                count += type(record).__name__ == "Message"
        except (mcap.exceptions.McapError, ValueError, OSError):
            pass
    return count


def left_over(out, number):
    """The unfinished file, of which there may be one after SIGKILL and none after the others; removed."""
    partials = [*out.parent.glob(f".{out.name}.*.partial")]
    assert len(partials) <= (number == signal.SIGKILL)
    return partials


@pytest.mark.parametrize("moment", range(max(KILLS // 2, 3)))
def test_all_but_the_last_second_of_a_killed_recording_can_be_read(tmp_path, moment):
    number = SIGNALS[moment % 3]
    child = start("-c", textwrap.dedent(ALIVE), tmp_path / "log.mcap")
    printed = kill_after(child, random.Random(moment).uniform(0.5, 4.5), number).splitlines()
    assert not (tmp_path / "log.mcap").exists()
    partials = left_over(tmp_path / "log.mcap", number)
    if number == signal.SIGKILL and printed:
        (partial,) = partials
        told = [(float(at), int(count)) for at, count in map(str.split, printed)]
        due = max((count for at, count in told if at < told[-1][0] - 1.0), default=0)
        found = contents(partial) if partial.stat().st_size > 8 else []
        assert len(found) >= due
        assert [m[1] for m in found] == [*range(len(found))]
        assert messages_by_mcap(partial) <= len(found)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Long enough that cutting it takes about a second."""
    path = tmp_path_factory.mktemp("logs") / "log.mcap"
    rng = np.random.default_rng(0)
    with LogWriter(path) as out:
        for i in range(150_000):
            out.write("/odometry", Odometry(i * 10**6, rng.normal(size=3), 0.01 * np.eye(3)))
    return path


@pytest.mark.parametrize("command", ["cut", "repair", "merge", "run"])
def test_a_command_killed_at_any_moment_leaves_its_input_alone_and_no_half_output(tmp_path, command, log):
    source = Path(sample_path("woods")) if command == "run" else log
    before = source.read_bytes()
    out = tmp_path / "out.mcap"
    options = {"cut": ["--from", "1"], "run": ["--to", "60"]}.get(command, [])
    arguments = ["-m", "fieldloc", command, source, "-o", out, *options]
    began = time.monotonic()
    finish(*arguments)
    took_s = time.monotonic() - began
    whole = contents(out)
    rng = random.Random(command)
    for i in range(KILLS):
        out.unlink(missing_ok=True)
        number = SIGNALS[i % 3]
        child = start(*arguments)
        kill_after(child, rng.uniform(0.2, 1.1) * took_s, number)
        assert source.read_bytes() == before
        partials = left_over(out, number)
        if out.exists():
            assert contents(out) == whole
        for partial in partials:
            found = contents(partial) if partial.stat().st_size > 8 else []
            assert found == whole[: len(found)]
            assert messages_by_mcap(partial) <= len(found)
            partial.unlink()
    finish(*arguments)
    assert contents(out) == whole
    assert open_container(out).damage == ()
