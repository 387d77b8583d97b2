"""What a page knows of a run's hypotheses."""

from collections.abc import Sequence

import numpy as np

from estimators.base import Ambiguity, Event
from logs.results import Json, RunResult
from logs.shares import shares
from logs.viewing.arrays import array

NO_COLOUR = 255
"""Of those that are never likely."""

_MOST_EVENTS = 1000  # of those that matter, and of the others
_MATTER = ("start", "decision", "recovery", "carried")


def hypotheses(run: RunResult, origin_ns: int, most: int) -> Json:
    """Up to `most` hypotheses of all times, ends (n,) index behind each time's last, as they are stacked: the oldest
    first. events: time, kind and text. None where the run has no hypotheses."""
    if not run.ambiguities:
        return None
    times = most
    while True:
        drawn = shares(run.ambiguities, times)
        shown = set(drawn.stamps_ns.tolist())
        chosen = [one for one in run.ambiguities if one.stamp_ns in shown]
        if times < 8 or sum(len(one.hypotheses) for one in chosen) <= most:
            break
        times //= 2
    place = {track: i for i, track in enumerate(drawn.tracks.tolist())}
    stacked = [sorted(one.hypotheses, key=lambda h: place.get(h.track, len(place))) for one in chosen]
    rows = [h for several in stacked for h in several]
    colours = [int(drawn.colours[place[h.track]]) if h.track in place else NO_COLOUR for h in rows]
    return {
        "t": array((_stamps(chosen) - origin_ns) / 1e9, "f8"),
        "mirrored": array(np.array([one.mirrored for one in chosen]), "f4"),
        "lost": array(np.array([one.lost for one in chosen]), "f4"),
        "ends": array(np.cumsum([len(several) for several in stacked]), "u4"),
        "pose": array(np.array([h.pose for h in rows]).reshape(-1, 3), "f4"),
        "weight": array(np.array([h.weight for h in rows], dtype=np.float64), "f4"),
        "colour": array(np.array(colours, dtype=np.uint8), "u1"),
        "events": [[(event.stamp_ns - origin_ns) / 1e9, event.kind, event.text] for event in _few(run.events)],
    }


def _stamps(chosen: Sequence[Ambiguity]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([one.stamp_ns for one in chosen], dtype=np.int64)


def _few(events: Sequence[Event]) -> list[Event]:
    out: list[Event] = []
    for matter in (True, False):
        some = [event for event in events if (event.kind in _MATTER) == matter]
        out += some[:: -(-len(some) // _MOST_EVENTS) or 1]
    return sorted(out, key=lambda event: event.stamp_ns)
