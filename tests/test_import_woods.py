from pathlib import Path

import log_records
import numpy as np
import pytest
import scipy.io

from fieldloc import pose
from fieldloc.errors import FieldlocError
from fieldloc.measurements import LandmarkScan, Odometry, Truth
from logs.importers import import_woods
from logs.importers.woods import LEFT_SIGMA_MPS
from logs.reader import LogFile
from logs.samples import sample_path

MAT = Path(__file__).parents[2] / "shared" / "data" / "woods" / "dataset2.mat"
needs_mat = pytest.mark.skipif(not MAT.is_file(), reason=f"{MAT} is missing: the data set the sample was made from")


def small():
    """Three steps, two tubes; the first is seen in steps 0 and 1, the second in steps 1 and 2."""
    column = np.arange(3.0)[:, None]
    return {
        "t": 0.1 * column,
        "x_true": column,
        "y_true": -column,
        "th_true": 0.5 * column,
        "true_valid": np.array([[1], [0], [1]], dtype=np.uint8),
        "l": np.array([[1.0, 2.0], [3.0, 4.0]]),
        "r": np.array([[2.5, 0.0], [2.6, 3.5], [0.0, 3.6]]),
        "b": np.array([[0.1, 0.0], [0.2, -0.3], [0.0, -0.4]]),
        "v": 0.3 + column,
        "om": 0.1 * column,
        "d": np.array([[0.25]]),
        "r_var": np.array([[1e-3]]),
        "b_var": np.array([[2e-3]]),
        "v_var": np.array([[3e-3]]),
        "om_var": np.array([[4e-3]]),
    }


def imported(tmp_path, data, **options):
    scipy.io.savemat(tmp_path / "data.mat", data)
    return import_woods(tmp_path / "data.mat", tmp_path / "log.mcap", **options)


def test_every_number_of_the_file_is_in_the_log(tmp_path):
    result = imported(tmp_path, small())
    assert dict(result.counts) == {"/field": 1, "/odometry": 3, "/landmarks": 3, "/truth": 2}
    assert result.warnings == ()
    log = LogFile(result.path)
    data = small()
    odometry = list(log.records(Odometry))
    assert [o.stamp_ns for o in odometry] == [0, 100_000_000, 200_000_000]
    assert np.array_equal([o.velocity for o in odometry], np.hstack([data["v"], 0.0 * data["v"], data["om"]]))
    assert all(np.array_equal(o.covariance, np.diag([3e-3, LEFT_SIGMA_MPS**2, 4e-3])) for o in odometry)
    scans = list(log.records(LandmarkScan))
    assert [s.labels for s in scans] == [("1",), ("1", "2"), ("2",)]
    assert np.array_equal(scans[1].range_bearing, [[2.6, 0.2], [3.5, -0.3]])
    assert np.array_equal(scans[1].covariance, [np.diag([1e-3, 2e-3])] * 2)
    assert np.array_equal(scans[1].robot_from_sensor, [0.25, 0.0, 0.0])
    truth = list(log.records(Truth))
    assert [t.stamp_ns for t in truth] == [0, 200_000_000]
    assert np.array_equal(truth[1].pose, [2.0, -2.0, 1.0])
    field = log.field_map()
    assert field.labels == ("1", "2")
    assert np.array_equal(field.positions, data["l"])


def test_identities_can_be_dropped_and_far_landmarks_cut_off(tmp_path):
    log = LogFile(imported(tmp_path, small(), anonymous=True, max_range_m=3.0).path)
    scans = list(log.records(LandmarkScan))
    assert [s.labels for s in scans] == [(None,), (None,), ()]
    assert scans[2].range_bearing.shape == (0, 2)
    assert log.metadata["fieldloc"]["config"] == '{"anonymous": true, "max_range_m": 3.0, "left_sigma_mps": 0.03}'


def test_values_that_are_no_numbers_are_left_out_and_counted(tmp_path):
    data = small()
    data["b"][1, 0] = np.nan
    data["r"][2, 1] = -1.0
    data["v"][2] = np.inf
    data["x_true"][0] = np.nan
    result = imported(tmp_path, data)
    assert dict(result.counts) == {"/field": 1, "/odometry": 2, "/landmarks": 3, "/truth": 1}
    assert [s.labels for s in LogFile(result.path).records(LandmarkScan)] == [("1",), ("2",), ()]
    assert [warning.split()[0] for warning in result.warnings] == ["1", "2"]


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("r", None, "it has no r"),
        ("r", np.zeros((3, 5)), "r has shape"),
        ("v", np.zeros((2, 1)), "v has shape"),
        ("d", np.array([[np.nan]]), "d holds a value that is not a number"),
        ("r_var", np.array([[0.0]]), "r_var is 0.0"),
        ("t", np.array([[0.0], [0.2], [0.1]]), "t must be increasing"),
        ("l", "seventeen", "not the woods data set"),
    ],
)
def test_a_file_with_something_else_in_it_is_refused_by_name(tmp_path, name, value, complaint):
    data = small()
    del data[name]
    if value is not None:
        data[name] = value
    with pytest.raises(FieldlocError, match=complaint) as error:
        imported(tmp_path, data)
    assert str(tmp_path / "data.mat") in str(error.value)
    assert not (tmp_path / "log.mcap").exists()


def test_what_is_no_matlab_file_is_said_in_one_line(tmp_path):
    scipy.io.savemat(tmp_path / "good.mat", small(), do_compression=True)
    good = (tmp_path / "good.mat").read_bytes()
    changed = good[:200] + bytes([good[200] ^ 0xFF]) + good[201:]
    for content in (b"", b"hello", b"x" * 500, bytes(500), good[: len(good) // 2], good[:60], changed):
        (tmp_path / "bad.mat").write_bytes(content)
        with pytest.raises(FieldlocError, match=r"bad\.mat: ") as error:
            import_woods(tmp_path / "bad.mat", tmp_path / "log.mcap")
        assert "\n" not in str(error.value)
    for path in (tmp_path / "missing.mat", tmp_path):
        with pytest.raises(FieldlocError, match=str(path)):
            import_woods(path, tmp_path / "log.mcap")


def test_a_range_limit_below_zero_is_the_caller_s_mistake(tmp_path):
    with pytest.raises(ValueError, match="max_range_m"):
        imported(tmp_path, small(), max_range_m=-1.0)


def test_progress_ends_at_the_end(tmp_path):
    seen = []
    imported(tmp_path, small(), progress=lambda done, total: seen.append((done, total)))
    assert seen == [(8, 8)]


def test_the_sample_fits_its_map():
    """Ranges and bearings from the truth to the map: the spread that the file states (r_var, b_var), no offset."""
    log = LogFile(sample_path("woods"))
    field = log.field_map()
    truth = {t.stamp_ns: t.pose for t in log.records(Truth)}
    residuals = []
    for scan in log.records(LandmarkScan):
        if scan.stamp_ns in truth and scan.labels:
            sensor = pose.compose(truth[scan.stamp_ns], scan.robot_from_sensor)
            marks = field.positions[[field.index_of(label) for label in scan.labels]]
            there = pose.apply(pose.inverse(sensor), marks)
            expected = np.stack([np.hypot(*there.T), np.arctan2(there[:, 1], there[:, 0])], axis=-1)
            delta = scan.range_bearing - expected
            delta[:, 1] = pose.wrap(delta[:, 1])
            residuals.append(delta / np.sqrt(np.diagonal(scan.covariance, axis1=1, axis2=2)))
    residuals = np.concatenate(residuals)
    assert len(residuals) > 50_000
    assert np.all(np.abs(np.median(residuals, axis=0)) < 0.5)
    assert np.all(np.abs(np.std(residuals, axis=0) - 1.15) < 0.25)  # README of the data: 0.033 / 0.030, 0.0255 / 0.026


@needs_mat
def test_the_sample_is_what_the_importer_makes_of_the_data_set(tmp_path):
    import_woods(MAT, tmp_path / "log.mcap")
    fresh, sample = LogFile(tmp_path / "log.mcap"), LogFile(sample_path("woods"))
    pairs = zip(fresh.messages(), sample.messages(), strict=True)
    assert all(
        a.topic == b.topic and a.log_time_ns == b.log_time_ns and log_records.same(a.record, b.record) for a, b in pairs
    )
    assert fresh.metadata["fieldloc"]["config"] == sample.metadata["fieldloc"]["config"]
    assert fresh.warnings == sample.warnings == ()


def test_the_sample_says_whose_it_is():
    assert LogFile(sample_path("woods")).metadata["fieldloc"]["licence"] == "Apache-2.0"
    for name in ("LICENSE-woods", "README.md"):
        assert "Apache" in sample_path("woods").with_name(name).read_text()
    assert sample_path("woods").stat().st_size < 4e6


def test_a_sample_that_is_none_is_a_mistake():
    with pytest.raises(ValueError, match="there is woods"):
        sample_path("forest")
