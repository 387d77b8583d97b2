"""What looking back tells of a game reaches the results' file."""

from pathlib import Path

import numpy as np
import pytest
from program import Call

from estimators.base import Ambiguity, Event
from fieldloc.measurements import Truth
from logs.reader import LogFile


@pytest.mark.slow
def test_when_a_player_was_carried_is_in_the_results_and_how_sure_its_side_is(tmp_path: Path, call: Call) -> None:
    game, results = tmp_path / "game.mcap", tmp_path / "results.mcap"
    simulated = ("simulate", "--scenario", "kidnapped", "--seed", "3", "--duration-s", "70", "-o", str(game))
    assert call(*simulated).code == 0
    assert call("smooth", str(game), "-o", str(results)).code == 0
    truth = list(LogFile(game).records(Truth))
    moved = np.hypot(*np.diff([one.pose[:2] for one in truth], axis=0).T)
    put_down_ns = truth[int(moved.argmax()) + 1].stamp_ns
    (event,) = LogFile(results).records(Event)
    assert event.kind == "carried"
    assert abs(event.stamp_ns - put_down_ns) < 5e8
    ambiguities = list(LogFile(results).records(Ambiguity))
    assert max(np.diff([one.stamp_ns for one in ambiguities])) < 1e9
    assert ambiguities[-1].mirrored < 0.01
