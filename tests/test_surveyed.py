"""Landmarks that are not where the map has them, found by robots' logs among them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from program import Call

from benchmarks.drawn_robots import DrawnRobot, drawn_robot, drive
from estimators.config import Config, Graph
from estimators.fused import fused
from estimators.motion import CALIBRATION, PARTS, OdometryCalibration
from estimators.smoother import Smoother
from estimators.surveyed import EXACT_M, State, Survey, survey_covariance
from estimators.surveyed_map import SurveyedMap, surveyed_map, with_survey_sigma
from fieldloc.covariance import central_difference
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, load_field
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from logs.calibrating import calibrate_recordings
from logs.recording import Recording
from logs.replay import replay
from logs.samples import sample_path
from logs.surveying import landmark_table, on_one_map, survey, write_map

CONFIG = Config(graph=Graph(engine="chain"))
ROBOT = DrawnRobot(np.zeros(CALIBRATION), np.zeros(4), 0.0, np.full(PARTS, 0.5), np.full(2, 0.2), np.full(2, 0.1))
SIGMA_M = 0.1


def moved(field: FieldMap, by: FloatArray) -> FieldMap:
    pairs = zip(field.landmarks, by, strict=True)
    return replace(field, landmarks=tuple(replace(mark, position=mark.position + off) for mark, off in pairs))


def robots(seeds: range, field_seed: int = 1, duration_s: float = 16.0) -> tuple[list[Recording], FieldMap]:
    """Logs of one robot whose map has all landmarks SIGMA_M beside where they are, and the map with where they are."""
    true = drive(ROBOT, CONFIG, 1.0, np.random.default_rng(field_seed)).recording.field
    off = SIGMA_M * np.random.default_rng(99).standard_normal((len(true.landmarks), 2))
    drives = [drive(ROBOT, CONFIG, duration_s, np.random.default_rng(seed), true) for seed in seeds]
    wrong = moved(true, off)
    return [replace(one.recording, field=wrong) for one in drives], true


def found_by(recordings: list[Recording]) -> SurveyedMap:
    done = calibrate_recordings(recordings, CONFIG, landmark_sigma_m=SIGMA_M).landmarks
    assert done is not None
    return done


def errors(done: SurveyedMap, true: FieldMap) -> FloatArray:
    return (done.field.positions - true.positions).ravel()


def in_shape(off: FloatArray, positions: FloatArray) -> FloatArray:
    """Errors (k, 2) without a common shift, turn and scale, which no log tells well."""
    p, off = positions - positions.mean(axis=0), off.ravel()
    common = np.stack(
        [np.tile([1.0, 0.0], len(p)), np.tile([0.0, 1.0], len(p)), (p[:, ::-1] * [-1, 1]).ravel(), p.ravel()]
    )
    return off - common.T @ np.linalg.lstsq(common.T, off, rcond=None)[0]


@pytest.fixture(scope="module")
def once() -> tuple[SurveyedMap, list[Recording], FieldMap]:
    recordings, true = robots(range(5, 6))
    return found_by(recordings), recordings, true


def test_landmarks_are_found_as_near_as_is_said(once: tuple[SurveyedMap, list[Recording], FieldMap]) -> None:
    done, recordings, true = once
    off, told = errors(done, true), [one.told for one in done.landmarks]
    assert sum(told) >= 10
    places = true.positions[told]
    before, after = (each.field.positions[told] - places for each in (recordings[0], done))
    assert np.sum(in_shape(after, places) ** 2) < 0.25 * np.sum(in_shape(before, places) ** 2)
    # chi-square of 28 degrees, once in ten thousand
    assert off @ np.linalg.solve(done.covariance, off) < 62.0
    for landmark, one, mark in zip(done.landmarks, done.field.landmarks, recordings[0].field.landmarks, strict=True):
        assert landmark.told == bool((one.position != mark.position).any())
        assert landmark.sigma_m <= landmark.prior_sigma_m == pytest.approx(SIGMA_M, rel=1e-3)
        assert landmark.log_gain >= 0.0


def test_a_common_shift_and_turn_are_not_told(once: tuple[SurveyedMap, list[Recording], FieldMap]) -> None:
    done, _, _ = once
    np.testing.assert_allclose(done.common, done.prior_common, rtol=0.05)
    assert (done.common <= done.prior_common * 1.001).all()
    assert np.sqrt(np.diagonal(done.covariance)).min() > done.common[:2].min()


def test_a_map_that_is_moved_as_a_whole_is_moved_in_the_answer(
    once: tuple[SurveyedMap, list[Recording], FieldMap],
) -> None:
    done, recordings, _ = once
    by = np.array([0.5, -0.3])
    there = [replace(one, field=moved(one.field, np.tile(by, (len(one.field.landmarks), 1)))) for one in recordings]
    again = found_by(there)
    np.testing.assert_allclose(again.field.positions - done.field.positions, np.tile(by, (14, 1)), atol=2e-3)


@pytest.mark.slow
def test_another_log_makes_it_surer(once: tuple[SurveyedMap, list[Recording], FieldMap]) -> None:
    one, recordings, true = once
    more, _ = robots(range(6, 7))
    two = found_by([*recordings, *more])
    assert np.isnan(one.disagreement)
    assert 0.3 < two.disagreement < 3.0
    off = errors(two, true)
    assert off @ np.linalg.solve(two.covariance, off) < 62.0
    assert np.linalg.slogdet(two.covariance)[1] < np.linalg.slogdet(one.covariance)[1]


def test_what_was_found_is_a_map_for_everyone(
    once: tuple[SurveyedMap, list[Recording], FieldMap], tmp_path: Path
) -> None:
    done, _, _ = once
    write_map(tmp_path / "map.toml", done, ["a", "b"])
    again = load_field(str(tmp_path / "map.toml"))
    np.testing.assert_array_equal(again.positions, done.field.positions)
    np.testing.assert_array_equal(again.positions_covariance, done.field.positions_covariance)
    own = done.covariance.reshape(14, 2, 14, 2)[np.arange(14), :, np.arange(14)]
    np.testing.assert_allclose(done.field.positions_covariance, own, atol=2.0 * EXACT_M**2)
    table = landmark_table(done).splitlines()
    assert len(table) == 1 + 14 + 1
    assert table[0].split() == ["landmark", "dx", "dy", "sigma", "sigma", "before", "unit", "log-likelihood"]


def without(scan: LandmarkScan, label: str) -> LandmarkScan:
    kept = [row for row, other in enumerate(scan.labels) if other != label]
    labels = tuple(scan.labels[row] for row in kept)
    return replace(scan, labels=labels, range_bearing=scan.range_bearing[kept], covariance=scan.covariance[kept])


def test_a_landmark_that_was_not_seen_stays_where_it_was() -> None:
    (recording,), _ = robots(range(5, 6), duration_s=8.0)
    seen = [without(one, "3") if isinstance(one, LandmarkScan) else one for one in recording.measurements]
    done = found_by([replace(recording, measurements=tuple(seen))])
    (mark,) = (mark for mark in recording.field.landmarks if mark.label == "3")
    (one,) = (one for one in done.landmarks if one.label == "3")
    (now,) = (mark for mark in done.field.landmarks if mark.label == "3")
    assert not one.told
    assert (one.dx_m, one.dy_m, one.log_gain) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(now.position, mark.position)
    np.testing.assert_allclose(now.covariance, SIGMA_M**2 * np.eye(2))
    assert "not told" in landmark_table(done)


def test_a_landmark_of_which_the_map_says_how_well_it_is_known_is_known_so() -> None:
    (recording,), _ = robots(range(5, 6), duration_s=1.0)
    marks = recording.field.landmarks
    field = replace(recording.field, landmarks=(replace(marks[0], covariance=1e-4 * np.eye(2)), *marks[1:]))
    known = with_survey_sigma(field, 0.05).positions_covariance
    np.testing.assert_array_equal(known[0], 1e-4 * np.eye(2))
    np.testing.assert_allclose(known[1:], np.broadcast_to(0.05**2 * np.eye(2), (13, 2, 2)))
    assert survey_covariance(field).shape == (28, 28)


def test_maps_that_cannot_be_surveyed_are_refused_in_one_line() -> None:
    (one,), _ = robots(range(5, 6), duration_s=1.0)
    other = replace(one, name="other", field=moved(one.field, np.ones((14, 2))))
    bare = replace(one, field=load_field("kidsize"))
    bare = replace(bare, field=replace(bare.field, landmarks=(), crossbars=()))
    blind = replace(one, measurements=tuple(m for m in one.measurements if not isinstance(m, LandmarkScan)))
    for recordings, message in (([one, other], "other: its map"), ([bare], "no landmarks"), ([blind], "images alone")):
        with pytest.raises(FieldlocError, match=message) as refused:
            on_one_map(recordings, 0.05)
        assert "\n" not in str(refused.value)
    with pytest.raises(ValueError, match="no log"):
        surveyed_map(one.field, [])


def test_logs_that_say_nothing_leave_the_prior_and_two_that_agree_say_it_twice() -> None:
    mean, covariance = np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    nothing = fused(mean, covariance, [(mean, covariance), (mean, covariance)])
    np.testing.assert_allclose(nothing.mean, mean)
    np.testing.assert_allclose(nothing.covariance, covariance)
    assert np.isnan(nothing.disagreement)
    seen = np.diag([4.0, 9.0])  # information of each
    posterior = np.linalg.inv(np.linalg.inv(covariance) + seen)
    at = posterior @ (np.linalg.inv(covariance) @ mean + seen @ np.array([1.5, -1.0]))
    twice = fused(mean, covariance, 2 * [(at, posterior)])
    whole = np.linalg.inv(np.linalg.inv(covariance) + 2.0 * seen)
    np.testing.assert_allclose(twice.covariance, whole)
    np.testing.assert_allclose(twice.mean, whole @ (np.linalg.inv(covariance) @ mean + 2.0 * seen @ [1.5, -1.0]))


def test_logs_that_contradict_each_other_are_believed_less() -> None:
    mean, covariance = np.zeros(2), np.eye(2)
    one, other = (np.array([sign, sign]) for sign in (0.9, -0.9))
    apart = fused(mean, covariance, [(one, 0.1 * covariance), (other, 0.1 * covariance)])
    agreed = fused(mean, covariance, 2 * [(one, 0.1 * covariance)])
    assert apart.disagreement > 3.0
    assert (np.diag(apart.covariance) > 2.0 * np.diag(agreed.covariance)).all()
    assert (np.diag(apart.covariance) < 1.0).all()  # never less than what was known before


def test_a_soccer_field_whose_posts_were_surveyed_looks_the_same_from_both_sides() -> None:
    field = load_field("kidsize")
    off = 0.02 * np.random.default_rng(3).standard_normal((4, 2))
    surveyed = moved(with_survey_sigma(field, 0.02), off)
    np.testing.assert_array_equal(surveyed.symmetries, field.symmetries)
    assert len(moved(field, off).symmetries) == 0  # as exact they are four different posts
    assert len(moved(with_survey_sigma(field, 0.001), 5.0 * off).symmetries) == 0


@pytest.fixture(scope="module")
def asked() -> Survey:
    """Of a robot that is not perfect, at a state that is not the answer."""
    random = np.random.default_rng(2)
    log = drive(drawn_robot(CONFIG, random), CONFIG, 6.0, random)
    smoother = Smoother(CONFIG)
    done = replay(log.recording, smoother, None, CONFIG)
    assert smoother.chain is not None
    assert smoother.solution is not None
    out = survey(log.recording, smoother.chain, smoother.solution, done.sensors, log.recording.field, CONFIG)
    assert out is not None
    out._state = out._moved(0.02 * random.standard_normal((len(out._state.poses), 3)), 0.02 * np.ones(out._size))
    return out


def towards(asked: Survey, state: State) -> tuple[FloatArray, FloatArray]:
    """Errors of motions and of sights."""
    motions = asked._as_said(asked._motions.motions(state.poses, state.common), state)
    return motions.towards.ravel(), asked._errors(state, asked._seen)[0].ravel()


def test_errors_change_as_their_jacobians_say(asked: Survey) -> None:
    poses = np.zeros((len(asked._state.poses), 3))

    def by_border(step: FloatArray) -> FloatArray:
        return np.concatenate(towards(asked, asked._moved(poses, step)))

    def by_pose(step: FloatArray) -> FloatArray:
        return np.concatenate(towards(asked, asked._moved(np.tile(step, (len(poses), 1)), np.zeros(asked._size))))

    state = asked._state
    motions = asked._as_said(asked._motions.motions(state.poses, state.common), state)
    _, sights = asked._errors(state, asked._seen)
    numeric = -central_difference(by_border, np.zeros(asked._size))
    of_motions = np.zeros((motions.by_globals.shape[0] * 3, asked._size))
    of_motions[:, : asked._free] = motions.by_globals.reshape(-1, asked._free)
    exact = np.concatenate([of_motions, sights[..., 3:].reshape(-1, asked._size)])
    np.testing.assert_allclose(numeric, exact, atol=1e-6 * np.abs(exact).max())
    numeric = -central_difference(by_pose, np.zeros(3))
    exact = np.concatenate([(motions.before + motions.after).reshape(-1, 3), sights[..., :3].reshape(-1, 3)])
    np.testing.assert_allclose(numeric, exact, atol=1e-6 * np.abs(motions.before).max())


def test_a_world_that_is_larger_as_a_whole_fits_as_well(asked: Survey) -> None:
    state, larger = asked._state, 1.01
    common = state.common.copy()
    common[0] = larger * (1.0 + common[0]) - 1.0
    by_way = [OdometryCalibration._fields.index(name) for name in ("drift_mps", "turn_slowing_s", "crab_rad")]
    common[by_way] *= larger
    common[OdometryCalibration._fields.index("veer_rad_per_m")] /= larger
    common[CALIBRATION : CALIBRATION + 2] *= larger
    distortions = state.distortions - [np.log(larger), 0.0, 0.0, 0.0]
    scaled = State(state.poses * [larger, larger, 1.0], common, distortions, larger * state.positions)
    for here, there in zip(towards(asked, state), towards(asked, scaled), strict=True):
        # crab and veer are not quite a matter of scale; an error that grew with the world would be off by 1e-2
        np.testing.assert_allclose(np.sum(there**2), np.sum(here**2), rtol=1e-3)


def test_the_program_surveys_the_sample_and_its_map_is_taken(call: Call, tmp_path: Path) -> None:
    log, out = sample_path("woods"), tmp_path / "map.toml"
    said = call("calibrate", log, "--to", 12, "--set", "graph.engine=chain", "--landmarks", "--field-output", out)
    assert said.code == 0, said.err
    assert "log-likelihood" in said.out
    assert "for --field" in said.out
    assert np.abs(load_field(str(out)).positions).max() < 20.0
    for typed, named in ((("--field-output", out), "--landmarks"), (("--landmark-sigma-m", "0.1"), "--landmarks")):
        refused = call("calibrate", log, *typed)
        assert (refused.code, refused.err.count("\n")) == (1, 1)
        assert named in refused.err
