"""Which track the robot was on when: the likeliest ways through a log, by how often robots are carried.

A hidden Markov chain over tracks, solved by Viterbi's recursion, once for each number of times that the robot was
carried. A change between tracks that have met costs next to nothing: each may know a part of the same way. Any other
means that the robot was carried, at a price. When it was is known as well as the tracks differ: between the last
observation that fits the earlier one and the first that fits the later one.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Recorded
from estimators.tracks import Tracks
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LONGEST_GAP_S = 60.0
_SEES_AGAIN_NS = 250_000_000
NEAR = np.array([0.6, 0.6, 0.4])  # m, m, rad: nearer tracks are of one robot; it slipped, or sights erred alike
_SLIP = 6.0  # log of how unlikely that is; less than being carried by far
_FLOOR = np.diag([0.05, 0.05, 0.03]) ** 2  # tracks are less alike than they think, as their errors have come to differ
_LOG_CHANGE = 1.0  # what each change costs, lest it be made for nothing


@dataclass(frozen=True, slots=True, eq=False)
class Story:
    """One way to read a log.

    choices: (t,) of solutions, -1 for none, margins as in Tracks; breaks: the nodes to which the robot was carried;
    poses: (n, 3) to start a solver from; tracks: (n,) it was on. log_worth: of its probability, as far as the tracks
    know.
    """

    choices: IntArray
    margins: FloatArray
    breaks: tuple[int, ...]
    poses: FloatArray
    tracks: IntArray
    log_worth: float


def stories(
    recorded: Recorded,
    tracks: Tracks,
    copies: FloatArray,
    log_start: FloatArray,
    log_kidnap: float,
    most: int,
) -> list[Story]:
    """The best for each number of times that the robot was carried, up to `most`, and each track alone, the likeliest
    first.

    copies: (k, 3) symmetry that takes each track to where the robot is. log_start: (k,) log prior density of a track's
    pose at the beginning. log_kidnap: of the rate (1/s) of being carried times the density of places to be carried to.
    """
    count, seen = tracks.log_evidence.shape
    if not seen:
        return []
    if count == 1:  # nowhere to be carried to
        stays, worth = np.zeros(seen, dtype=bool), float(log_start[0] + tracks.log_evidence.sum())
        return [_told(recorded, tracks, np.zeros(seen, dtype=np.intp), stays, worth)]
    nodes = np.array([node for node, _ in recorded.mixtures])
    stamps_s = np.array(recorded.stamps_ns)[nodes] * 1e-9
    gaps_s = np.clip(np.diff(stamps_s, prepend=stamps_s[0]), 1e-6, _LONGEST_GAP_S)
    prices = np.log(gaps_s) + log_kidnap
    met = _met(tracks, se2.compose(copies[:, None], tracks.poses[:, nodes]))
    score = np.full((most + 1, count), -np.inf)
    score[0] = log_start + tracks.log_evidence[:, 0]
    came_from = np.tile(np.arange(count, dtype=np.int16), (seen, most + 1, 1))
    carried = np.zeros((seen, most + 1, count), dtype=bool)
    for t in range(1, seen):
        before = score
        if t in met:
            by_meeting = before[:, :, None] + met[t]
            source = by_meeting.argmax(axis=1)
            score = np.take_along_axis(by_meeting, source[:, None], axis=1)[:, 0]
            came_from[t] = np.where(np.isfinite(score), source, came_from[t])
        fewer, rows = before[:-1].copy(), np.arange(most)
        best = fewer.argmax(axis=1)
        others = np.repeat(fewer[rows, best][:, None], count, axis=1)
        source = np.repeat(best[:, None], count, axis=1)
        fewer[rows, best] = -np.inf  # no change is one to the same track
        source[rows, best] = fewer.argmax(axis=1)
        others[rows, best] = fewer.max(axis=1)
        changed = others + prices[t]
        carried[t, 1:] = changed > score[1:]
        came_from[t, 1:] = np.where(carried[t, 1:], source, came_from[t, 1:])
        score = np.concatenate([score[:1], np.maximum(score[1:], changed)]) + tracks.log_evidence[:, t]
    stays = np.zeros(seen, dtype=bool)
    alone = log_start + tracks.log_evidence.sum(axis=1)
    out = [_told(recorded, tracks, np.full(seen, track), stays, float(alone[track])) for track in range(count)]
    for changes in range(most + 1):
        track = int(score[changes].argmax())
        if np.isfinite(score[changes, track]):
            way, breaks = _traced(came_from, carried, changes, track)
            out.append(_told(recorded, tracks, way, breaks, float(score[changes, track])))
    return sorted(out, key=lambda story: -story.log_worth)


def put_down_ns(before_ns: int, after_ns: int) -> int:
    """When a robot was put elsewhere that was last seen to be in one place and first seen to be in another.

    The middle, but for a gap so long that it will have been carried all the while: who is carried sees nothing.
    """
    return max((before_ns + after_ns) // 2, after_ns - _SEES_AGAIN_NS)


def _met(tracks: Tracks, poses: FloatArray) -> dict[int, FloatArray]:
    """By mixture, (k, k) logarithm of how well one track goes on as another, for those at which two have met.

    poses: (k, t, 3) where the robot is at each mixture. It is the same robot then, whichever track tells of it.
    """
    count = len(poses)
    out: dict[int, FloatArray] = {}
    for one, other in combinations(range(count), 2):
        apart = se2.local(poses[one], poses[other])
        near = np.flatnonzero(np.all(np.abs(apart) < NEAR, axis=1))
        spread = tracks.covariances[one, near] + tracks.covariances[other, near] + _FLOOR
        distance = np.sum(apart[near] * np.linalg.solve(spread, apart[near][..., None])[..., 0], axis=1)
        for t, log_fit in zip(near.tolist(), (-np.minimum(0.5 * distance, _SLIP) - _LOG_CHANGE).tolist(), strict=True):
            if t not in out:
                out[t] = np.full((count, count), -np.inf)
                np.fill_diagonal(out[t], 0.0)
            out[t][one, other] = out[t][other, one] = log_fit
    return out


def _traced(
    came_from: NDArray[np.int16], carried: NDArray[np.bool_], changes: int, track: int
) -> tuple[IntArray, NDArray[np.bool_]]:
    """(t,) the track at each mixture, and whether the robot was carried there just before."""
    way, breaks = np.zeros(len(came_from), dtype=np.intp), np.zeros(len(came_from), dtype=bool)
    for t in range(len(way) - 1, -1, -1):
        way[t], breaks[t] = track, carried[t, changes, track]
        track, changes = int(came_from[t, changes, track]), changes - int(breaks[t])
    return way, breaks


def _told(recorded: Recorded, tracks: Tracks, way: IntArray, carried: NDArray[np.bool_], log_worth: float) -> Story:
    each = np.arange(len(way))
    choices, margins = tracks.choices[way, each], tracks.margins[way, each]
    stamps_ns = np.array(recorded.stamps_ns)
    track_at = np.full(len(stamps_ns), way[0])
    places = np.array([not mixture.by_compass for _, mixture in recorded.mixtures])
    breaks = []
    for change in np.flatnonzero(np.diff(way)) + 1:
        if not carried[change]:
            track_at[recorded.mixtures[change][0] :] = way[change]
            continue
        fits = np.flatnonzero(places & (choices >= 0))
        earlier, later = fits[fits < change], fits[fits >= change]
        if not len(later):
            continue
        if not len(earlier):  # nothing spoke for the earlier one
            track_at[:] = way[change]
            continue
        last, first = recorded.mixtures[earlier[-1]][0], recorded.mixtures[later[0]][0]
        when_ns = put_down_ns(int(stamps_ns[last]), int(stamps_ns[first]))
        node = min(int(np.searchsorted(stamps_ns, when_ns, side="right")), first)
        track_at[node:] = way[change]
        breaks.append(max(node, 1))
    poses = tracks.poses[track_at, np.arange(len(stamps_ns))]
    return Story(choices, margins, tuple(sorted(set(breaks))), poses, track_at, log_worth)
