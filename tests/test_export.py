import csv
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldloc.errors import FieldlocError
from fieldloc.pose import wrap
from logs.atomic import atomic_directory, atomic_text
from logs.evaluate import evaluate
from logs.export import CSV_COLUMNS, exact_seconds, write_csv, write_tum
from logs.trajectory import Trajectory

START_NS = 1248444187_156_000_000


def walk(n: int, step_m: float = 0.04, period_ns: int = 100_000_000, offset_ns: int = 0, seed: int = 0) -> Trajectory:
    """A curved walk with noise of its own on top: the same path for every seed, seen 1-3 cm and 1 deg off."""
    t = (np.arange(n) * period_ns + offset_ns) / 1e9
    heading = np.sin(0.05 * t) * 2.5 + 0.02 * t
    x, y = np.cumsum(step_m * np.cos(heading)), np.cumsum(step_m * np.sin(heading))
    rng = np.random.default_rng(seed)
    poses = np.column_stack([x, y, heading]) + rng.normal(0, [0.02, 0.02, 0.02], (n, 3))
    poses[:, 2] = wrap(poses[:, 2])
    roots = rng.normal(0, 0.02, (n, 3, 3))
    stamps_ns = START_NS + offset_ns + period_ns * np.arange(n, dtype=np.int64)
    return Trajectory(stamps_ns, poses, roots @ np.swapaxes(roots, 1, 2) + 1e-6 * np.eye(3))


# -- text --------------------------------------------------------------------------------------------------------------


def test_a_stamp_is_written_to_the_nanosecond() -> None:
    assert exact_seconds(1248444187_156_000_000) == "1248444187.156000000"
    assert exact_seconds(1) == "0.000000001"
    assert exact_seconds(-1_500_000_000) == "-1.500000000"


@given(st.integers(-(2**63), 2**63 - 1))
def test_written_seconds_are_exactly_the_stamp(stamp_ns: int) -> None:
    assert Decimal(exact_seconds(stamp_ns)) * 10**9 == stamp_ns


def test_tum_lines_read_back_to_the_same_doubles(tmp_path: Path) -> None:
    trajectory = walk(200)
    write_tum(tmp_path / "a.tum", trajectory)
    lines = (tmp_path / "a.tum").read_text().splitlines()
    assert lines[1].split()[0] == "1248444187.256000000"
    table = np.array([[float(word) for word in row.split(" ")] for row in lines])
    assert table.shape == (200, 8)
    np.testing.assert_array_equal(table[:, 1:3], trajectory.poses[:, :2])
    np.testing.assert_array_equal(table[:, 3:6], 0.0)
    np.testing.assert_allclose(2 * np.arctan2(table[:, 6], table[:, 7]), trajectory.poses[:, 2], rtol=0, atol=1e-15)


def test_csv_reads_back_to_the_same_doubles(tmp_path: Path) -> None:
    trajectory = walk(50)
    write_csv(tmp_path / "a.csv", trajectory)
    with (tmp_path / "a.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    assert tuple(header) == CSV_COLUMNS
    assert [int(row[1]) for row in rows] == trajectory.stamps_ns.tolist()
    assert [Decimal(row[0]) * 10**9 for row in rows] == trajectory.stamps_ns.tolist()
    numbers = np.array([[float(cell) for cell in row[2:]] for row in rows])
    assert trajectory.covariances is not None
    xx, xy, xh, yy, yh, hh = numbers[:, 3:].T
    np.testing.assert_array_equal(numbers[:, :3], trajectory.poses)
    rebuilt = np.stack([np.stack(r, axis=1) for r in ((xx, xy, xh), (xy, yy, yh), (xh, yh, hh))], axis=1)
    np.testing.assert_allclose(rebuilt, trajectory.covariances, rtol=1e-12, atol=1e-18)


def test_csv_without_covariances_leaves_their_cells_empty(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", Trajectory(np.array([1, 2]), np.zeros((2, 3))))
    assert (tmp_path / "a.csv").read_text().splitlines()[1] == "0.000000001,1,0.0,0.0,0.0,,,,,,"


@pytest.mark.parametrize("write", [write_tum, write_csv])
def test_an_empty_trajectory_is_refused_and_leaves_no_file(write: object, tmp_path: Path) -> None:
    assert callable(write)
    with pytest.raises(FieldlocError, match="no estimates"):
        write(tmp_path / "a", Trajectory(np.array([], dtype=np.int64), np.zeros((0, 3))))
    assert list(tmp_path.iterdir()) == []


# -- nothing half-written ----------------------------------------------------------------------------------------------


def test_an_interrupted_write_keeps_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "out.tum"
    path.write_text("old")

    def interrupted() -> None:
        with atomic_text(path) as file:
            file.write("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_directory_never_appears(tmp_path: Path) -> None:
    def interrupted() -> None:
        with atomic_directory(tmp_path / "deep" / "out") as directory:
            (directory / "half").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list((tmp_path / "deep").iterdir()) == []


def test_a_directory_that_exists_keeps_what_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "report").write_text("old")
    with atomic_directory(tmp_path) as directory:
        (directory / "report").write_text("new")
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"mine": "mine", "report": "new"}


def test_a_place_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FieldlocError, match=r"cannot write .*a\.tum"):
        write_tum(tmp_path / "no" / "a.tum", walk(3))
    with pytest.raises(FieldlocError, match="cannot write to"), atomic_directory(tmp_path / "file" / "out"):
        pass


# -- evo, through the exported text ------------------------------------------------------------------------------------


def straight(n: int) -> Trajectory:
    """Steps of 0.1 m: whether ten of them are a metre is decided by rounding."""
    poses = np.column_stack([0.1 * np.arange(n), np.zeros(n), np.zeros(n)])
    return Trajectory(START_NS + 100_000_000 * np.arange(n, dtype=np.int64), poses)


CASES = {
    "same stamps": (walk(2000, seed=1), walk(2000, seed=2)),
    "dense truth, estimate between its poses": (
        walk(500, seed=1, offset_ns=5_000_000),
        walk(5000, 0.004, period_ns=10_000_000),
    ),
    "dense estimate with a late start": (
        walk(5000, 0.004, period_ns=10_000_000, seed=1).select(slice(700, None)),
        walk(480, seed=2, offset_ns=3_000_000),
    ),
    "on the limit of 10 ms": (
        walk(500, seed=1, period_ns=33_333_333, offset_ns=10_000_000),
        walk(600, period_ns=33_333_333),
    ),
    "steps that divide a metre": (straight(300), walk(300)),
}


@pytest.mark.parametrize("case", CASES)
def test_metrics_agree_with_evo_on_the_exported_text(case: str, tmp_path: Path) -> None:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    sync = pytest.importorskip("evo.core.sync")
    evo_trajectory = pytest.importorskip("evo.core.trajectory")

    def read(path: Path) -> object:
        table = np.array([[float(word) for word in row.split(" ")] for row in path.read_text().splitlines()])
        return evo_trajectory.PoseTrajectory3D(table[:, 1:4], np.roll(table[:, 4:], 1, axis=1), table[:, 0])

    estimate, truth = CASES[case]
    write_tum(tmp_path / "estimate.tum", estimate)
    write_tum(tmp_path / "truth.tum", truth)
    pair = sync.associate_trajectories(read(tmp_path / "truth.tum"), read(tmp_path / "estimate.tum"))
    ours = evaluate(estimate, truth)
    assert ours.matched == pair[0].num_poses

    relation, unit = evo_metrics.PoseRelation, evo_metrics.Unit

    def statistics(metric: object) -> dict[str, float]:
        metric.process_data(pair)  # type: ignore[attr-defined]
        return metric.get_all_statistics()  # type: ignore[attr-defined,no-any-return]

    for mine, relation_of_mine in (
        (ours.ate_m, relation.translation_part),
        (ours.heading_rad, relation.rotation_angle_rad),
    ):
        theirs = statistics(evo_metrics.APE(relation_of_mine))
        for name in ("rmse", "median", "mean", "max"):
            assert getattr(mine, name) == pytest.approx(theirs[name], abs=1e-9), (relation_of_mine, name)
    for rpe, kind in ((ours.rpe_frame, unit.frames), (ours.rpe_metre, unit.meters)):
        assert rpe is not None
        translation = statistics(evo_metrics.RPE(relation.translation_part, 1, kind))
        rotation = statistics(evo_metrics.RPE(relation.rotation_angle_rad, 1, kind))
        assert rpe.translation_rmse_m == pytest.approx(translation["rmse"], abs=1e-9)
        assert rpe.rotation_rmse_rad == pytest.approx(rotation["rmse"], abs=1e-9)


def test_the_limit_case_is_one_where_rounding_decides() -> None:
    matched = evaluate(*CASES["on the limit of 10 ms"]).matched
    assert 0 < matched < 500
