"""Games made up from a scenario and a seed, as logs with exact truth."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from logs.progress import Progress, unwatched
from logs.simulate.game import BEGIN_NS, play
from logs.simulate.pictures import PictureSettings, with_camera
from logs.simulate.scenario import SCENARIOS, Scenario, load_scenario, with_settings
from logs.simulate.topics import SIMULATION, messages, messages_with_pictures, simulation_metadata
from logs.source import Encoded
from logs.writer import LogWriter

__all__ = [
    "SCENARIOS",
    "SIMULATION",
    "PictureSettings",
    "Scenario",
    "load_scenario",
    "simulate",
    "with_camera",
    "with_settings",
]

_PROGRESS_EVERY = 1000


def simulate(
    path: Path,
    scenario: Scenario,
    seed: int,
    duration_s: float | None = None,
    progress: Progress = unwatched,
    pictures: PictureSettings | None = None,
) -> dict[str, int]:
    """Write a game as a log; the same scenario, seed and duration make the same bytes. Returns message counts by topic.

    duration_s: in place of the scenario's. pictures: None: only what a detector finds in them. FieldlocError where
    field, duration or seed cannot be used, or the file not be written.
    """
    if seed < 0:
        raise FieldlocError(f"seed: needs to be at least 0, got {seed}")
    if duration_s is not None:
        try:
            scenario = replace(scenario, duration_s=duration_s)
        except ValueError as error:
            raise FieldlocError(str(error)) from None
    field = load_field(scenario.field)
    progress(0, 0, "playing")
    game = play(scenario, field, seed)
    counts: Counter[str] = Counter()
    every = _PROGRESS_EVERY if pictures is None else 1
    with LogWriter(path) as log:
        log.add_metadata(SIMULATION, simulation_metadata(game, seed))
        told = messages(game) if pictures is None else messages_with_pictures(game, pictures)
        for done, message in enumerate(told):
            if isinstance(message, Encoded):
                log.add_encoded(message)
                counts[message.source.topic] += 1
            else:
                log.write(message.topic, message.record, message.log_time_ns)
                counts[message.topic] += 1
            if done % every == 0:
                progress((message.log_time_ns - BEGIN_NS) // 10**6, round(scenario.duration_s * 1000), "playing")
    return dict(counts)
