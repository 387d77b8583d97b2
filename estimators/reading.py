"""The way that the filter ahead has read a log, as a track: where it left no doubt, nothing has to be followed again.

Its poses are a guess and its choices what was seen then. All is solved together afterwards, and what was not sure or
fits badly is chosen anew.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.chain import Recorded
from estimators.config import Config
from estimators.modes import ModeSequence, Way
from estimators.tracks import LEARNT_FROM, Seed, Tracks, follow
from estimators.ways import Ways
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.one_pose import composed
from fieldloc.pose import FloatArray

_SURE = np.log(0.99)


def read_track(
    recorded: Recorded, sequences: Sequence[ModeSequence], seed: Seed, told: int | None, config: Config
) -> Tracks | None:
    """From the seed on what the likeliest reading says, before it what is followed backwards; with no evidence, as
    there is no other track to be compared with. None where the filter had a doubt of where the robot was.

    told: index of the mixture that says where it began, where a pose was told.
    """
    if not sequences or (way := sequences[0].way) is None or sequences[0].log_weight < _SURE:
        return None
    if sequences[0].births != (seed.at,) and (sequences[0].births or told != seed.at):
        return None
    choices, margins, covariances = sequences[0].choices.copy(), way.margins.copy(), way.covariances.copy()
    choices[seed.at], margins[seed.at], covariances[seed.at] = seed.choice, 0.0, seed.covariance
    poses, start = _poses(recorded, way, seed), seed.covariance
    if seed.at > 0:
        known = _learnt_from(recorded, choices, seed)
        first = follow(_until(recorded, known), (replace(seed, hints=seed.hints[:known]),), config)
        here = slice(seed.at)
        choices[here], margins[here] = first.choices[0, here], first.margins[0, here]
        covariances[here], poses[: seed.node] = first.covariances[0, here], first.poses[0, : seed.node]
        start = first.start_covariances[0]
    return Tracks(
        np.zeros((1, len(choices))), choices[None], margins[None], poses[None], covariances[None], start[None]
    )


def _poses(recorded: Recorded, way: Way, seed: Seed) -> FloatArray:
    """(n, 3) from the seed's node on: at mixtures as the filter had them, in between by the odometry as it was thought
    to be at the mixture before."""
    seen_at = {node: index for index, (node, _) in enumerate(recorded.mixtures) if index >= seed.at}
    ways = Ways.of(recorded.motions, np.array(sorted(seen_at), dtype=np.intp))
    poses, calibrations = np.zeros((len(ways.stops), 3)), np.zeros((len(ways.stops), way.calibrations.shape[1]))
    pose, calibration = seed.pose, way.calibrations[seed.at]
    for stop, node in enumerate(ways.stops.tolist()):
        if (index := seen_at.get(node)) is not None:
            pose, calibration = way.poses[index], way.calibrations[index]
        elif node > seed.node:
            pose = composed(pose, ways.stages[stop - 1].calibrated(calibration).before_from_after)
        poses[stop], calibrations[stop] = pose, calibration
    at = ways.since
    changed = (ways.by_calibration @ calibrations[at][..., None])[..., 0]
    return se2.compose(poses[at], se2.retract(ways.moved, changed))


def _learnt_from(recorded: Recorded, choices: IntArray, seed: Seed) -> int:
    """How many mixtures there are up to where what came before the seed is followed from."""
    places = np.array([not mixture.by_compass for _, mixture in recorded.mixtures])
    sights = seed.at + 1 + np.flatnonzero((places & (choices >= 0))[seed.at + 1 :])[:LEARNT_FROM]
    return int(sights[-1]) + 1 if len(sights) else seed.at + 1


def _until(recorded: Recorded, mixtures: int) -> Recorded:
    """The beginning, with so many mixtures."""
    nodes = recorded.mixtures[mixtures - 1][0] + 1
    factors = tuple((node, factor) for node, factor in recorded.factors if node < nodes)
    return Recorded(recorded.stamps_ns[:nodes], recorded.motions[: nodes - 1], factors, recorded.mixtures[:mixtures])
