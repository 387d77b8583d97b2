"""The filter's own reading as a track, beside following the robot through the log once more."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import reading, resolve
from estimators.chain import Recorded
from estimators.config import Config
from estimators.modes import ModeSequence
from estimators.resolved import Resolution
from estimators.smoother import Smoother
from estimators.tracks import Seed, Tracks
from fieldloc import pose as se2
from fieldloc.regions import anywhere
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.samples import sample_path

_Asked = tuple[Recorded, tuple[ModeSequence, ...], Seed, int | None, Config]


@pytest.fixture(scope="module")
def asked() -> tuple[_Asked, Tracks, Resolution]:
    """What `read_track` was asked of half a minute in the woods, what it said, and what came of it."""
    calls: list[tuple[_Asked, Tracks | None]] = []

    def noted(
        recorded: Recorded, sequences: tuple[ModeSequence, ...], seed: Seed, told: int | None, config: Config
    ) -> Tracks | None:
        said = reading.read_track(recorded, sequences, seed, told, config)
        calls.append(((recorded, sequences, seed, told, config), said))
        return said

    smoother = Smoother(Config())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resolve, "read_track", noted)
        replay(load_recording(LogFile(sample_path("woods"), end_s=30.0)), smoother)
    ((these, tracks),) = calls
    assert tracks is not None
    assert smoother.resolution is not None
    return these, tracks, smoother.resolution


def test_a_reading_leads_to_the_answer_of_following_the_robot_again(asked: tuple[_Asked, Tracks, Resolution]) -> None:
    (recorded, sequences, _, told, config), _, resolution = asked
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resolve, "read_track", lambda *_: None)
        region = anywhere(load_recording(LogFile(sample_path("woods"), end_s=1.0)).field)
        followed = resolve.resolve(recorded, sequences, region, told, config)
    assert followed is not None
    assert (followed.choices == resolution.choices).all()
    np.testing.assert_allclose(followed.solution.poses, resolution.solution.poses, atol=1e-5)


def test_a_reading_is_near_the_answer_all_the_way(asked: tuple[_Asked, Tracks, Resolution]) -> None:
    _, tracks, resolution = asked
    apart = np.abs(se2.local(tracks.poses[0], resolution.solution.poses)).max(axis=0)
    assert (apart < [0.3, 0.3, 0.2]).all()  # of a filter that did not know what came later


def test_what_came_before_the_seed_is_followed_backwards(asked: tuple[_Asked, Tracks, Resolution]) -> None:
    """As if the filter had known nothing until then."""
    (recorded, (sequence, *_), seed, told, config), tracks, _ = asked
    later = 40
    ids = recorded.mixtures[later][1].solutions().ids
    assert len(ids)
    node = recorded.mixtures[later][0]
    seed = replace(seed, at=later, node=node, choice=int(ids[0]), pose=tracks.poses[0, node])
    choices = sequence.choices.copy()
    choices[:later] = -1
    read = reading.read_track(recorded, [replace(sequence, choices=choices, births=(later,))], seed, told, config)
    assert read is not None
    assert (read.choices[0, :later] == tracks.choices[0, :later]).mean() > 0.9
    assert (np.abs(se2.local(read.poses[0, :node], tracks.poses[0, :node])) < 0.3).all()


def test_a_doubt_is_no_reading(asked: tuple[_Asked, Tracks, Resolution]) -> None:
    (recorded, (sequence, *_), seed, told, config), _, _ = asked
    assert reading.read_track(recorded, [], seed, told, config) is None
    for doubtful in (
        replace(sequence, log_weight=float(np.log(0.6))),
        replace(sequence, births=(*sequence.births, 100)),  # it was found elsewhere
        replace(sequence, births=()),
        replace(sequence, way=None),
    ):
        assert reading.read_track(recorded, [doubtful], seed, told, config) is None
