"""Maps whose landmarks are not where they say, and what drawn robots' logs say of where they are."""

from dataclasses import replace

import numpy as np

from benchmarks.drawn_robots import drawn_robot, drive
from estimators.config import Config, Graph
from logs.calibrating import calibrate_recordings

_SIGMA_M = 0.05


def found_landmarks(duration_s: float, seed: int) -> list[tuple[str, float, float, float]]:
    """Name, error, standard deviation, that of before, for x and y of each landmark of a robot of that seed."""
    config, random = replace(Config(), graph=Graph(engine="chain")), np.random.default_rng(seed)
    log = drive(drawn_robot(config, random), config, duration_s, random)
    true = log.recording.field
    marks = [replace(one, position=one.position + _SIGMA_M * random.standard_normal(2)) for one in true.landmarks]
    thought = replace(log.recording, field=replace(true, landmarks=tuple(marks)))
    done = calibrate_recordings([thought], config, landmark_sigma_m=_SIGMA_M).landmarks
    assert done is not None
    errors = (done.field.positions - true.positions).ravel().tolist()
    sigmas = np.sqrt(np.diagonal(done.field.positions_covariance, axis1=-2, axis2=-1)).ravel().tolist()
    return [("landmark", error, sigma, _SIGMA_M) for error, sigma in zip(errors, sigmas, strict=True)]
