"""The discrete choices of a whole log, resolved: where the robot was, on which side, what it saw, when it was carried.

The forward filter's best readings say where the robot may have been. Each such place is followed through the whole
log, forwards and backwards, on each copy of the field; the likeliest ways over these tracks are solved as wholes and
compared by their evidence.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimators.breaks import SURELY, unsure_when, was_carried, was_put_back
from estimators.chain import Recorded
from estimators.chosen import Chosen
from estimators.config import Config
from estimators.copies import Moved
from estimators.joint import Settled, finished, log_evidences, settle, without_kernel
from estimators.lateness import against_odometry, may_be_late, settled_in_time
from estimators.mixture.lost import Lost
from estimators.modes import ModeSequence
from estimators.reading import read_track
from estimators.resolved import Resolution
from estimators.seeds import on_copies, seeds, surest, whole_poses
from estimators.slips import with_slips
from estimators.stretches import Story, put_down_ns, stories
from estimators.surveyed_errors import with_survey
from estimators.tracks import Seed, Tracks, follow
from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from fieldloc.regions import Region

_MAX_PLACES = 8
_MAX_BREAKS = 4
_MAX_CANDIDATES = 5
_UNLIKELY = 50.0  # stories so much (log) less likely than the best are not solved; tracks can be off by half of that
_UNLIKELY_EACH = 0.25  # more of it for each mixture, where a story needs fewer breaks than any that is solved
_ALIKE = 0.02  # a log's stories that differ in fewer of their choices, and in no break, are one when solved
_EXACTLY = 1e-3  # m, rad: places that are each other's copies, on each other's copies
_MAX_WAYS = 20
_SURE = 0.5  # probability of a solution, of its mixture alone, from which it is a place to follow
_ROUNDS = 3
_PER_ROUND = 4
_PASSED = 25.0  # squared Mahalanobis distance
_ONE_PLACE = np.diag([0.05, 0.05, 0.03]) ** 2  # beside what is known: a single sight errs by more than it says
_TOLD_WRONG = np.log(0.01)  # that the robot does not start where it was told
_SPREAD = np.sqrt(3.0) * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])


def resolve(
    recorded: Recorded, sequences: Sequence[ModeSequence], region: Region, told: int | None, config: Config
) -> Resolution | None:
    """sequences: readings of all recorded mixtures. region: where it began; its symmetries are the field's. told: index
    of the mixture that says where it began, where a pose was told.

    None where no mixture holds a whole pose.
    """
    places = seeds(recorded, sequences, told, _MAX_PLACES) or whole_poses(recorded, _MAX_PLACES)
    if not places:
        return None
    first = sequences[0].copy if sequences else 0  # of copies that nothing tells apart, the one reported all along
    copies = np.concatenate([np.zeros((1, 3)), region.symmetries])
    copies = copies[np.argsort(np.arange(len(copies)) != first, kind="stable")]
    anywhere = Lost.within(region, 0.0).anywhere
    told_config, late = config, may_be_late(recorded, config)
    config = against_odometry(config) if late else config
    sure = [seed for share, seed in surest(recorded, anywhere.log_volume) if share * len(copies) > _SURE]
    read = read_track(recorded, sequences, places[0], told, config) if len(copies) == 1 else None
    if read is not None and all(_led_to(seed, read, copies) for seed in sure):
        tracks, begun = read, places[:1]
    else:
        tracks, begun = _followed(recorded, places, copies, config)
        tracks, begun = _with_surest(recorded, tracks, begun, sure, copies, config)
    copy_of = np.array([seed.copy for seed in begun])
    log_start = np.array(
        [
            _log_start(region, anywhere, se2.compose(seed.copy, pose[0]), covariance)
            for seed, pose, covariance in zip(begun, tracks.poses, tracks.start_covariances, strict=True)
        ]
    )
    log_kidnap = float(np.log(config.mixture.kidnaps_per_min / 60.0)) - anywhere.log_volume
    ways = [
        story
        for story in stories(recorded, tracks, copy_of, log_start, log_kidnap, _MAX_BREAKS)
        if recorded.anchored(story.choices, story.breaks)
    ]
    ways = _distinct(ways, copy_of, len(copies))
    if not ways:
        return None
    plain = without_kernel(config)
    logs = [_on_field(recorded, story, begun) for story in ways]
    settled, evidence, chosen = [], [], Chosen()
    if len(logs) > 1:
        settled = [settle(log, story, plain, chosen=chosen) for log, story in logs]
        begins = [_log_start(region, anywhere, one.solution.poses[0], one.solution.covariances[0]) for one in settled]
        evidence = log_evidences([log for log, _ in logs], settled, plain, log_kidnap - SURELY)
        evidence = [one + other for one, other in zip(evidence, begins, strict=True)]
    if stayed := [i for i, one in enumerate(settled) if not was_put_back(logs[i][0], one)]:
        ways, logs = [ways[i] for i in stayed], [logs[i] for i in stayed]
        settled, evidence = [settled[i] for i in stayed], [evidence[i] for i in stayed]
    best = int(np.argmax(evidence)) if evidence else 0
    log, story = logs[best]
    if settled:
        near = settled[best]
        story = replace(
            story,
            choices=near.choices,
            margins=near.margins,
            poses=near.solution.poses,
            breaks=tuple(node for node in near.breaks if was_carried(log, near, node)),
        )
        answer = settle(log, story, config, near, chosen)
    else:
        answer = settle(log, story, config, chosen=chosen)
        settled, evidence = [answer], [0.0]
    log, answer = with_slips(log, story, answer, config, chosen)
    answer = settled_in_time(log, story, answer, told_config, chosen) if late else finished(answer, config)
    answer = unsure_when(log, answer)
    solution = with_survey(log, answer.choices, chosen, answer.chain, answer.solution, told_config)
    stamps_ns = recorded.stamps_ns
    order, ranked = _ranked(settled, np.array(evidence), best)
    return Resolution(
        solution,
        answer.chain,
        answer.choices,
        tuple(put_down_ns(*(stamps_ns[k] for k in recorded.between(answer.choices, node))) for node in answer.breaks),
        tuple(settled[i] for i in order),
        ranked,
        np.exp(ranked - np.logaddexp.reduce(ranked)),
        *_copies(recorded, replace(ways[best], breaks=story.breaks), tracks, log_start, copies),
    )


def _followed(
    recorded: Recorded, places: tuple[Seed, ...], copies: FloatArray, config: Config
) -> tuple[Tracks, tuple[Seed, ...]]:
    """Tracks from all places on all copies. Where nothing tells sides apart, copies are only written down."""
    everywhere = on_copies(places, recorded, copies)
    if not all(mixture.symmetric for _, mixture in recorded.mixtures):
        return follow(recorded, everywhere, config), everywhere
    once = follow(recorded, places, config)
    each = np.repeat(np.arange(len(places)), len(copies))
    return once[each], everywhere


def _with_surest(
    recorded: Recorded,
    tracks: Tracks,
    begun: tuple[Seed, ...],
    sure: list[Seed],
    copies: FloatArray,
    config: Config,
) -> tuple[Tracks, tuple[Seed, ...]]:
    """More tracks from mixtures that tell the place by themselves, and where none of the tracks is at the time."""
    for _ in range(_ROUNDS):
        sure = [seed for seed in sure if not _led_to(seed, tracks, copies)]
        if not sure:
            break
        more, their = _followed(recorded, tuple(sure[:_PER_ROUND]), copies, config)
        tracks, begun, sure = tracks.beside(more), begun + their, sure[_PER_ROUND:]
    return tracks, begun


def _led_to(seed: Seed, tracks: Tracks, copies: FloatArray) -> bool:
    """Whether a track passes the seed's place, on some copy, as well as both are known; what is a hand's breadth apart
    is solved as one."""
    apart = se2.local(se2.compose(copies[:, None], tracks.poses[:, seed.node]), seed.pose)
    spread = tracks.covariances[:, seed.at] + seed.covariance + _ONE_PLACE
    distance = np.sum(apart * np.linalg.solve(spread, apart[..., None])[..., 0], axis=-1)
    return bool((distance < _PASSED).any())


def _log_start(region: Region, anywhere: Region, pose: FloatArray, covariance: FloatArray) -> float:
    """Logarithm of the prior density of a first pose (3,) known up to a covariance (3, 3), robot frame."""
    at = se2.retract(pose, _SPREAD @ np.linalg.cholesky(covariance).T)
    told = float(np.logaddexp.reduce(region.log_density(at)) - np.log(len(at)))
    return float(np.logaddexp(np.log1p(-np.exp(_TOLD_WRONG)) + told, _TOLD_WRONG - anywhere.log_volume))


def _distinct(ways: list[Story], copy_of: FloatArray, copies: int) -> list[Story]:
    """The likely ones that differ in more than in copies, and in more than what solving them puts right.

    copy_of: (k, 3) of each track.
    """
    out: list[Story] = []
    for story in ways[:_MAX_WAYS]:
        simpler = not out or len(story.breaks) < min(len(other.breaks) for other in out)
        unlikely = _UNLIKELY + (_UNLIKELY_EACH * len(story.choices) if simpler else 0.0)
        if any(len(story.breaks) > len(other.breaks) for other in out):
            continue  # breaks that do not even pay for themselves
        if story.log_worth < ways[0].log_worth - unlikely or (len(out) >= _MAX_CANDIDATES and not simpler):
            continue
        poses = se2.compose(copy_of[story.tracks], story.poses)
        for other in out:
            differing = int(np.count_nonzero(story.choices != other.choices))
            apart = np.abs(se2.local(poses, se2.compose(copy_of[other.tracks], other.poses)))
            alike = (
                differing <= _ALIKE * len(story.choices)
                or (story.tracks // copies == other.tracks // copies).all()
                or bool((apart < _EXACTLY).all())
            )
            if story.breaks == other.breaks and alike:
                break
        else:
            out.append(story)
    return out


def _on_field(recorded: Recorded, story: Story, begun: tuple[Seed, ...]) -> tuple[Recorded, Story]:
    """The log and the story with all mixtures as they are on the copies of the field that the story is about."""
    copies = np.array([seed.copy for seed in begun])[story.tracks]
    mixtures = tuple(
        (node, Moved(mixture, copies[node]) if mixture.symmetric and copies[node].any() else mixture)
        for node, mixture in recorded.mixtures
    )
    return replace(recorded, mixtures=mixtures), replace(story, poses=se2.compose(copies, story.poses))


def _ranked(settled: list[Settled], evidence: FloatArray, best: int) -> tuple[list[int], FloatArray]:
    """Rows of different readings, the best first, and their evidence."""
    out: list[int] = []
    for i in np.argsort(-evidence, kind="stable").tolist():
        same = (
            settled[i].breaks == settled[j].breaks and (settled[i].choices == settled[j].choices).all() for j in out
        )
        if not any(same):
            out.append(i)
    return out, evidence[out]


def _copies(
    recorded: Recorded, story: Story, tracks: Tracks, log_start: FloatArray, copies: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of each stretch, the story's copy first: (s, k) probabilities and (s, k, 3) the ways there from the story's."""
    nodes = np.array([node for node, _ in recorded.mixtures])
    place, copy = np.divmod(story.tracks, len(copies))
    # there[g, c]: the copy that symmetry g takes copy c to; a track of the same place is on it
    moved = se2.compose(copies[:, None], copies)
    there = np.abs(se2.local(moved[:, :, None], copies)).sum(axis=-1).argmin(axis=-1)
    order = np.argsort(np.abs(copies).sum(axis=1), kind="stable")
    probabilities = []
    for begin, end in pairwise([0, *story.breaks, len(recorded.stamps_ns)]):
        within = np.flatnonzero((nodes >= begin) & (nodes < end))
        rows = place[nodes[within]] * len(copies) + there[:, copy[nodes[within]]]
        worth = tracks.log_evidence[rows, within].sum(axis=1)
        if begin == 0:
            worth += log_start[place[0] * len(copies) + there[:, copy[0]]]
        probabilities.append(np.exp(worth - np.logaddexp.reduce(worth))[order])
    return np.array(probabilities), np.tile(copies[order], (len(probabilities), 1, 1))
