"""The measuring of ambiguity measures: with an estimator that knows the truth, or its mirror image, to compare to."""

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.ambiguity import run
from benchmarks.games import GAMES, PlayedGame, truth_at
from benchmarks.scoring import (
    Moment,
    both_sides,
    expected_calibration_error,
    first_right_s,
    reliability,
    watch,
)
from estimators.base import Ambiguity, Estimate, Event, Hypothesis, Innovation
from estimators.config import Config
from fieldloc import pose as se2
from fieldloc.factors import Factor
from fieldloc.measurements import Compass, InitialPose, Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.regions import Region

COVARIANCE = np.diag([0.1, 0.1, 0.05]) ** 2


class Prompted:
    """An estimator that is told the truth, moved by an error in the robot frame and mirrored after a time."""

    def __init__(self, game: PlayedGame, mirrored_from_s: float = np.inf, mirrored: float = 0.25) -> None:
        self._game, self._mirrored = game, mirrored
        self._from_ns = game.recording.measurements[0].stamp_ns + mirrored_from_s * 1e9
        self._stamp_ns: int | None = None
        self.regions: list[Region] = []

    def start(self, estimate: Estimate) -> None:
        self._stamp_ns = estimate.stamp_ns

    def start_in(self, region: Region, stamp_ns: int) -> None:
        self.regions.append(region)

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)

    def advance(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns

    def update(self, factor: Factor) -> Innovation | None:
        return None

    def observe(self, mixture: MixtureFactor) -> None:
        self.advance(mixture.stamp_ns)

    def estimate(self) -> Estimate | None:
        said = self.ambiguity()
        return None if said is None else Estimate(said.stamp_ns, said.hypotheses[0].pose, COVARIANCE)

    def ambiguity(self) -> Ambiguity | None:
        if self._stamp_ns is None or (truth := truth_at(self._game, self._stamp_ns)) is None:
            return None
        pose = se2.compose(truth, np.array([0.1, 0.0, 0.05]))
        twin = se2.compose(self._game.recording.field.symmetries[0], pose)
        first, second = (twin, pose) if self._stamp_ns >= self._from_ns else (pose, twin)
        hypotheses = (
            Hypothesis(1.0 - self._mirrored, first, COVARIANCE, 1),
            Hypothesis(self._mirrored, second, COVARIANCE, 2),
        )
        return Ambiguity(self._stamp_ns, hypotheses, self._mirrored, 0.0)

    @property
    def events(self) -> Sequence[Event]:
        return ()


def watched(game: PlayedGame, mirrored_from_s: float = np.inf) -> list[Moment]:
    return watch(game, lambda _: Prompted(game, mirrored_from_s), Config())[0]


@pytest.mark.parametrize("kind", GAMES)
def test_who_knows_the_truth_is_always_right(kind: str) -> None:
    game = GAMES[kind](3, 6.0)
    assert not any(isinstance(measurement, InitialPose) for measurement in game.recording.measurements)
    assert len(game.evidence_ns) == len(game.put_down_ns) + 1
    moments = watched(game)
    assert len(moments) > 20
    assert all(moment.right and moment.found and not moment.other_side for moment in moments)
    assert [list(moment.true) for moment in moments] == [[True, False]] * len(moments)
    # 0.1 m of 0.1 m ahead and 0.05 of 0.05 in the heading
    assert [moment.nees for moment in moments] == pytest.approx([2.0] * len(moments))
    assert [moment.away_m for moment in moments] == pytest.approx([0.1] * len(moments))


def test_who_is_mirrored_is_at_a_copy_on_the_other_side() -> None:
    game = GAMES["own half"](0, 6.0)
    start = game.recording.measurements[0].stamp_ns
    moments = watched(game, mirrored_from_s=3.0)
    for moment in moments:
        late = moment.stamp_ns >= start + 3 * 10**9
        assert moment.found
        assert (moment.right, moment.other_side) == (not late, late)
        assert moment.nees_folded == pytest.approx(2.0)
        assert list(moment.true) == ([False, True] if late else [True, False])
    told, true = both_sides(moments)
    share = np.mean([moment.other_side for moment in moments])
    assert expected_calibration_error(told, true) == pytest.approx(abs(share - 0.25))


def test_it_is_the_region_that_the_estimator_starts_in() -> None:
    game = GAMES["own half"](0, 1.0)
    prompted = Prompted(game)
    watch(game, lambda _: prompted, Config())
    assert [region.name for region in prompted.regions] == ["own-half"]
    truth = truth_at(game, game.recording.measurements[0].stamp_ns)
    assert truth is not None
    assert truth[0] < 0.0


def test_the_noisy_compass_is_off_by_forty_degrees_for_ten_seconds() -> None:
    game = GAMES["noisy compass"](1, 40.0)
    off = [
        se2.wrap(m.heading_rad - game.course.poses_at(np.array(m.stamp_ns))[2])
        for m in game.recording.measurements
        if isinstance(m, Compass)
    ]
    assert {m.sigma_rad for m in game.recording.measurements if isinstance(m, Compass)} == {np.radians(15.0)}
    # a hundred readings in a row whose mean is elsewhere than that of the rest
    sums = np.convolve(np.array(off), np.ones(100), "valid") / 100
    at = int(np.argmax(np.abs(sums - np.median(off))))
    rest = np.delete(off, slice(max(at - 5, 0), at + 105))
    assert abs(abs(sums[at] - rest.mean()) - np.radians(40.0)) < np.radians(12.0)


def test_a_kidnapped_robot_is_elsewhere_when_it_sees_again() -> None:
    game = GAMES["kidnapped"](2, 12.0)
    (put_down_ns,) = game.put_down_ns
    assert game.evidence_ns[0] < put_down_ns <= game.evidence_ns[1]
    assert truth_at(game, put_down_ns - 10**9) is None
    assert truth_at(game, put_down_ns) is not None


def test_calibration_is_what_was_told_against_how_often_it_was_true() -> None:
    told = np.array([0.05, 0.05, 0.95, 0.95, 0.5, 0.5])
    true = np.array([False, False, True, True, True, False])
    assert expected_calibration_error(told, true) == pytest.approx(4 * 0.05 / 6)
    assert expected_calibration_error(told, ~true) == pytest.approx(4 * 0.95 / 6)
    assert expected_calibration_error(np.array([1.0]), np.array([True])) == 0.0
    assert np.isnan(expected_calibration_error(np.zeros(0), np.zeros(0, dtype=np.bool_)))
    assert list(reliability(told, true)) == [
        ("0.0 to 0.1", "2", "0.050", "0.000"),
        ("0.5 to 0.6", "2", "0.500", "0.500"),
        ("0.9 to 1.0", "2", "0.950", "1.000"),
    ]


def test_right_is_who_stays_so_for_a_second() -> None:
    game = GAMES["no compass"](0, 8.0)
    moments = watched(game)
    since_ns = moments[0].stamp_ns
    assert first_right_s(moments, since_ns) == pytest.approx(0.0)
    assert first_right_s(watched(game, mirrored_from_s=0.0), since_ns) == np.inf
    assert first_right_s(moments[:5], since_ns) == np.inf
    assert first_right_s(moments, since_ns + 10**9) == pytest.approx(0.0, abs=0.2)
    # half a second right, then wrong
    wrong_first = watched(game, mirrored_from_s=0.0)[:20] + moments[20:]
    assert first_right_s(wrong_first, since_ns) == pytest.approx((moments[20].stamp_ns - since_ns) * 1e-9)


def test_an_estimator_that_does_not_say_how_sure_it_is_is_refused() -> None:
    from estimators.ekf import Ekf

    with pytest.raises(ValueError, match="Ekf does not say how sure it is"):
        watch(GAMES["no compass"](0, 1.0), Ekf, Config())


def test_it_prints_all_of_its_tables() -> None:
    text = run(["--seeds", "1", "--duration", "2"])
    words = ("P(mirrored) from", "wrong seeds", "kidnappings", "expected calibration", "NEES", "failures")
    assert [word for word in words if word not in text] == []
