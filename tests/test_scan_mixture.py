"""A scan's mixture against sums over all assignments, one by one, and integrals over all poses, by sums."""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.scan_mixture import ScanMixture, scan_mixture

DETECTION = Detection(clutter=0.03, nothing_right=0.1)
SIGMA = np.array([0.05, 0.03])
MOUNT = np.array([0.2, -0.1, 0.7])
SURVEY = np.array([[0.004, 0.001], [0.001, 0.002]])
POSITIONS = np.array([[2.0, 1.0], [2.0, -1.5], [-1.5, 2.0], [0.5, -3.0], [3.5, 0.2]])
NARROW = np.diag([0.02, 0.02, 0.02]) ** 2
Labels = Sequence[str | None]


def field_of(positions: FloatArray = POSITIONS, survey: FloatArray | None = None) -> FieldMap:
    covariance = np.zeros((2, 2)) if survey is None else survey
    marks = tuple(Landmark(str(i), position, 0.1, covariance) for i, position in enumerate(positions))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def scan_of(
    pose: FloatArray, which: FloatArray, mount: FloatArray | None = None, noise: FloatArray | float = 0.0
) -> LandmarkScan:
    """What is seen at places which (n, 2) from a pose, with an error of so many sigmas."""
    mount = np.zeros(3) if mount is None else mount
    at = se2.apply(se2.inverse(se2.compose(pose, mount)), which)
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    covariance = np.tile(np.diag(SIGMA**2), (len(which), 1, 1))
    return LandmarkScan(7, (None,) * len(which), seen + noise * SIGMA, covariance, mount)


def labelled(scan: LandmarkScan, labels: Labels) -> LandmarkScan:
    return LandmarkScan(scan.stamp_ns, tuple(labels), scan.range_bearing, scan.covariance, scan.robot_from_sensor)


def mixture(scan: LandmarkScan, field: FieldMap, wider: float = 1.0) -> ScanMixture:
    out = scan_mixture(scan, field, DETECTION, np.full((len(field.landmarks), 2), wider))
    assert out is not None
    return out


def log_normal(error: FloatArray, covariance: FloatArray) -> float:
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(2 * np.pi * covariance)[1]))


def every_assignment(scan: LandmarkScan, field: FieldMap) -> Iterator[tuple[int, ...]]:
    m = len(field.landmarks)
    options = [range(-1, m) if label is None else (-1, int(label)) for label in scan.labels]
    for match in product(*options):
        taken = [j for j in match if j >= 0]
        if len(set(taken)) == len(taken):
            yield match


def log_prior(scan: LandmarkScan, field: FieldMap, match: Sequence[int]) -> float:
    """Of a scan that is right with just these matches, and the density of its clutter."""
    (x_min, y_min, x_max, y_max), m = field.bounds, len(field.landmarks)
    anywhere = 1.0 / (2 * np.pi * np.hypot(x_max - x_min, y_max - y_min))
    out = np.log(1 - DETECTION.nothing_right)
    for label, j in zip(scan.labels, match, strict=True):
        among = m if label is None else 1
        out += np.log(DETECTION.clutter * anywhere if j < 0 else (1 - DETECTION.clutter) / among)
    return float(out)


def log_joint(scan: LandmarkScan, field: FieldMap, match: Sequence[int], pose: FloatArray) -> float:
    """log p(scan, assignment | pose), from the words of the module."""
    sensor = se2.compose(pose, scan.robot_from_sensor)
    out = log_prior(scan, field, match)
    for i, j in enumerate(match):
        if j >= 0:
            to = field.positions[j] - sensor[:2]
            d = np.hypot(*to)
            u = to / d
            by_place = np.array([u, np.array([-u[1], u[0]]) / d])
            error = scan.range_bearing[i] - [d, np.arctan2(to[1], to[0]) - sensor[2]]
            error[1] = se2.wrap(error[1])
            out += log_normal(error, scan.covariance[i] + by_place @ field.positions_covariance[j] @ by_place.T)
    return out


def log_wrong(scan: LandmarkScan, field: FieldMap) -> float:
    (x_min, y_min, x_max, y_max), n = field.bounds, len(scan.labels)
    return float(np.log(DETECTION.nothing_right) - n * np.log(2 * np.pi * np.hypot(x_max - x_min, y_max - y_min)))


POSE = np.array([0.3, -0.2, 0.4])
CASES = {
    "one": (scan_of(POSE, POSITIONS[:1], noise=0.5), field_of()),
    "three": (scan_of(POSE, POSITIONS[[0, 1, 3]], noise=0.5), field_of()),
    "mounted": (scan_of(POSE, POSITIONS[[0, 1, 3]], MOUNT, noise=0.5), field_of()),
    "surveyed": (scan_of(POSE, POSITIONS[[0, 1, 3]], MOUNT, noise=0.5), field_of(survey=SURVEY)),
    "labels": (labelled(scan_of(POSE, POSITIONS[[0, 1, 3]], noise=0.5), ["0", None, "3"]), field_of()),
    "twice": (scan_of(POSE, POSITIONS[[0, 0, 1]] + [[0, 0], [0.05, 0.05], [0, 0]]), field_of()),
    "thrice": (scan_of(POSE, POSITIONS[[0, 0, 0]] + [[0, 0], [0.05, 0.05], [-0.05, 0]]), field_of()),
    "clutter": (scan_of(POSE, np.array([[2.0, 1.0], [1.0, 0.5], [2.0, -1.5]])), field_of()),
    "crowded": (scan_of(POSE, POSITIONS[[0, 1]]), field_of(np.vstack([POSITIONS, POSITIONS[:2] + 0.08]), SURVEY)),
}
each = pytest.mark.parametrize(("scan", "field"), CASES.values(), ids=CASES.keys())


@each
def test_the_likelihood_is_the_sum_over_all_assignments(scan: LandmarkScan, field: FieldMap) -> None:
    poses = se2.retract(POSE, np.random.default_rng(1).normal(0, 0.1, (20, 3)))
    found = mixture(scan, field).log_likelihood(poses)
    for pose, value in zip(poses, found, strict=True):
        terms = [log_joint(scan, field, match, pose) for match in every_assignment(scan, field)]
        # gated is what is less likely than e^-9 of what there is without an error
        np.testing.assert_allclose(value, np.logaddexp.reduce([*terms, log_wrong(scan, field)]), atol=0.01)


@each
def test_an_expansion_is_the_logarithm_of_each_assignment_s_density(scan: LandmarkScan, field: FieldMap) -> None:
    one = mixture(scan, field)
    near = one.expand(POSE[None], NARROW[None])
    matches = {match: log_joint(scan, field, match, POSE) for match in every_assignment(scan, field)}
    best = max(matches.values())
    found = [tuple(one.matches(int(i)).tolist()) for i in near.ids]
    assert len(set(found)) == len(found)
    for match, step, constant, gradient, information in zip(
        found, near.step, near.constant, near.gradient, near.information, strict=True
    ):
        at = constant + gradient @ step - 0.5 * step @ information @ step
        np.testing.assert_allclose(at, log_joint(scan, field, match, se2.retract(POSE, step)), atol=0.02)
    for match, value in matches.items():
        if value > best - 5.0 and max(match) >= 0:
            assert match in found
