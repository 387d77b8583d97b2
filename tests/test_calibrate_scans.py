"""What distorts a robot's scans, from one log of it or two."""

import numpy as np

from benchmarks.drawn_robots import DrawnRobot, drive
from estimators.calibrated import Quantity
from estimators.config import Config, Graph
from estimators.motion import CALIBRATION, PARTS
from fieldloc.scan_distortion import ScanDistortion
from logs.calibrating import calibrate_recordings

CONFIG = Config(graph=Graph(engine="chain"))
CAMERA = ScanDistortion(0.03, 0.9, 0.02, -0.02)
ROBOT = DrawnRobot(np.zeros(CALIBRATION), np.zeros(4), 0.0, np.ones(PARTS), np.full(2, 0.3), np.full(2, 0.1), CAMERA)


def found(logs: int) -> dict[str, Quantity]:
    drives = [drive(ROBOT, CONFIG, 30.0, np.random.default_rng(seed)) for seed in range(logs)]
    done = calibrate_recordings([one.recording for one in drives], CONFIG)
    known = done.settings(CONFIG).scan_distortion
    assert known.means().tolist() == [one.value for one in done.scans]
    assert (known.sigmas() <= CONFIG.scan_distortion.sigmas() * 1.01).all()
    return {one.name: one for one in done.scans}


def test_a_second_log_makes_what_distorts_scans_surer() -> None:
    one, two = found(1), found(2)
    true = CAMERA._asdict()
    assert list(one) == list(two) == list(true)
    for name in true:
        assert abs(two[name].value - true[name]) < 3.5 * two[name].sigma
        assert two[name].sigma < one[name].sigma
    assert two["depth"].told
    assert two["depth"].log_gain > 10.0
