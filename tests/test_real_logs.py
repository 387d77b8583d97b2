"""From a data set's files to the numbers of an evaluation, through the command line, with the shipped settings."""

import json
import re
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from real_logs import nearer_than, sample_messages, write

from fieldloc.cli import main

DATA = Path(__file__).parents[2] / "shared" / "data"
MRCLAM = DATA / "mrclam" / "MRCLAM_Dataset6.tar.gz"
WOODS = DATA / "woods" / "dataset2.mat"
needs_mrclam = pytest.mark.skipif(not MRCLAM.is_file(), reason=f"{MRCLAM} is missing: UTIAS data set 6")
needs_woods = pytest.mark.skipif(not WOODS.is_file(), reason=f"{WOODS} is missing: the 'lost in the woods' data set")

Evaluated = dict[str, float]
Evaluate = Callable[[Path, str], Evaluated]


@pytest.fixture
def evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Evaluate:
    """The metrics of an estimator on a log."""

    def evaluate(log: Path, estimator: str) -> Evaluated:
        out = tmp_path / f"{log.stem}-{estimator}.mcap"
        how = ["smooth"] if estimator == "smooth" else ["run", "--estimator", estimator]
        assert main([*how, str(log), "-o", str(out), "--quiet"]) == 0
        capsys.readouterr()
        assert main(["evaluate", str(out), "--truth", str(log), "--json"]) == 0
        metrics: dict[str, Any] = json.loads(capsys.readouterr().out)
        return {key: value for key, value in metrics.items() if isinstance(value, float | int)}

    return evaluate


# -- lost in the woods -------------------------------------------------------------------------------------------------


def test_two_minutes_in_the_woods(tmp_path: Path) -> None:
    """The sample's first, cut as `import woods --max-range-m 3` cuts them."""
    log = write(tmp_path / "woods.mcap", sample_messages(120.0), nearer_than(3.0))
    assert main(["compare", str(log), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    runs = json.loads((tmp_path / "out" / "metrics.json").read_text())["logs"][0]["estimators"]
    for name, ate_m, heading_deg in (("smooth", 0.04, 1.5), ("ekf", 0.08, 2.0), ("particles", 0.08, 2.0)):
        run = runs[name]
        assert run["matched_poses"] == run["true_poses"] > 1000, name
        assert run["ate_rmse_m"] <= ate_m, name
        assert run["heading_rmse_deg"] <= heading_deg, name
        assert run["ate_max_m"] < 0.3, name
        assert run["ate_rmse_m"] < 0.3 * runs["dead-reckoning"]["ate_rmse_m"], name


@needs_woods
@pytest.mark.slow
def test_the_woods_from_its_file_to_the_numbers(tmp_path: Path, evaluated: Evaluate) -> None:
    log = tmp_path / "woods.mcap"
    assert main(["import", "woods", str(WOODS), "-o", str(log), "--max-range-m", "3", "--quiet"]) == 0
    smoothed, filtered = evaluated(log, "smooth"), evaluated(log, "ekf")
    assert smoothed["truth_covered"] == filtered["truth_covered"] == 1.0
    assert smoothed["ate_rmse_m"] <= 0.04
    assert smoothed["heading_rmse_deg"] <= 1.5
    assert filtered["ate_rmse_m"] <= 0.08


# -- MRCLAM 6: three of its robots, starts unknown ---------------------------------------------------------------------

_ROBOTS = (1, 3, 5)


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    logs = [tmp_path_factory.mktemp("mrclam") / f"robot{robot}.mcap" for robot in _ROBOTS]
    for robot, log in zip(_ROBOTS, logs, strict=True):
        assert main(["import", "utias", str(MRCLAM), "--robot", str(robot), "-o", str(log), "--quiet"]) == 0
    return logs


@needs_mrclam
@pytest.mark.slow
@pytest.mark.parametrize(("name", "mean_m"), [("smooth", 0.13), ("ekf", 0.25), ("mixture", 0.25)])
def test_no_robot_of_mrclam_6_gets_lost(tmp_path: Path, robots: list[Path], name: str, mean_m: float) -> None:
    assert main(["compare", *map(str, robots), "--estimators", name, "-o", str(tmp_path / "out"), "--quiet"]) == 0
    document = json.loads((tmp_path / "out" / "metrics.json").read_text())
    results = [log["estimators"][name] for log in document["logs"]]
    assert sum(metrics["ate_rmse_m"] for metrics in results) / len(robots) <= mean_m
    assert max(metrics["ate_max_m"] for metrics in results) < 1.5
    assert min(metrics["truth_covered"] for metrics in results) > 0.9


@needs_mrclam
def test_a_robot_of_mrclam_6_keeps_the_stamps_of_its_files(tmp_path: Path) -> None:
    """On the first lines of each of its files."""
    with tarfile.open(MRCLAM) as archive:
        for member in archive:
            name = Path(member.name).name
            if re.match(r"(Barcodes|Landmark_Groundtruth|Robot1_\w+)\.dat$", name):
                text = archive.extractfile(member)
                assert text is not None
                (tmp_path / name).write_bytes(b"".join(text.readlines()[:300]))
    log, out = tmp_path / "robot1.mcap", tmp_path / "out.mcap"
    assert main(["import", "utias", str(tmp_path), "--robot", "1", "-o", str(log)]) == 0
    assert main(["run", str(log), "--estimator", "dead-reckoning", "--start", "1.41,-3.89,130", "-o", str(out)]) == 0
    assert main(["export", str(log), "--format", "tum", "--truth"]) == 0
    assert main(["export", str(out), "--format", "csv"]) == 0
    for file, exported in (("Groundtruth", "robot1.tum"), ("Odometry", "out.csv")):
        lines = (tmp_path / f"Robot1_{file}.dat").read_text().splitlines()
        stamps = [line.split()[0] for line in lines if not line.startswith("#")]
        assert stamps[0] in ("1248444175.103", "1248444187.156")
        written = {re.split("[ ,]", line)[0] for line in (tmp_path / exported).read_text().splitlines()}
        assert {f"{stamp}000000" for stamp in stamps} <= written
