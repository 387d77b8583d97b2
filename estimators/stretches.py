"""Which track the robot was on when: the likeliest ways through a log, by how often robots are carried.

A hidden Markov chain over tracks with a price for each change, solved by Viterbi's recursion, once for each number of
changes. Where the change was is known as well as the tracks differ: between the last observation that fits the earlier
one and the first that fits the later one, it is taken to be in the middle.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.chain import Recorded
from estimators.tracks import Tracks
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LONGEST_GAP_S = 60.0


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


def stories(recorded: Recorded, tracks: Tracks, log_start: FloatArray, log_kidnap: float, most: int) -> list[Story]:
    """The best for each number of changes up to `most`, and each track alone, the likeliest first.

    log_start: (k,) log prior density of a track's pose at the beginning. log_kidnap: of the rate (1/s) of being carried
    times the density of places to be carried to.
    """
    count, seen = tracks.log_evidence.shape
    if not seen:
        return []
    stamps_s = np.array([recorded.stamps_ns[node] for node, _ in recorded.mixtures]) * 1e-9
    gaps_s = np.clip(np.diff(stamps_s, prepend=stamps_s[0]), 1e-6, _LONGEST_GAP_S)
    prices = np.log(gaps_s) + log_kidnap
    score = np.full((most + 1, count), -np.inf)
    score[0] = log_start + tracks.log_evidence[:, 0]
    came_from = np.zeros((seen, most + 1, count), dtype=np.int16)  # -1 stayed, else the track before
    came_from[0] = -1
    for t in range(1, seen):
        before, rows = score[:-1].copy(), np.arange(most)
        best = before.argmax(axis=1)
        others = np.repeat(before[rows, best][:, None], count, axis=1)
        source = np.repeat(best[:, None], count, axis=1)
        before[rows, best] = -np.inf  # no change is one to the same track
        source[rows, best] = before.argmax(axis=1)
        others[rows, best] = before.max(axis=1)
        changed = others + prices[t]
        better = changed > score[1:]
        came_from[t] = -1
        came_from[t, 1:] = np.where(better, source, -1)
        score[1:] = np.where(better, changed, score[1:])
        score += tracks.log_evidence[:, t]
    out = []
    for track in range(count):
        out.append(_told(recorded, tracks, np.full(seen, track), float(score[0, track])))
    for changes in range(1, most + 1):
        track = int(score[changes].argmax())
        if np.isfinite(score[changes, track]):
            way = _traced(came_from, changes, track)
            out.append(_told(recorded, tracks, way, float(score[changes, track])))
    return sorted(out, key=lambda story: -story.log_worth)


def _traced(came_from: NDArray[np.int16], changes: int, track: int) -> IntArray:
    """(t,) the track at each mixture."""
    way = np.zeros(len(came_from), dtype=np.intp)
    for t in range(len(way) - 1, -1, -1):
        way[t] = track
        before = int(came_from[t, changes, track])
        if before >= 0:
            track, changes = before, changes - 1
    return way


def _told(recorded: Recorded, tracks: Tracks, way: IntArray, log_worth: float) -> Story:
    each = np.arange(len(way))
    choices, margins = tracks.choices[way, each], tracks.margins[way, each]
    stamps_ns = np.array(recorded.stamps_ns)
    track_at = np.full(len(stamps_ns), way[0])
    places = np.array([not mixture.by_compass for _, mixture in recorded.mixtures])
    breaks = []
    for change in np.flatnonzero(np.diff(way)) + 1:
        fits = np.flatnonzero(places & (choices >= 0))
        earlier, later = fits[fits < change], fits[fits >= change]
        if not len(later):
            continue
        if not len(earlier):  # nothing spoke for the earlier one
            track_at[:] = way[change]
            continue
        last, first = recorded.mixtures[earlier[-1]][0], recorded.mixtures[later[0]][0]
        middle_ns = 0.5 * (float(stamps_ns[last]) + float(stamps_ns[first]))
        node = min(int(np.searchsorted(stamps_ns, middle_ns, side="right")), first)
        track_at[node:] = way[change]
        breaks.append(max(node, 1))
    poses = tracks.poses[track_at, np.arange(len(stamps_ns))]
    return Story(choices, margins, tuple(sorted(set(breaks))), poses, track_at, log_worth)
