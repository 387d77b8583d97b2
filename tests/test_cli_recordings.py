"""simulate, info, cut, merge, repair, view and report as a person types them."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from children import interruptible
from program import Call
from real_logs import sample_messages, write

from estimators.base import Estimate
from fieldloc.cli import main
from fieldloc.measurements import Odometry, Truth
from logs.reader import LogFile
from logs.samples import sample_path

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds of the sample."""
    return write(tmp_path_factory.mktemp("log") / "ten.mcap", sample_messages(10.0))


@pytest.fixture(scope="module")
def game(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("game") / "game.mcap"
    assert main(["simulate", "--scenario", "quiet", "--seed", "5", "--duration-s", "4", "-o", str(out), "--quiet"]) == 0
    return out


def counts(path: Path) -> dict[str, int]:
    return {source.topic: count for source, count in LogFile(path).sources}


# -- simulate ----------------------------------------------------------------------------------------------------------


def test_the_same_seed_is_the_same_file_and_another_is_not(call: Call, game: Path, here: Path) -> None:
    for seed in ("5", "6"):
        assert call("simulate", "--scenario", "quiet", "--seed", seed, "--duration-s", 4).code == 0
    assert (here / "quiet-5.mcap").read_bytes() == game.read_bytes()
    assert (here / "quiet-6.mcap").read_bytes() != game.read_bytes()


def test_a_simulated_game_is_localized_like_any_log(call: Call, game: Path, here: Path) -> None:
    said = call("run", game, "-o", "out.mcap")
    assert (said.code, said.err) == (0, "")
    measured = json.loads(call("evaluate", "out.mcap", "--truth", game, "--json").out)
    assert measured["ate_rmse_m"] < 0.1  # told to 5 cm where it starts


def test_the_scenarios_have_names(call: Call) -> None:
    names = [line.split()[0] for line in call("simulate", "--list").out.splitlines()]
    assert {"kidsize-game", "spl-game", "quiet", "ideal"} <= set(names)
    for name in names:
        assert call("simulate", "--scenario", name, "--duration-s", "0.5", "-o", f"{name}.mcap").code == 0


@pytest.mark.parametrize(
    ("typed", "named"),
    [
        ("--scenario mars", "mars: no such scenario; give one of kidsize-game"),
        ("--seed -1", "argument --seed: '-1' is not a whole number, 0 or more"),
        ("--seed x", "argument --seed: 'x'"),
        ("--duration-s 0", "argument --duration-s: '0' is not a number above 0"),
        ("--set odometry.colour=1", "--set odometry.colour=1: odometry.colour: unknown key"),
        ("--set field='moon'", "moon"),
        ("--observations", "--observations: what a detector finds is always there without --images"),
        ("--images --image-size 320", "'320' is not WIDTHxHEIGHT in pixels"),
        ("--images --quality 101", "'101' is not a whole number from 1 to 100"),
    ],
)
def test_a_game_that_cannot_be_is_one_line(call: Call, here: Path, typed: str, named: str) -> None:
    said = call("simulate", *typed.split())
    assert (said.code, said.out, len(said.lines)) == (1, "", 1)
    assert named in said.err
    assert list(here.iterdir()) == []


# -- info --------------------------------------------------------------------------------------------------------------


def test_info_for_programs_counts_what_is_there(call: Call, log: Path) -> None:
    told = json.loads(call("info", log, "--json").out)
    held = counts(log)
    assert {row["topic"]: row["messages"] for row in told["topics"]} == held
    assert told["messages"] == sum(held.values())
    assert {row["topic"]: row["role"] for row in told["topics"]}["/odometry"] == "odometry"
    assert told["warnings"] == []
    assert told["duration_s"] == pytest.approx(10.0, abs=0.2)


def test_info_reads_several_files_as_one(call: Call, log: Path, here: Path) -> None:
    call("cut", log, "--to", 4, "-o", "a.mcap")
    call("cut", log, "--from", 4, "-o", "b.mcap")
    both = json.loads(call("info", "b.mcap", "a.mcap", "--json").out)
    alone = json.loads(call("info", log, "--json").out)
    rows = {row["topic"]: row["messages"] for row in both["topics"]}
    expected = {row["topic"]: row["messages"] for row in alone["topics"]}
    assert rows == expected | {"/field": 2}  # the second part has it too, or nobody could use it alone


# -- cut, merge, repair ------------------------------------------------------------------------------------------------


def test_parts_make_the_whole_again(call: Call, log: Path, here: Path) -> None:
    assert call("cut", log, "--to", 4, "-o", "a.mcap").code == 0
    said = call("cut", log, "--from", 4, "-o", "b.mcap")
    assert "carried over from before the start: /field" in said.out
    assert call("merge", "b.mcap", "a.mcap", "-o", "whole.mcap").code == 0
    assert list(LogFile(here / "whole.mcap").records(Odometry)) != []
    for kind in (Odometry, Truth):
        stamps = [[record.stamp_ns for record in LogFile(path).records(kind)] for path in (log, here / "whole.mcap")]
        assert stamps[0] == stamps[1]


def test_topics_are_chosen_by_name_and_by_pattern(call: Call, log: Path, here: Path) -> None:
    assert call("cut", log, "--topics", "/odo*,/truth", "-o", "few.mcap").code == 0
    assert set(counts(here / "few.mcap")) == {"/odometry", "/truth"}
    assert call("cut", log, "--without", "/truth", "-o", "blind.mcap").code == 0
    assert set(counts(here / "blind.mcap")) == set(counts(log)) - {"/truth"}


def test_logs_of_two_robots_stay_apart(call: Call, log: Path, game: Path, here: Path) -> None:
    assert call("merge", log, game, "--prefixes", "robot1,robot2", "-o", "both.mcap").code == 0
    held = counts(here / "both.mcap")
    assert held["/robot1/odometry"] == counts(log)["/odometry"]
    assert held["/robot2/odometry"] == counts(game)["/odometry"]


def test_a_broken_log_is_made_whole_and_what_is_lost_is_said(call: Call, here: Path) -> None:
    data = sample_path("woods").read_bytes()
    (here / "broken.mcap").write_bytes(data[: len(data) // 2])
    said = call("repair", "broken.mcap")
    assert said.code == 0
    assert len(said.lines) == 1
    assert "cut off" in said.err
    again = call("info", "broken-repaired.mcap")
    assert (again.code, again.err) == (0, "")
    assert 1000 < sum(counts(here / "broken-repaired.mcap").values()) < sum(counts(sample_path("woods")).values())


def test_a_whole_log_needs_no_repair(call: Call, log: Path, here: Path) -> None:
    said = call("repair", log, "-o", "same.mcap")
    assert (said.code, said.err) == (0, "")
    assert "nothing was broken" in said.out
    assert counts(here / "same.mcap") == counts(log)


@pytest.mark.parametrize(
    ("typed", "named"),
    [
        ("cut {log}", "nothing to cut; say which part with --from, --to, --topics or --without"),
        ("cut {log} --from 5 --to 4 -o x.mcap", "--to"),
        ("cut {log} --from 99 -o x.mcap", "no messages"),
        ("cut {log} --from -1 -o x.mcap", "--from: '-1' is not a number of seconds"),
        ("cut {log} --topics /nothing -o x.mcap", "/nothing"),
        ("cut {log} --to 4 -o {log}", "is what is read; give another file with -o"),
        ("merge {log} -o {log}", "is what is read; give another file with -o"),
        ("merge {log} {log} -o x.mcap", "twice"),
        ("merge {log} nothing.mcap -o x.mcap", "nothing.mcap: no such file"),
        ("merge {log} --prefixes a,b -o x.mcap", "prefixes"),
        ("repair nothing.mcap", "nothing.mcap: no such file"),
        ("run {log} --from 9 --to 3", "--to 3: needs to be more than --from 9"),
        ("run {log} --role odometry", "--role odometry: needs ROLE=TOPIC"),
        ("run {log} --role odometry=/none", "/none"),
        ("run {log} --mapping none.toml", "none.toml: no such mapping file"),
        ("report {log}", "no usable message on /estimate"),
        ("view nothing.mcap", "nothing.mcap: no such file"),
        ("view {log} --port 99999", "--port: '99999' is not a port"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing_behind(
    call: Call, log: Path, here: Path, typed: str, named: str
) -> None:
    before = log.read_bytes()
    said = call(*typed.format(log=log).split())
    assert (said.code, said.out, len(said.lines)) == (1, "", 1), said
    assert named in said.err
    assert list(here.iterdir()) == []
    assert log.read_bytes() == before


# -- run with parts and roles ------------------------------------------------------------------------------------------


def test_a_part_of_a_log_is_localized_with_the_map_from_before_it(call: Call, log: Path, here: Path) -> None:
    assert call("run", log, "--from", 4, "--to", 8, "-o", "part.mcap").code == 0
    stamps = [estimate.stamp_ns * 1e-9 for estimate in LogFile(here / "part.mcap").records(Estimate)]
    first = next(LogFile(log).records(Odometry)).stamp_ns * 1e-9
    assert first + 4.0 <= stamps[0] < first + 4.5
    assert first + 7.5 < stamps[-1] <= first + 8.0


def test_a_role_is_played_by_the_topic_that_is_told(call: Call, log: Path, here: Path) -> None:
    renamed = [
        message
        if not isinstance(message.record, Odometry)
        else type(message)("/wheels", message.log_time_ns, message.record)
        for message in sample_messages(10.0)
    ]
    write(here / "renamed.mcap", renamed)
    assert call("run", "renamed.mcap", "--role", "odometry=/wheels", "-o", "told.mcap").code == 0
    assert call("run", log, "-o", "usual.mcap").code == 0
    told, usual = (list(LogFile(here / name).records(Estimate)) for name in ("told.mcap", "usual.mcap"))
    assert [one.pose.tolist() for one in told] == [one.pose.tolist() for one in usual]


def test_a_merged_result_holds_the_log_and_can_be_reported_alone(call: Call, log: Path, here: Path) -> None:
    assert call("run", log, "--merge", "--ros2", "-o", "all.mcap").code == 0
    held = counts(here / "all.mcap")
    for topic, count in counts(log).items():
        assert held[topic] == count
    assert held["/estimate"] == held["/fieldloc/pose"] == held["/fieldloc/pose_with_covariance"] > 0
    said = call("report", "all.mcap", "-o", "report")
    assert said.code == 0
    assert "mixture" in said.out
    assert (here / "report" / "report.html").exists()
    alone = json.loads((here / "report" / "metrics.json").read_text())
    call("compare", log, "--estimators", "mixture", "-o", "compared")
    compared = json.loads((here / "compared" / "metrics.json").read_text())
    one, other = (document["logs"][0]["estimators"]["mixture"] for document in (alone, compared))
    assert one["ate_rmse_m"] == other["ate_rmse_m"]


def test_a_report_takes_the_truth_from_the_log(call: Call, log: Path, here: Path) -> None:
    assert call("run", log, "-o", "mixture.mcap").code == 0
    assert call("report", "mixture.mcap", "--truth", log, "-o", "report").code == 0
    assert "ate_rmse_m" in (here / "report" / "metrics.json").read_text()


# -- view --------------------------------------------------------------------------------------------------------------


def test_a_log_becomes_a_page_with_what_an_estimator_makes_of_it(call: Call, log: Path, here: Path) -> None:
    said = call("view", log, "--estimator", "ekf", "--html", "page.html")
    assert (said.code, said.out.strip()) == (0, "page: page.html")
    page = (here / "page.html").read_text()
    assert "ekf" in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_a_log_is_served_until_it_is_interrupted(log: Path, here: Path) -> None:
    command = [sys.executable, "-m", "fieldloc", "view", str(log), "--estimator", "ekf", "--port", "0"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, preexec_fn=interruptible, **pipes)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("serving ws://127.0.0.1:")
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, err) == (0, "")
    assert out.splitlines()[-1] == "closed"


def test_no_command_changes_its_input(call: Call, here: Path) -> None:
    shutil.copy(sample_path("woods"), here / "woods.mcap")
    (here / "woods.mcap").chmod(0o444)
    before = (here / "woods.mcap").stat()
    assert call("cut", "woods.mcap", "--to", 3, "-o", "out/three.mcap").code == 0
    after = (here / "woods.mcap").stat()
    assert (before.st_mtime_ns, before.st_size) == (after.st_mtime_ns, after.st_size)
