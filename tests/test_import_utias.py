import gzip
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest

from fieldloc.errors import FieldlocError
from fieldloc.measurements import LandmarkScan, Odometry, Truth
from logs.importers import import_utias
from logs.reader import LogFile

TAR = Path(__file__).parents[2] / "shared" / "data" / "mrclam" / "MRCLAM_Dataset6.tar.gz"
needs_tar = pytest.mark.skipif(not TAR.is_file(), reason=f"{TAR} is missing: UTIAS data set 6")

FILES = {
    "Barcodes.dat": "# Subject #    Barcode #\n  1 \t   5\n  2 \t  14\n  6 \t  63\n  7 \t  25\n  8 \t  45\n",
    "Landmark_Groundtruth.dat": "# Subject x y sx sy\n 6 \t 0.5 -4.25 0.0001 0.0002\n 7 1.5 2.0 0.0003 0.0004\n",
    "Robot1_Odometry.dat": "#\n1248444187.156 \t 0.086 \t -0.398\n1248444187.166 0.096 0.1\n1248444187.166 0.1 0\n",
    "Robot1_Measurement.dat": (
        "# t barcode r b\n1248444187.2 63 2.0 0.1\n1248444187.2 25 0.2 -0.2\n1248444187.2 14 1.0 0.0\n"
        "1248444187.3 99 2.0 0.1\n1248444187.4 45 2.0 0.1\n1248444187.5 25 6.0 0.3\n"
    ),
    "Robot1_Groundtruth.dat": "1248444187.1560001 1.41277290 -3.89107760 2.26960000\n1248444188 1.5 -3.5 2.25\n",
}


@pytest.fixture
def folder(tmp_path):
    out = tmp_path / "MRCLAM_Dataset0"
    out.mkdir()
    for name, text in FILES.items():
        (out / name).write_text(text)
    return out


def imported(path, tmp_path, robot=1, **options):
    return import_utias(path, robot, tmp_path / "log.mcap", **options)


def test_every_number_of_the_files_is_in_the_log(folder, tmp_path):
    result = imported(folder, tmp_path)
    assert dict(result.counts) == {"/field": 1, "/odometry": 3, "/landmarks": 4, "/truth": 2}
    log = LogFile(result.path)
    odometry = list(log.records(Odometry))
    stamps = [1248444187_156000000, 1248444187_166000000, 1248444187_166000000]
    assert [o.stamp_ns for o in odometry] == stamps
    assert np.array_equal([o.velocity for o in odometry], [[0.086, 0.0, -0.398], [0.096, 0.0, 0.1], [0.1, 0.0, 0.0]])
    assert all(o.covariance is None for o in odometry)
    assert [(t.stamp_ns, *t.pose) for t in log.records(Truth)] == [
        (1248444187_156000100, 1.41277290, -3.89107760, 2.2696),
        (1248444188_000000000, 1.5, -3.5, 2.25),
    ]
    field = log.field_map()
    assert field.labels == ("6", "7")
    assert np.array_equal(field.positions, [[0.5, -4.25], [1.5, 2.0]])
    sigmas = np.array([[0.0001, 0.0002], [0.0003, 0.0004]])
    assert np.array_equal(field.positions_covariance, [np.diag(s**2) for s in sigmas])


def test_equal_stamps_are_one_image_and_only_landmarks_of_the_map_are_in_it(folder, tmp_path):
    result = imported(folder, tmp_path)
    scans = list(LogFile(result.path).records(LandmarkScan))
    assert [(s.stamp_ns, s.labels) for s in scans] == [
        (1248444187_200000000, ("6", "7")),
        (1248444187_300000000, ()),
        (1248444187_400000000, ()),
        (1248444187_500000000, ("7",)),
    ]
    assert np.array_equal(scans[0].range_bearing, [[2.0, 0.1], [0.2, -0.2]])
    assert result.warnings == (
        "1 observation left out: barcode 99 not in Barcodes.dat",
        "1 observation left out: subject 8 not in Landmark_Groundtruth.dat",
    )


def test_the_noise_that_the_data_set_does_not_state_is_an_option(folder, tmp_path):
    (scan, *_) = LogFile(imported(folder, tmp_path).path).records(LandmarkScan)
    expected = [np.diag([0.1, 0.017]) ** 2, np.diag([0.02, 0.017]) ** 2]
    assert np.allclose(scan.covariance, expected, rtol=1e-12, atol=0.0)
    options = {"range_sigma_relative": 0.2, "range_sigma_floor_m": 0.1, "bearing_sigma_rad": 0.5}
    (scan, *_) = LogFile(imported(folder, tmp_path, **options).path).records(LandmarkScan)
    expected = [np.diag([0.4, 0.5]) ** 2, np.diag([0.1, 0.5]) ** 2]
    assert np.allclose(scan.covariance, expected, rtol=1e-12, atol=0.0)
    with pytest.raises(ValueError, match="standard deviations"):
        imported(folder, tmp_path, bearing_sigma_rad=0.0)


def test_identities_can_be_dropped_and_far_landmarks_cut_off(folder, tmp_path):
    scans = list(LogFile(imported(folder, tmp_path, anonymous=True, max_range_m=5.0).path).records(LandmarkScan))
    assert [s.labels for s in scans] == [(None, None), (), (), ()]


def make_tar(folder, tmp_path):
    with tarfile.open(tmp_path / "data.tar.gz", "w:gz") as archive:
        archive.add(folder, folder.name)
    return tmp_path / "data.tar.gz"


def make_zip(folder, tmp_path):
    return Path(shutil.make_archive(str(tmp_path / "data"), "zip", tmp_path, folder.name))


@pytest.mark.parametrize("make", [lambda folder, _: folder.parent, make_tar, make_zip])
def test_the_files_are_found_in_a_folder_inside_and_in_archives(folder, tmp_path, make):
    path = make(folder, tmp_path)
    expected = imported(folder, tmp_path).path.read_bytes()
    assert imported(path, tmp_path).path.read_bytes() == expected


def test_two_data_sets_in_one_place_are_not_mixed(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "MRCLAM_Dataset1")
    with pytest.raises(FieldlocError, match="several data sets; give one of them: MRCLAM_Dataset0, MRCLAM_Dataset1"):
        imported(tmp_path, tmp_path)


def test_a_robot_that_is_not_there_is_said_with_those_that_are(folder, tmp_path):
    with pytest.raises(FieldlocError, match=r"there is no robot 3, only 1$"):
        imported(folder, tmp_path, robot=3)


@pytest.mark.parametrize("name", [name for name in FILES if name != "Robot1_Odometry.dat"])
def test_a_missing_file_is_named(folder, tmp_path, name):
    (folder / name).unlink()
    with pytest.raises(FieldlocError, match=name):
        imported(folder, tmp_path)
    assert not (tmp_path / "log.mcap").exists()


@pytest.mark.parametrize(
    ("name", "line", "complaint"),
    [
        ("Robot1_Odometry.dat", "1.5 0.1", "2 columns where 3 are needed"),
        ("Robot1_Odometry.dat", "1.5 0.1 zero", "'zero' is not a number"),
        ("Robot1_Odometry.dat", "1.5 nan 0.1", "'nan' is not a number"),
        ("Robot1_Odometry.dat", "noon 0.1 0.1", "'noon' is not a time"),
        ("Robot1_Odometry.dat", "inf 0.1 0.1", "'inf' is not a time"),
        ("Robot1_Odometry.dat", "1e99999999 0.1 0.1", "1e99999999"),
        ("Robot1_Odometry.dat", "-1 0.1 0.1", "-1 s is no time that a log can hold"),
        ("Robot1_Measurement.dat", "1.5 63 -2.0 0.1", "a range of -2 m"),
        ("Robot1_Measurement.dat", "1.5 6.5 2.0 0.1", "'6.5' is not a whole number"),
        ("Robot1_Groundtruth.dat", "1.5 1 2 3 4", "5 columns where 4 are needed"),
        ("Barcodes.dat", "9 63", "barcode 63 a second time"),
        ("Landmark_Groundtruth.dat", "6 1 2 0.1 0.1", "landmarks of equal label"),
        ("Landmark_Groundtruth.dat", "9 1 2", "3 columns where 5 are needed"),
    ],
)
def test_a_malformed_line_is_named_with_its_file(folder, tmp_path, name, line, complaint):
    with (folder / name).open("a") as file:
        file.write(f"\n# a comment\n{line}\n")
    number = FILES[name].count("\n") + 3
    with pytest.raises(FieldlocError, match=complaint) as error:
        imported(folder, tmp_path)
    assert name in str(error.value)
    assert f"line {number}" in str(error.value) or "equal label" in complaint
    assert not (tmp_path / "log.mcap").exists()


def test_lines_out_of_order_are_put_in_order(folder, tmp_path):
    with (folder / "Robot1_Odometry.dat").open("a") as file:
        file.write("1248444187.1 0.5 0.5\n")
    stamps = [o.stamp_ns for o in LogFile(imported(folder, tmp_path).path).records(Odometry)]
    assert stamps == sorted(stamps)
    assert len(stamps) == 4


def test_what_is_no_data_set_is_said_in_one_line(folder, tmp_path):
    whole = make_tar(folder, tmp_path).read_bytes()
    (tmp_path / "cut.tar.gz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.gz").write_bytes(gzip.compress(b"hello"))
    (tmp_path / "text").write_text("hello")
    (tmp_path / "empty").mkdir()
    make_zip(folder, tmp_path)
    damaged = bytearray((tmp_path / "data.zip").read_bytes())
    damaged[damaged.index(b"Odometry") + 30] ^= 0xFF
    (tmp_path / "bad.zip").write_bytes(damaged)
    for name in ("cut.tar.gz", "text.gz", "text", "empty", "bad.zip", "missing"):
        with pytest.raises(FieldlocError, match=name) as error:
            imported(tmp_path / name, tmp_path)
        assert "\n" not in str(error.value)


@needs_tar
@pytest.mark.parametrize("robot", [1, 4])
def test_data_set_6_is_read_in_full(tmp_path, robot):
    result = imported(TAR, tmp_path, robot=robot)
    expected = {
        1: {"/odometry": 61785, "/landmarks": 1234, "/truth": 49241, "/field": 1},
        4: {"/odometry": 52916, "/landmarks": 1459, "/truth": 61714, "/field": 1},
    }
    assert dict(result.counts) == expected[robot]
    log = LogFile(result.path)
    assert log.field_map().labels == tuple(str(subject) for subject in range(6, 21))
    labels = {label for scan in log.records(LandmarkScan) for label in scan.labels}
    assert labels <= set(log.field_map().labels)
    assert len(labels) > 10
    assert len(result.warnings) == 1  # a few misread barcodes
