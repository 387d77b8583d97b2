import importlib
import io
import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mcap.writer
import numpy as np
import pytest
from children import interruptible
from program import Call, Said
from real_logs import nearer_than, relabelled, sample_messages, without, write

from estimators.base import Ambiguous, Estimate
from estimators.config import Config
from estimators.dead_reckoning import DeadReckoning
from estimators.ekf import Ekf
from estimators.registry import ALL
from fieldloc.cli import main
from fieldloc.field import FieldMap, field_to_toml
from fieldloc.measurements import Compass, LandmarkScan, Odometry, Truth
from logs.reader import LogFile, Message
from logs.samples import sample_path
from logs.schema import BY_KIND, Record, encode
from logs.writer import LogWriter

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.usefixtures("here")
ONLINE = ("dead-reckoning", "ekf", "particles", "mixture")
UNSURE = [name for name in (*ONLINE, "smooth") if isinstance(ALL[name](Config()), Ambiguous)]
COMMANDS = (
    "import",
    "simulate",
    "info",
    "render",
    "detect",
    "run",
    "smooth",
    "locate",
    "calibrate",
    "camera",
    "compare",
    "evaluate",
    "export",
    "report",
    "view",
    "cut",
    "merge",
    "repair",
)
UNTIL_S = 8.0
COUNT = 81  # scans and odometry messages by then


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with logs, whole and broken."""
    out = tmp_path_factory.mktemp("made")
    messages = sample_messages(UNTIL_S)
    write(out / "good.mcap", messages)
    write(out / "nomap.mcap", messages, without(FieldMap))
    write(out / "noodometry.mcap", messages, without(Odometry))
    write(out / "blind.mcap", messages, without(LandmarkScan))
    write(out / "notruth.mcap", messages, without(Truth))
    write(out / "offmap.mcap", messages, relabelled(lambda label: "99" if label == "11" else label))
    near = nearer_than(1.5)
    write(out / "lonely.mcap", messages, lambda record: relabelled(lambda label: None)(near(record)))
    raw(out / "nan.mcap", messages, lambda topic, i, data: with_nan(data) if i < 3 else data)
    raw(out / "allnan.mcap", messages, lambda topic, i, data: with_nan(data))
    raw(
        out / "nantruth.mcap",
        messages,
        lambda topic, i, data: data.replace(b'"x_m":', b'"x_m":NaN,"x":') if topic == "/truth" and i < 3 else data,
    )
    for role in ("odometry", "landmarks", "truth"):
        raw(out / f"foreign_{role}.mcap", messages, foreign=f"/{role}")
    strange = Message("/estimate", 0, Truth(0, np.zeros(3)))
    raw(out / "foreign_estimate.mcap", [*messages, strange], foreign="/estimate")
    assert main(["run", str(out / "good.mcap"), "-o", str(out / "mixture.mcap"), "--quiet"]) == 0
    halved(out / "good.mcap", out / "cut.mcap")
    halved(out / "mixture.mcap", out / "cutmixture.mcap")
    (out / "empty.mcap").write_bytes(b"")
    (out / "stub.mcap").write_bytes((out / "good.mcap").read_bytes()[:5])
    (out / "text.mcap").write_text("stamp,x,y\n1,2,3\n")
    (out / "folder.mcap").mkdir()
    return out


def raw(
    path: Path,
    messages: Sequence[Message],
    edit: Callable[[str, int, bytes], bytes] = lambda topic, i, data: data,
    foreign: str = "",
) -> None:
    """Messages with their bytes edited, in small chunks; the topic `foreign` carries what is none of ours."""
    with path.open("wb") as file:
        log = mcap.writer.Writer(file, chunk_size=4 * 1024)
        log.start()
        channels: dict[str, int] = {}
        counts: dict[str, int] = {}
        for message in messages:
            topic = message.topic
            if topic not in channels:
                strange = topic == foreign
                name = "std_msgs/msg/String" if strange else BY_KIND[type(message.record)].name
                schema = log.register_schema(name, "ros2msg" if strange else "jsonschema", b"")
                channels[topic] = log.register_channel(topic, "cdr" if strange else "json", schema)
            i = counts[topic] = counts.get(topic, -1) + 1
            time_ns = message.log_time_ns
            log.add_message(channels[topic], time_ns, edit(topic, i, encode(message.record)), time_ns)
        log.finish()


def with_nan(data: bytes) -> bytes:
    """Only scans of landmarks have a range."""
    return data.replace(b'"range_m":', b'"range_m":NaN,"x":', 1)


def halved(source: Path, path: Path) -> None:
    """The first half of a log's bytes."""
    raw(path, list(LogFile(source).messages()))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def listing(*folders: Path) -> list[tuple[str, int]]:
    """Every file and folder below, hidden ones too, with sizes."""
    return sorted((str(path), path.stat().st_size) for folder in folders for path in folder.rglob("*"))


def poses(path: Path) -> list[Estimate]:
    return list(LogFile(path).records(Estimate))


# -- help and mistakes in what was typed -------------------------------------------------------------------------------


def test_help_lists_every_command_with_an_example(call: Call) -> None:
    said = call("--help")
    assert said.code == 0
    commands, examples = said.out.split("examples:")
    for command in COMMANDS:
        assert re.search(rf"^ +{command}\s+[A-Z]", commands, re.MULTILINE), command
        assert f"  fieldloc {command} " in examples


@pytest.mark.parametrize("command", [*COMMANDS, "import woods", "import utias"])
def test_every_command_has_help_with_its_options_and_an_example(call: Call, command: str) -> None:
    said = call(*command.split(), "--help")
    assert (said.code, said.err) == (0, "")
    assert f"usage: fieldloc {command} " in said.out
    assert f"\nexample: fieldloc {command} " in said.out
    assert "--quiet" in said.out


def test_the_examples_are_well_typed(call: Call, here: Path) -> None:
    """In an empty folder each fails for want of its file, not for how it is spelled."""
    examples = call("--help").out.split("examples:")[1].split("\n")[1:]
    typed = [example.split()[1:] for example in examples if example]
    assert len(typed) == len(COMMANDS) + 1
    for arguments in typed:
        if arguments[0] in ("simulate", "render"):  # these need no file
            continue
        said = call(*arguments)
        assert said.code == 1
        if arguments[0] == "camera":  # a picture that is not there is left out
            assert said.err.startswith("fieldloc: warning: boards/*.jpg: no such picture")
            continue
        assert re.fullmatch(r"fieldloc: \S+: no such (camera )?file.*\n", said.err), said.err
    assert listing(here) == []


@pytest.mark.parametrize(
    ("typed", "named"),
    [
        ("", "COMMAND"),
        ("localize x.mcap", "invalid choice: 'localize'"),
        ("run", "LOG"),
        ("export x.mcap y.mcap --format csv", "unrecognized arguments: y.mcap"),
        ("run x.mcap --estimator kalman", "--estimator: invalid choice: 'kalman'"),
        (
            "run x.mcap --start 1,2",
            "--start: '1,2' is neither X,Y,HEADING_DEG in numbers",
        ),
        ("run x.mcap --start 1,2,east", "--start: '1,2,east'"),
        ("run x.mcap --start -1,nan,0", "--start: '-1,nan,0'"),
        ("run x.mcap --start", "--start: expected one argument"),
        ("import mars x", "SOURCE"),
        ("import woods x --max-range-m 0", "--max-range-m: '0' is not a number above 0"),
        ("import woods x --max-range-m far", "--max-range-m: 'far' is not a number above 0"),
        ("import utias x", "--robot"),
        ("import utias x --robot one", "--robot"),
        ("evaluate x.mcap", "--truth"),
        ("evaluate x.mcap --truth y.mcap --max-difference-s -1", "--max-difference-s"),
        ("export x.mcap", "--format"),
        ("export x.mcap --format xml", "--format: invalid choice: 'xml'"),
        ("compare --estimators ekf,kalman", "no estimator 'kalman'; there is dead-reckoning, ekf, "),
    ],
)
def test_a_mistyped_command_is_one_line_that_names_it_and_the_way_out(
    call: Call, here: Path, typed: str, named: str
) -> None:
    said = call(*typed.split())
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert said.err.startswith("fieldloc: ")
    assert named in said.err
    assert re.search(r"; see fieldloc.* --help$|there is", said.lines[0])
    assert listing(here) == []


@pytest.mark.parametrize(
    ("typed", "named"),
    [
        ("--set ekf", "--set ekf: needs SECTION.NAME=NUMBER"),
        ("--set particles.count=many", "--set particles.count=many"),
        ("--set particles.size=3", "particles.size: unknown key"),
        ("--set magic.size=3", "magic: unknown"),
        ("--config missing.toml", "missing.toml"),
        ("--config bad.toml", "bad.toml"),
        ("--config .", "."),
        ("--field moon", "moon: no such field map; give one of kidsize-2014"),
        ("--field bad.toml", "bad.toml"),
    ],
)
@pytest.mark.parametrize("command", ["run", "smooth", "compare"])
def test_bad_settings_are_one_line_that_names_them(
    call: Call, here: Path, made: Path, command: str, typed: str, named: str
) -> None:
    (here / "bad.toml").write_text("this is [ not TOML")
    before = listing(here)
    said = call(command, made / "good.mcap", *typed.split())
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert said.err.startswith("fieldloc: ")
    assert named in said.err
    assert listing(here) == before


# -- input that is none ------------------------------------------------------------------------------------------------

NO_LOGS = {
    "missing.mcap": "no such file",
    "folder.mcap": "is a directory",
    "empty.mcap": "empty",
    "stub.mcap": "cut off within its first 8 bytes",
    "text.mcap": "not an MCAP file",
}
READERS = {
    "info": "info {log}",
    "run": "run {log} -o out.mcap",
    "smooth": "smooth {log} -o out.mcap",
    "compare": "compare {log} --estimators dead-reckoning -o out",
    "compare the second": "compare {good} {log} --estimators dead-reckoning -o out",
    "evaluate": "evaluate {log} --truth {good}",
    "evaluate against": "evaluate {mixture} --truth {log}",
    "export": "export {log} --format tum -o out.tum",
    "import woods": "import woods {log} -o out.mcap",
    "import utias": "import utias {log} --robot 1 -o out.mcap",
}


def filled(pattern: str, made: Path, log: str = "", out: str = "") -> list[str]:
    logs = {path.stem: path for path in made.iterdir()}
    return [part.format(log=made / log, out=out, **logs) for part in pattern.split()]


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("log", NO_LOGS)
def test_what_is_no_log_is_one_line_and_leaves_nothing(
    call: Call, here: Path, made: Path, reader: str, log: str
) -> None:
    before = listing(here, made)
    said = call(*filled(READERS[reader], made, log))
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert said.err.startswith(f"fieldloc: {made / log}: ")
    if not reader.startswith("import"):
        assert NO_LOGS[log] in said.err
    assert listing(here, made) == before


@pytest.mark.parametrize(
    ("pattern", "log", "problem"),
    [
        *((READERS[r], "nomap.mcap", "holds no map; name one with --field") for r in ("run", "smooth", "compare")),
        *((READERS[r], "blind.mcap", "no usable message on /landmarks,") for r in ("run", "smooth", "compare")),
        (READERS["evaluate"], "good.mcap", "no usable message on /estimate; give what fieldloc run or smooth wrote"),
        (READERS["export"], "good.mcap", "no usable message on /estimate; give what fieldloc run or smooth wrote"),
        (READERS["evaluate against"], "notruth.mcap", "no usable message on /truth"),
        ("export {log} --format csv --truth -o out.csv", "notruth.mcap", "no usable message on /truth"),
    ],
)
def test_a_log_that_lacks_what_is_needed_is_one_line_that_names_the_topic(
    call: Call, here: Path, made: Path, pattern: str, log: str, problem: str
) -> None:
    said = call(*filled(pattern, made, log))
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert said.err.startswith(f"fieldloc: {made / log}: ")
    assert problem in said.err
    assert listing(here) == []


@pytest.mark.parametrize(
    ("pattern", "topic"),
    [
        *((READERS[reader], "landmarks") for reader in ("run", "smooth", "compare")),
        (READERS["evaluate against"], "truth"),
        (READERS["evaluate"], "estimate"),
        (READERS["export"], "estimate"),
    ],
)
def test_where_a_needed_topic_carries_something_else_that_is_told_too(
    call: Call, here: Path, made: Path, pattern: str, topic: str
) -> None:
    said = call(*filled(pattern, made, f"foreign_{topic}.mcap"))
    assert (said.code, said.out) == (1, "")
    warning, error = said.lines
    assert f"topic /{topic} carries std_msgs/msg/String (cdr), needs fieldloc." in warning
    assert f"no usable message on /{topic}" in error
    assert listing(here) == []


@pytest.mark.parametrize(("reader", "topic"), [("run", "odometry"), ("smooth", "odometry"), ("compare", "truth")])
def test_a_topic_that_can_be_done_without_is_a_warning(call: Call, made: Path, reader: str, topic: str) -> None:
    said = call(*filled(READERS[reader], made, f"foreign_{topic}.mcap"))
    assert said.code == 0
    assert f"topic /{topic} carries std_msgs/msg/String (cdr), needs fieldloc." in said.err


def test_info_shows_a_foreign_topic_and_says_what_it_cannot_be(call: Call, made: Path) -> None:
    said = call("info", made / "foreign_odometry.mcap")
    assert said.code == 0
    assert "std_msgs/msg/String" in said.out
    assert said.lines == [
        f"fieldloc: warning: {made / 'foreign_odometry.mcap'}: topic /odometry carries std_msgs/msg/String (cdr), "
        "needs fieldloc.Odometry.v1 (json)"
    ]


def test_a_truth_of_a_foreign_type_is_nothing_to_an_estimator(call: Call, made: Path, here: Path) -> None:
    said = call("run", made / "foreign_truth.mcap", "-o", "out.mcap")
    assert (said.code, said.err) == (0, "")
    assert len(poses(here / "out.mcap")) == COUNT


# -- input of which the rest is usable ---------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["run", "smooth", "compare", "info"])
def test_a_log_cut_in_the_middle_is_used_as_far_as_it_goes_with_one_warning(
    call: Call, made: Path, here: Path, command: str
) -> None:
    said = call(*filled(READERS[command], made, "cut.mcap"))
    assert said.code == 0
    assert len(said.lines) == 1
    assert re.match(rf"fieldloc: warning: {made / 'cut.mcap'}: cut off .*: \d+ messages read, up to", said.err)
    if command in ("run", "smooth"):
        assert 10 < len(poses(here / "out.mcap")) < COUNT - 10


def test_estimates_and_truth_cut_in_the_middle_are_evaluated_and_exported_as_far_as_they_go(
    call: Call, made: Path, here: Path
) -> None:
    for arguments, counted in (
        (("evaluate", made / "cutmixture.mcap", "--truth", made / "good.mcap"), "cutmixture"),
        (("evaluate", made / "mixture.mcap", "--truth", made / "cut.mcap"), "cut"),
        (("export", made / "cutmixture.mcap", "--format", "tum", "-o", "out.tum"), "cutmixture"),
    ):
        said = call(*arguments)
        assert said.code == 0
        assert len(said.lines) == 1
        assert f"{counted}.mcap: cut off" in said.err
    assert 10 < len((here / "out.tum").read_text().splitlines()) < COUNT


@pytest.mark.parametrize("command", ["run", "smooth", "compare"])
def test_messages_with_nan_are_counted_and_the_rest_used(call: Call, made: Path, here: Path, command: str) -> None:
    said = call(*filled(READERS[command], made, "nan.mcap"))
    assert said.code == 0
    assert said.lines == [
        f"fieldloc: warning: {made / 'nan.mcap'}: 3 of {COUNT} messages left out, the first: /landmarks at 0.0 s: "
        "landmarks[0].range_m is NaN (fieldloc.LandmarkScan.v1)"
    ]
    if command == "run":
        assert len(poses(here / "out.mcap")) == COUNT - 3


def test_a_truth_with_nan_is_counted_by_those_who_look_at_it_and_only_by_them(call: Call, made: Path) -> None:
    counted = f"nantruth.mcap: 3 of {COUNT} messages left out, the first: /truth at 0.0 s: x_m is NaN"
    for command in ("compare", "evaluate against", "info"):
        said = call(*filled(READERS[command], made, "nantruth.mcap"))
        assert (said.code, len(said.lines)) == (0, 1)
        assert counted in said.err
    assert call(*filled(READERS["run"], made, "nantruth.mcap")).err == ""


@pytest.mark.parametrize("command", ["run", "smooth", "compare"])
def test_landmarks_that_are_not_on_the_map_are_counted_once_and_the_rest_used(
    call: Call, made: Path, command: str
) -> None:
    said = call(*filled(READERS[command], made, "offmap.mcap"))
    assert said.code == 0
    line = f"fieldloc: warning: offmap: {COUNT} observations left out: landmark 99 is not on the map woods"
    assert said.lines == [line]


def test_a_log_without_odometry_localizes_with_a_warning(call: Call, made: Path, here: Path) -> None:
    said = call("run", made / "noodometry.mcap", "-o", "out.mcap")
    assert said.code == 0
    assert len(said.lines) == 1
    assert "noodometry.mcap: no usable message on /odometry" in said.err
    assert len(poses(here / "out.mcap")) == COUNT


def test_all_messages_left_out_are_the_reason_given_before_the_end(call: Call, made: Path, here: Path) -> None:
    said = call("run", made / "allnan.mcap")
    assert (said.code, len(said.lines)) == (1, 2)
    assert f"{COUNT} of {COUNT} messages left out" in said.lines[0]
    assert "nothing to localize with" in said.lines[1]
    assert listing(here) == []


@pytest.mark.parametrize("command", [*ONLINE, "smooth"])
def test_a_log_from_which_no_start_can_be_told_needs_start_and_works_with_it(
    call: Call, made: Path, here: Path, command: str
) -> None:
    arguments = ["smooth"] if command == "smooth" else ["run", "--estimator", command]
    said = call(*arguments, made / "lonely.mcap", "-o", "out.mcap")
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert re.match("fieldloc: lonely: nothing seen .*; give it with --start X,Y,HEADING_DEG$", said.lines[0])
    assert listing(here) == []
    said = call(*arguments, made / "lonely.mcap", "-o", "out.mcap", "--start", "3.02,0.07,-166.7")
    assert (said.code, said.err) == (0, "")
    assert len(poses(here / "out.mcap")) == COUNT


def test_a_map_given_by_hand_stands_in_for_the_logs_own(call: Call, made: Path, here: Path) -> None:
    field = LogFile(made / "good.mcap").field_map()
    assert field is not None
    (here / "tubes.toml").write_text(field_to_toml(field))
    said = call("run", made / "nomap.mcap", "--field", "tubes.toml", "-o", "out.mcap")
    assert (said.code, said.err) == (0, "")
    ours = [e.pose for e in poses(here / "out.mcap")]
    assert np.array_equal(ours, [e.pose for e in poses(made / "mixture.mcap")])
    assert LogFile(here / "out.mcap").field_map() is not None


# -- where results go --------------------------------------------------------------------------------------------------

WRITERS = {
    "run": "run {good} -o {out}",
    "smooth": "smooth {good} -o {out}",
    "compare": "compare {good} --estimators dead-reckoning -o {out}",
    "export": "export {mixture} --format tum -o {out}",
}


@pytest.mark.parametrize("writer", WRITERS)
def test_missing_folders_are_made(call: Call, made: Path, here: Path, writer: str) -> None:
    assert call(*filled(WRITERS[writer], made, out="a/b/out")).code == 0
    assert (here / "a" / "b" / "out").exists()


@pytest.mark.parametrize("writer", WRITERS)
def test_what_cannot_be_written_is_one_line_before_the_work(
    call: Call, made: Path, here: Path, writer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("logs.replay.replay", None)  # whoever gets so far fails
    (here / "file").write_text("mine")
    before = listing(here)
    for target in ("file/out", "file/deep/out", *(["file"] if writer == "compare" else ["."])):
        said = call(*filled(WRITERS[writer], made, out=target))
        assert (said.code, said.out, len(said.lines)) == (1, "", 1)
        assert re.match(rf"fieldloc: {re.escape(target)}: .*(file|directory)", said.err), said.err
    assert listing(here) == before
    assert (here / "file").read_text() == "mine"


@pytest.mark.parametrize("writer", WRITERS)
def test_a_folder_without_permission_is_one_line(
    call: Call, made: Path, here: Path, writer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("logs.output.os.access", lambda path, mode: mode != os.W_OK)  # root may write anywhere
    said = call(*filled(WRITERS[writer], made, out="locked/out"))
    assert (said.code, said.out) == (1, "")
    assert said.lines == [f"fieldloc: locked/out: cannot be written: no permission for {here}"]
    assert listing(here) == []


@pytest.mark.parametrize("pattern", ["run", "smooth", "export --format csv", "import woods"])
@pytest.mark.parametrize("spelling", ["same", "link", "detour"])
def test_nothing_is_written_over_what_is_read(call: Call, made: Path, here: Path, pattern: str, spelling: str) -> None:
    source = here / "log.mcap"
    source.write_bytes((made / "mixture.mcap" if "export" in pattern else made / "good.mcap").read_bytes())
    (here / "link.mcap").symlink_to(source)
    target = {"same": "log.mcap", "link": "link.mcap", "detour": "../here/log.mcap"}[spelling]
    before, bytes_before = listing(here), source.read_bytes()
    said = call(*pattern.split(), "log.mcap", "-o", target)
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert f"{target}: is what is read" in said.err
    assert listing(here) == before
    assert source.read_bytes() == bytes_before


def test_results_go_where_the_help_says(call: Call, made: Path, here: Path) -> None:
    assert call("run", made / "good.mcap", "--estimator", "dead-reckoning").code == 0
    assert call("smooth", made / "good.mcap").code == 0
    assert call("export", "runs/good-smooth.mcap", "--format", "csv").code == 0
    assert call("compare", made / "good.mcap", "--estimators", "ekf").code == 0
    runs = here / "runs"
    assert {path.name for path in runs.iterdir()} == {
        "good-dead-reckoning.mcap",
        "good-smooth.mcap",
        "good-smooth.csv",
        "compare",
    }
    assert (runs / "compare" / "report.html").is_file()


# -- run, smooth -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spelled", [["--start", "-2.5,0.5,90"], ["--start=-2.5,0.5,90"], ["--start", "-2.5,.5,9e1"]])
def test_a_start_may_begin_with_a_minus(call: Call, here: Path, spelled: list[str]) -> None:
    with LogWriter(here / "log.mcap") as log:
        log.write("/field", FieldMap("nothing", np.zeros((0, 2, 2)), np.zeros((0, 3)), ()), 0)
        log.write("/odometry", Odometry(0, np.zeros(3)))
        log.write("/compass", Compass(10**9, np.pi / 2, 0.1))
    said = call("run", "log.mcap", *spelled, "-o", "out.mcap")
    assert (said.code, said.err) == (0, "")
    assert poses(here / "out.mcap")[0].pose == pytest.approx([-2.5, 0.5, np.pi / 2], abs=1e-12)


def test_a_result_says_how_it_was_made(call: Call, made: Path, here: Path) -> None:
    (here / "mine.toml").write_text("[robust]\nrestart_after = 7\n")
    arguments = ["--config", "mine.toml", "--set", "particles.count=50", "--set", "particles.seed=3"]
    said = call("run", made / "good.mcap", "--estimator", "particles", *arguments, "-o", "out.mcap")
    assert said.code == 0
    metadata = LogFile(here / "out.mcap").metadata["fieldloc"]
    assert (metadata["estimator"], metadata["log"]) == ("particles", "good.mcap")
    config = json.loads(metadata["config"])
    assert (config["robust"]["restart_after"], config["particles"]["count"], config["particles"]["seed"]) == (7, 50, 3)
    assert re.match(rf"out\.mcap: {COUNT} estimates of particles in \d+\.\d s\n$", said.out)


@pytest.mark.parametrize("command", [*ONLINE, "smooth"])
def test_estimates_carry_the_logs_own_stamps(call: Call, made: Path, here: Path, command: str) -> None:
    arguments = ["smooth"] if command == "smooth" else ["run", "--estimator", command]
    assert call(*arguments, made / "good.mcap", "-o", "out.mcap").code == 0
    stamps = [record.stamp_ns for record in LogFile(made / "good.mcap").records(Odometry)]
    assert [e.stamp_ns for e in poses(here / "out.mcap")] == stamps


@pytest.mark.parametrize(
    "pattern", ["run {good} -o out.mcap", "smooth {good} -o out.mcap", "export {mixture} --format tum -o out.tum"]
)
def test_quiet_says_nothing_but_warnings(call: Call, made: Path, pattern: str) -> None:
    assert call(*filled(pattern, made)).out != ""
    assert call(*filled(pattern, made), "--quiet") == Said(0, "", "")
    cut = pattern.replace("{good}", "{cut}").replace("{mixture}", "{cutmixture}")
    said = call(*filled(cut, made), "--quiet")
    assert (said.code, said.out, len(said.lines)) == (0, "", 1)


def test_quiet_may_stand_before_or_after_an_imports_source(call: Call, made: Path) -> None:
    for arguments in (["import", "--quiet", "woods"], ["import", "woods", "--quiet"]):
        assert call(*arguments, made / "text.mcap").code == 1  # understood: what it objects to is the file


class Failing(DeadReckoning):
    """Loses itself, or its doubts, four seconds in."""

    lost: str

    def estimate(self) -> Estimate | None:
        now = super().estimate()
        if now is None or now.stamp_ns < 4 * 10**9:
            return now
        if self.lost == "pose":
            return replace(now, pose=now.pose * np.nan)
        return replace(now, covariance=now.covariance * np.nan)


class LosesPose(Failing):
    lost = "pose"


class LosesCovariance(Failing):
    lost = "covariance"


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "estimators.registry.ALL", {"dead-reckoning": LosesPose, "particles": LosesCovariance, "ekf": Ekf}
    )


@pytest.mark.usefixtures("failing")
@pytest.mark.parametrize(
    ("estimator", "said_of_it"),
    [
        ("dead-reckoning", "good: LosesPose failed at 4.0 s: its pose is not finite"),
        ("particles", "fieldloc.Estimate.v1 at 4.0 s: covariance is NaN"),
    ],
)
def test_an_estimate_that_is_not_finite_is_one_line_with_its_stamp_and_no_file(
    call: Call, made: Path, here: Path, estimator: str, said_of_it: str
) -> None:
    said = call("run", made / "good.mcap", "--estimator", estimator, "-o", "out.mcap")
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert said_of_it in said.err
    assert listing(here) == []


# -- import ------------------------------------------------------------------------------------------------------------

DATA_SET = {
    "Barcodes.dat": "1 5\n6 63\n7 25\n",
    "Landmark_Groundtruth.dat": "6 2.0 0.0 0.0001 0.0001\n7 0.0 4.0 0.0001 0.0001\n",
    "Robot1_Odometry.dat": "1248444187.156 0.1 0.0\n1248444187.256 0.1 0.0\n",
    "Robot1_Measurement.dat": "1248444187.2 63 2.0 0.0\n1248444187.2 25 4.0 1.57\n1248444187.3 99 1.0 0.0\n",
    "Robot1_Groundtruth.dat": "1248444187.156 0.0 0.0 0.0\n",
}


@pytest.mark.parametrize(
    ("options", "labels", "ranges_m"),
    [
        ([], ("6", "7"), [2.0, 4.0]),
        (["--anonymous"], (None, None), [2.0, 4.0]),
        (["--max-range-m", "3"], ("6",), [2.0]),
        (["--anonymous", "--max-range-m", "3"], (None,), [2.0]),
    ],
)
def test_import_cuts_as_it_is_told_and_counts_what_it_leaves_out(
    call: Call, here: Path, tmp_path: Path, options: list[str], labels: tuple[str | None, ...], ranges_m: list[float]
) -> None:
    for name, text in DATA_SET.items():
        (tmp_path / name).write_text(text)
    said = call("import", "utias", tmp_path, "--robot", "1", *options)
    assert said.code == 0
    assert said.lines == ["fieldloc: warning: 1 observation left out: barcode 99 not in Barcodes.dat"]
    assert said.out == "utias-robot1.mcap: 1 /field, 2 /landmarks, 2 /odometry, 1 /truth\n"
    first = next(LogFile(here / "utias-robot1.mcap").records(LandmarkScan))
    assert (first.labels, first.range_bearing[:, 0].tolist()) == (labels, ranges_m)
    assert first.stamp_ns == 1_248_444_187_200_000_000


def test_a_robot_that_is_not_in_the_data_set_is_one_line(call: Call, here: Path, tmp_path: Path) -> None:
    for name, text in DATA_SET.items():
        (tmp_path / name).write_text(text)
    said = call("import", "utias", tmp_path, "--robot", "6")
    assert (said.code, said.out, said.err) == (1, "", f"fieldloc: {tmp_path}: there is no robot 6, only 1\n")
    assert listing(here) == []


# -- compare -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compared(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What compare leaves of all estimators on two logs, one of them without truth."""
    out = tmp_path_factory.mktemp("compared")
    logs = [str(made / "good.mcap"), str(made / "notruth.mcap")]
    assert main(["compare", *logs, "-o", str(out), "--quiet"]) == 0
    return out


def test_compare_leaves_a_page_pictures_and_numbers(compared: Path) -> None:
    names = {path.name for path in compared.iterdir()}
    pictures = {f"good-{name}-errors.png" for name in (*ONLINE, "smooth")}
    pictures |= {f"{log}-{name}-hypotheses.png" for log in ("good", "notruth") for name in UNSURE}
    assert names == {"report.html", "metrics.json", "good-field.png", "notruth-field.png", *pictures}
    assert all((compared / name).read_bytes()[1:4] == b"PNG" for name in names if name.endswith(".png"))
    document = json.loads((compared / "metrics.json").read_text())
    good, notruth = document["logs"]
    assert (good["log"], notruth["log"]) == ("good", "notruth")
    assert set(good["estimators"]) == {*ONLINE, "smooth"}
    assert all(run["ate_rmse_m"] < 1.0 for run in good["estimators"].values())
    assert all("ate_rmse_m" not in run for run in notruth["estimators"].values())


def test_the_page_needs_nothing_but_itself(compared: Path) -> None:
    page = (compared / "report.html").read_text()
    assert re.findall(r"""(?:src|href|data|action)\s*=\s*["']?(?!data:|#)[^"'\s>]+""", page) == []
    assert not re.search(r"@import|url\((?!['\"]?data:)|<script|<link|<iframe", page)
    assert page.count("data:image/png;base64,") == 2 + len((*ONLINE, "smooth")) + 2 * len(UNSURE)


def test_compare_prints_the_table_and_where_the_report_is(call: Call, made: Path) -> None:
    said = call("compare", made / "good.mcap", "--estimators", "ekf,dead-reckoning,ekf", "-o", "out")
    assert (said.code, said.err) == (0, "")
    assert said.out.splitlines()[0] == f"good: {UNTIL_S:.1f} s, {COUNT} true poses"
    rows = [line.split()[0] for line in said.out.splitlines()[3:5]]
    assert rows == ["ekf", "dead-reckoning"]
    for heading in ("ATE [m]", "RMSE", "median", "max", "heading [deg]", "ANEES", "update [ms]", "p99", "log time"):
        assert heading in said.out
    assert said.out.endswith("\nreport: out/report.html\n")


def test_compare_without_truth_has_no_columns_of_errors(call: Call, made: Path) -> None:
    said = call("compare", made / "notruth.mcap", "--estimators", "ekf,smooth", "-o", "out")
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"notruth: {UNTIL_S:.1f} s, no truth\n")
    assert "update [ms]" in said.out
    assert not re.search("ATE|RMSE|ANEES", said.out)


def test_compare_without_a_log_takes_the_sample(call: Call, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logs.samples.sample_path", lambda name: {"woods": made / "good.mcap"}[name])
    said = call("compare", "--estimators", "ekf")
    assert said.code == 0
    assert said.out.startswith("no log given: the sample that ships with fieldloc")


def test_compare_starts_where_it_is_told_and_with_the_settings_it_is_given(call: Call, made: Path, here: Path) -> None:
    errors = []
    for options in ([], ["--set", "correlation.range_s=0", "--set", "correlation.bearing_s=0"]):
        said = call("compare", made / "lonely.mcap", "--estimators", "ekf", "--start", "3.02,0.07,-166.7", *options)
        assert (said.code, said.err) == (0, "")
        runs = json.loads((here / "runs" / "compare" / "metrics.json").read_text())["logs"][0]["estimators"]
        errors.append(runs["ekf"]["ate_rmse_m"])
    assert max(errors) < 0.5
    assert errors[0] != errors[1]


@pytest.mark.usefixtures("failing")
def test_compare_outlives_an_estimator_that_fails(call: Call, made: Path, here: Path) -> None:
    said = call("compare", made / "good.mcap", "--estimators", "dead-reckoning,ekf", "-o", "out")
    assert said.code == 0
    assert said.lines == ["fieldloc: warning: dead-reckoning: good: LosesPose failed at 4.0 s: its pose is not finite"]
    runs = json.loads((here / "out" / "metrics.json").read_text())["logs"][0]["estimators"]
    assert runs["ekf"]["ate_rmse_m"] < 0.1
    assert "ate_rmse_m" not in runs["dead-reckoning"]


@pytest.mark.usefixtures("failing")
def test_compare_of_failures_alone_is_an_error_and_leaves_no_report(call: Call, made: Path, here: Path) -> None:
    said = call("compare", made / "good.mcap", "--estimators", "dead-reckoning")
    assert (said.code, said.out) == (1, "")
    assert "LosesPose failed at 4.0 s" in said.lines[0]
    assert said.lines[-1] == "fieldloc: nothing to compare: no estimator has an estimate"
    assert listing(here) == []


# -- evaluate, export --------------------------------------------------------------------------------------------------


def test_evaluate_prints_what_is_in_its_json(call: Call, made: Path) -> None:
    text = call("evaluate", made / "mixture.mcap", "--truth", made / "good.mcap")
    numbers = call("evaluate", made / "mixture.mcap", "--truth", made / "good.mcap", "--json")
    assert (text.code, text.err, numbers.code, numbers.err) == (0, "", 0, "")
    metrics = json.loads(numbers.out)
    assert metrics["matched_poses"] == COUNT
    assert f"RMSE {metrics['ate_rmse_m']:.4f} m" in text.out
    assert f"RMSE {metrics['heading_rmse_deg']:.4f} deg" in text.out


def test_evaluate_of_another_recording_says_both_times(call: Call, made: Path, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "other.mcap") as log:
        log.write("/truth", Truth(10**18, np.zeros(3)))
    said = call("evaluate", made / "mixture.mcap", "--truth", tmp_path / "other.mcap")
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert "0.000 to 8.000 s" in said.err
    assert "1000000000.000" in said.err


def test_stamps_are_paired_as_close_as_told(call: Call, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        for stamp_ns, pose in ((0, np.zeros(3)), (10**9, np.ones(3))):
            log.write("/truth", Truth(stamp_ns, pose))
            log.write("/estimate", Estimate(stamp_ns + 20_000_000, pose, np.eye(3)))
    both = ("evaluate", tmp_path / "log.mcap", "--truth", tmp_path / "log.mcap")
    assert "within 0.01 s" in call(*both).err
    assert json.loads(call(*both, "--max-difference-s", "0.03", "--json").out)["matched_poses"] == 2


def test_export_writes_seconds_as_the_log_has_them(call: Call, tmp_path: Path, here: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(3):
            log.write("/estimate", Estimate(1_248_444_187_156_000_000 + i, np.array([i, -1.0, 0.5]), np.eye(3)))
    assert call("export", tmp_path / "log.mcap", "--format", "tum", "-o", "out.tum").code == 0
    assert call("export", tmp_path / "log.mcap", "--format", "csv", "-o", "out.csv").code == 0
    stamps = ["1248444187.156000000", "1248444187.156000001", "1248444187.156000002"]
    assert [line.split(" ")[0] for line in (here / "out.tum").read_text().splitlines()] == stamps
    assert [line.split(",")[0] for line in (here / "out.csv").read_text().splitlines()[1:]] == stamps


def test_evaluate_agrees_with_evo_on_what_export_wrote(call: Call, tmp_path: Path, here: Path) -> None:
    metrics_of = pytest.importorskip("evo.core.metrics")
    sync = pytest.importorskip("evo.core.sync")
    trajectory = pytest.importorskip("evo.core.trajectory")
    log = write(tmp_path / "minute.mcap", sample_messages(100.0), nearer_than(3.0))
    assert call("run", log, "-o", "mixture.mcap").code == 0
    assert call("export", "mixture.mcap", "--format", "tum").code == 0
    assert call("export", log, "--format", "tum", "--truth", "-o", "truth.tum").code == 0
    ours = json.loads(call("evaluate", "mixture.mcap", "--truth", log, "--json").out)

    def read(path: Path) -> object:
        table = np.loadtxt(path)
        return trajectory.PoseTrajectory3D(table[:, 1:4], table[:, [7, 4, 5, 6]], table[:, 0])

    pair = sync.associate_trajectories(read(here / "truth.tum"), read(here / "mixture.tum"))
    assert ours["matched_poses"] == pair[0].num_poses > 900

    def evo(kind: str, relation: str, *delta: object) -> dict[str, float]:
        metric = getattr(metrics_of, kind)(metrics_of.PoseRelation[relation], *delta)
        metric.process_data(pair)
        return metric.get_all_statistics()  # type: ignore[no-any-return]

    place, turn = evo("APE", "translation_part"), evo("APE", "rotation_angle_rad")
    for name in ("rmse", "median", "mean", "max"):
        assert ours[f"ate_{name}_m"] == pytest.approx(place[name], abs=1e-6)
        assert ours[f"heading_{name}_rad"] == pytest.approx(turn[name], abs=1e-6)
    for key, delta in (("frame", (1, metrics_of.Unit.frames)), ("metre", (1, metrics_of.Unit.meters))):
        assert ours[f"rpe_{key}_pairs"] > 2
        place, turn = evo("RPE", "translation_part", *delta), evo("RPE", "rotation_angle_rad", *delta)
        assert ours[f"rpe_{key}_translation_rmse_m"] == pytest.approx(place["rmse"], abs=1e-6)
        assert ours[f"rpe_{key}_rotation_rmse_rad"] == pytest.approx(turn["rmse"], abs=1e-6)


# -- interrupted -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize(
    ("pattern", "moment"),
    [
        ("run {good} -o out.mcap", "estimators.mixture.MixtureFilter.observe"),
        ("run {good} -o out.mcap", "logs.writer.LogWriter.write_raw"),
        ("smooth {good} -o out.mcap", "estimators.smoother.Smoother.trajectory"),
        ("compare {good} --estimators ekf -o out", "logs.report.page.page"),
        ("compare {good} --estimators ekf -o out", "logs.report._png"),
        ("export {mixture} --format tum -o out.tum", "logs.export.exact_seconds"),
    ],
)
def test_an_interrupt_at_any_moment_leaves_no_file(
    call: Call,
    made: Path,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    code: int,
    pattern: str,
    moment: str,
) -> None:
    module, _, name = moment.rpartition(".")
    try:
        owner: object = importlib.import_module(module)
    except ModuleNotFoundError:
        home, _, kind = module.rpartition(".")
        owner = getattr(importlib.import_module(home), kind)
    original = getattr(owner, name)
    calls = 0

    def interrupted(*arguments: object, **options: object) -> object:
        nonlocal calls
        calls += 1
        if calls == (1 if name in ("trajectory", "page", "_png") else 50):
            os.kill(os.getpid(), number)
        return original(*arguments, **options)

    monkeypatch.setattr(owner, name, interrupted)
    if name == "page":
        monkeypatch.setattr("logs.report.page", interrupted)
    before = signal.getsignal(signal.SIGTERM)
    hears = signal.signal(signal.SIGINT, signal.default_int_handler)  # not so when the tests run in the background
    try:
        said = call(*filled(pattern, made))
    finally:
        signal.signal(signal.SIGINT, hears)
    assert said == Said(code, "", "fieldloc: interrupted; nothing unfinished was left behind\n")
    assert listing(here) == []
    assert signal.getsignal(signal.SIGTERM) is before


# -- as a program ------------------------------------------------------------------------------------------------------


def environment() -> dict[str, str]:
    """Output is buffered, whatever this process does."""
    return {**{key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}, "PYTHONPATH": str(ROOT)}


def start(arguments: Sequence[object], here: Path, **options: object) -> "subprocess.Popen[str]":
    command = [
        sys.executable,
        "-c",
        "import sys; from fieldloc.cli import main; sys.exit(main())",
        *map(str, arguments),
    ]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment(), **options}
    streams["preexec_fn"] = interruptible
    return subprocess.Popen(command, cwd=here, text=True, **streams)  # type: ignore[call-overload,no-any-return]


def run(*arguments: object, here: Path, **options: object) -> Said:
    process = start(arguments, here, **options)
    out, err = process.communicate(timeout=120)
    return Said(process.returncode, out or "", err or "")


def test_exit_codes_are_those_of_the_program_and_no_traceback_is_shown(made: Path, here: Path) -> None:
    assert run("info", made / "good.mcap", here=here).code == 0
    said = run("run", made / "text.mcap", here=here)
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert run(here=here).lines == ["fieldloc: the following arguments are required: COMMAND; see fieldloc --help"]


def test_a_reader_that_has_seen_enough_is_no_error_to_talk_about(made: Path, here: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)  # as `| head -1` does, only sooner
    said = run("info", made / "good.mcap", here=here, stdout=writing)
    os.close(writing)
    assert (said.code, said.err) == (1, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_output_that_cannot_be_written_is_one_line(made: Path, here: Path) -> None:
    with open("/dev/full", "w") as full:
        said = run("info", made / "good.mcap", here=here, stdout=full)
    assert (said.code, said.err) == (1, "fieldloc: output: No space left on device\n")


def test_names_that_are_no_text_or_that_a_terminal_cannot_show_are_no_error(made: Path, here: Path) -> None:
    odd = here / os.fsdecode(b"r\xc3\xbcbe\xff.mcap")
    odd.write_bytes((made / "good.mcap").read_bytes())
    for encoding in ("ascii", "utf-8"):
        said = run("info", odd, here=here, env={**environment(), "PYTHONIOENCODING": encoding})
        assert (said.code, said.err) == (0, "")
        assert "/odometry" in said.out
    assert main(["run", str(odd), "-o", str(here / "out.mcap")]) == 0
    assert LogFile(here / "out.mcap").metadata["fieldloc"]["log"] == "rübe\ufffd.mcap"
    assert main(["compare", str(odd), "--estimators", "ekf", "-o", str(here / "out")]) == 0


def test_help_comes_at_once_because_nothing_heavy_is_imported(here: Path) -> None:
    code = "import sys, fieldloc.cli\ntry: fieldloc.cli.main(['--help'])\nexcept SystemExit: print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=here, env=environment(), capture_output=True, text=True, check=True
    )
    modules = set(done.stdout.splitlines()[-1].split())
    assert "fieldloc.cli" in modules
    heavy = ("gtsam", "filterpy", "matplotlib", "scipy", "scipy.stats", "PIL")
    assert [module for module in heavy if module in modules] == []


def test_numbers_beyond_all_reason_are_no_traceback_and_no_page_of_warnings(tmp_path: Path, here: Path) -> None:
    def absurd(record: Record) -> Record:
        match record:
            case Odometry() if record.stamp_ns % 10**9 == 0:
                return replace(record, velocity=record.velocity + 1e300)
            case LandmarkScan() if record.stamp_ns % 10**9 == 0:
                return replace(record, range_bearing=record.range_bearing + 1e300)
        return record

    log = write(tmp_path / "absurd.mcap", sample_messages(5.0), absurd)
    for command in ("run", "smooth"):
        said = run(command, log, "-o", f"{command}.mcap", here=here)
        assert all(line.startswith("fieldloc: ") for line in said.lines), said.err
        assert len(said.lines) <= 2
        assert (here / f"{command}.mcap").exists() == (said.code == 0)


def read_terminal(terminal: int, until: str = "") -> str:
    """What a program shows on the terminal until this or its end."""
    text = ""
    while not (until and until in text):
        try:
            shown = os.read(terminal, 4096)
        except OSError:  # its end
            return text
        if not shown:
            return text
        text += shown.decode(errors="replace")
    return text


def test_a_person_sees_progress_and_can_interrupt_it(here: Path) -> None:
    ours, theirs = pty.openpty()
    process = start(["run", sample_path("woods"), "-o", "out.mcap"], here, stderr=theirs)
    os.close(theirs)
    shown = read_terminal(ours, until="%")
    assert re.search(r"mixture( reading)? +\d+ %", shown)
    process.send_signal(signal.SIGINT)
    shown = read_terminal(ours)
    os.close(ours)
    out, _ = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert "fieldloc: interrupted; nothing unfinished was left behind" in shown
    assert "Traceback" not in shown
    assert listing(here) == []


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_for_those_who_see_it_and_want_it(call: Call, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logs.progress._PATIENCE_S", 1e-4)
    assert call("run", made / "good.mcap", "-o", "out.mcap").err == ""  # what catches it is no terminal
    monkeypatch.setattr(sys, "stderr", Terminal())
    call("run", made / "good.mcap", "-o", "out.mcap", "--quiet")
    assert sys.stderr.getvalue() == ""
    call("run", made / "good.mcap", "-o", "out.mcap")
    assert re.search(r"\rmixture +\d+ % ", sys.stderr.getvalue())
