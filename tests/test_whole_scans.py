"""One image of a sensor that a log holds in parts."""

import numpy as np

from fieldloc.measurements import LandmarkScan, Odometry
from logs.whole_scans import whole_scans

MS = 1_000_000


def scan(stamp_ns: int, labels: tuple[str | None, ...], mount_x_m: float = 0.0) -> LandmarkScan:
    n = len(labels)
    range_bearing = np.column_stack([np.arange(1.0, n + 1.0) + stamp_ns * 1e-9, np.zeros(n)])
    return LandmarkScan(stamp_ns, labels, range_bearing, np.tile(np.eye(2), (n, 1, 1)), np.array([mount_x_m, 0.0, 0.0]))


def test_what_is_stamped_nearly_alike_is_one_scan_with_all_that_was_seen() -> None:
    odometry = Odometry(MS // 2, np.zeros(3))
    first, second = scan(0, ("a", None)), scan(MS, ("b",))
    whole, moved, later = whole_scans([first, odometry, second, scan(60 * MS, ("c",))])
    assert isinstance(whole, LandmarkScan)
    assert isinstance(later, LandmarkScan)
    assert moved is odometry
    assert (whole.stamp_ns, whole.labels, later.labels) == (0, ("a", None, "b"), ("c",))
    np.testing.assert_array_equal(whole.range_bearing, np.concatenate([first.range_bearing, second.range_bearing]))
    assert whole.covariance.shape == (3, 2, 2)


def test_two_sensors_and_one_landmark_twice_are_not_one_image() -> None:
    apart = [scan(0, ("a",)), scan(0, ("b",), mount_x_m=0.1), scan(MS, ("a",))]
    assert whole_scans(apart) == apart


def test_an_image_with_nothing_in_it_is_part_of_one() -> None:
    (whole,) = whole_scans([scan(0, ()), scan(MS, ("a",))])
    assert isinstance(whole, LandmarkScan)
    assert whole.labels == ("a",)
