"""Where the landmarks really are, by the logs of a robot among them: asked log by log, told as a table and as a map."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimators.chain import Chain
from estimators.config import Config
from estimators.solution import Solution
from estimators.surveyed import Survey
from estimators.surveyed_map import FoundLandmark, SurveyedMap, with_survey_sigma
from estimators.surveyed_sights import sights
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, field_to_toml
from fieldloc.measurements import LandmarkScan
from fieldloc.scan_noises import LearnedNoise
from logs.atomic import atomic_text
from logs.recording import Recording
from logs.table import NOTHING, Cell, Table
from logs.table_text import format_columns


def on_one_map(recordings: Sequence[Recording], sigma_m: float) -> FieldMap:
    """The map of all of them, with sigma_m for the landmarks that it takes as exact. FieldlocError where they have
    different ones, it has no landmarks, or the robot has no ranges to any."""
    first = recordings[0]
    for other in recordings[1:]:
        if field_to_toml(other.field) != field_to_toml(first.field):
            raise FieldlocError(
                f"{other.name}: its map is not that of {first.name}; landmarks are surveyed on one: give --field"
            )
    if not first.field.landmarks:
        raise FieldlocError(f"{first.name}: the map {first.field.name} has no landmarks to survey")
    if not any(isinstance(one, LandmarkScan) for recording in recordings for one in recording.measurements):
        raise FieldlocError(
            f"{first.name}: landmarks are surveyed by ranges and bearings to them, and there are none; images alone do "
            "not do"
        )
    return with_survey_sigma(first.field, sigma_m)


def survey(
    recording: Recording,
    chain: Chain,
    solution: Solution,
    sensors: Sequence[LearnedNoise],
    before: FieldMap,
    config: Config,
) -> Survey | None:
    """Of one log, solved on the recording's map; before, config: what is known of map and robot beforehand. None where
    no landmark was seen. What the compass, images and people say has no part in it."""
    eyes = chain.seen_from(solution.poses, solution.calibration, solution.sensor)
    scans = [one for one in recording.measurements if isinstance(one, LandmarkScan)]
    seen = sights(scans, chain.stamps_ns, eyes, solution.covariances, recording.field, sensors, config.correlation)
    if not len(seen.nodes):
        return None
    common, distortions = np.array([*solution.calibration, *solution.sensor]), [one.distortion for one in sensors]
    return Survey(chain, solution.poses, common, seen, distortions, recording.field.positions, before, config)


def landmark_table(done: SurveyedMap) -> str:
    """For the terminal; no newline at the end."""
    titles = ("landmark", "dx", "dy", "sigma", "sigma before", "unit", "log-likelihood")
    rows = tuple(tuple(map(Cell, _row(one))) for one in done.landmarks)
    text = format_columns(Table(tuple(("", title) for title in titles), rows)).lstrip("\n")
    if not done.told:
        return text
    x_m, y_m, turn_rad = done.common.tolist()
    was_x_m, was_y_m, was_turn_rad = done.prior_common.tolist()
    shift = f"{np.hypot(x_m, y_m):.4f} m (before {np.hypot(was_x_m, was_y_m):.4f})"
    turn = f"{np.degrees(turn_rad):.3f} deg (before {np.degrees(was_turn_rad):.3f})"
    return f"{text}\nof these sigmas, all landmarks have in common: a shift of {shift}, a turn of {turn}"


def write_map(path: Path, done: SurveyedMap, logs: Sequence[str]) -> None:
    """A TOML file that --field takes. It appears whole or not at all."""
    with atomic_text(path) as file:
        file.write(f"# Its landmarks where {', '.join(logs)} say that they are.\n")
        file.write(field_to_toml(done.field))


def _row(one: FoundLandmark) -> tuple[str, ...]:
    before = f"{one.prior_sigma_m:.4f}"
    if not one.told:
        return one.label, NOTHING, NOTHING, "not told", before, "m", NOTHING
    found = f"{one.dx_m:+.4f}", f"{one.dy_m:+.4f}", f"{one.sigma_m:.4f}"
    return one.label, *found, before, "m", f"{one.log_gain:+.1f}"
