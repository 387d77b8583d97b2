"""Who stands where on a robot, and when: the tree of frames that a log's transforms (tf) make.

Each pair of frames has a track: its transforms by stamp. A stretch in which nothing changes is kept as its two ends, so
what stands still costs nothing; numbers are kept as bytes, not as objects (64 bytes a sample).
Between two samples a track is interpolated; before its first and after its last it holds for `max_age_s`. A track that
never changes, and one from a static topic, holds for all times.
"""

from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np

from fieldloc.pose import FloatArray
from logs.foreign.parts import Transform
from logs.foreign.rotations import STILL, Motion, between, compose, inverse, matrix, motion

Pair = tuple[str, str]
"""Parent and child."""

_MAX_AGE_S = 0.25
_LAST_NS = 2**63 - 1
_MAX_SAMPLES = 500_000  # 32 MB; beyond it only what is asked for is kept


def plain(frame: str) -> str:
    """The frame's name without the slash that ROS 1 allowed in front."""
    return frame.strip().lstrip("/")


class Frames:
    """Transforms in, `lookup` out.

    wanted: whether a frame will be looked up; of very many transforms only what connects these is kept. None: all.
    """

    def __init__(self, max_age_s: float = _MAX_AGE_S, wanted: Callable[[str], bool] | None = None) -> None:
        self._max_age_ns = int(max_age_s * 1e9)
        self._wanted = wanted
        self._tracks: dict[Pair, _Track] = {}
        self._neighbours: dict[str, list[str]] = {}
        self._routes: dict[Pair, tuple[tuple[_Track, bool], ...] | None] = {}
        self._refused: Counter[str] = Counter()
        self._parents: dict[str, list[str]] = {}
        self._dropped: set[Pair] = set()
        self._samples = 0
        self._limit = _MAX_SAMPLES

    def add(self, transforms: Iterable[Transform], log_time_ns: int, static: bool = False) -> None:
        """What one message says. A stamp of 0 is the beginning of time, and the log time where that is taken."""
        log_time_ns = min(log_time_ns, _LAST_NS)
        for transform in transforms:
            parent, child = plain(transform.parent), plain(transform.child)
            if not parent or not child or parent == child:
                self._refused["whose frames are no two"] += 1
                continue
            if (parent, child) in self._dropped:
                continue
            value = motion(transform.translation, transform.rotation)
            if value is None:
                self._refused["with NaN or a rotation of length zero"] += 1
                continue
            track = self._tracks.get((parent, child)) or self._new_track(parent, child)
            self._samples += track.add(transform.stamp_ns, log_time_ns, value, static)
        if self._samples > self._limit and self._wanted is not None:
            self._drop_unwanted(self._wanted)

    def __len__(self) -> int:
        """Samples held."""
        return self._samples

    @property
    def names(self) -> tuple[str, ...]:
        """All frames, in the order in which the log names them."""
        return tuple(self._neighbours)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the transforms."""
        out = [f"{count} transforms left out: those {why}" for why, count in self._refused.items()]
        for child, parents in self._parents.items():
            if len(parents) > 1:
                out.append(f"frame {child} has {len(parents)} parents: {', '.join(parents)}")
        return tuple(out)

    def are_connected(self, a: str, b: str) -> bool:
        """Whether there is a way from one to the other at any time."""
        return plain(a) == plain(b) or self._route(plain(a), plain(b)) is not None

    def lookup(self, a: str, b: str, stamp_ns: int) -> tuple[FloatArray, FloatArray] | None:
        """a_from_b at the stamp: rotation (3, 3) and translation (3,). None where the log does not say."""
        found = self.motion(a, b, stamp_ns)
        return None if found is None else (matrix(found.rotation), np.array(found.translation))

    def motion(self, a: str, b: str, stamp_ns: int) -> Motion | None:
        """The same in plain floats."""
        a, b = plain(a), plain(b)
        if a == b:
            return STILL
        route = self._route(a, b)
        if route is None:
            return None
        out = STILL
        for track, down in route:
            step = track.at(stamp_ns, self._max_age_ns)
            if step is None:
                return None
            out = compose(out, step if down else inverse(step))
        return out

    def _new_track(self, parent: str, child: str) -> "_Track":
        track = self._tracks[parent, child] = _Track()
        self._neighbours.setdefault(parent, []).append(child)
        self._neighbours.setdefault(child, []).append(parent)
        self._parents.setdefault(child, []).append(parent)
        self._routes.clear()
        return track

    def _route(self, a: str, b: str) -> tuple[tuple["_Track", bool], ...] | None:
        """The shortest way, edge by edge, each with whether it goes from parent to child. Loops do no harm."""
        if (a, b) not in self._routes:
            path = self._path(a, b)
            self._routes[a, b] = None if path is None else tuple(self._edge(*pair) for pair in pairwise(path))
        return self._routes[a, b]

    def _path(self, a: str, b: str) -> list[str] | None:
        came_from: dict[str, str | None] = {a: None}
        waiting = [a] if a in self._neighbours else []
        for frame in waiting:  # grows on the way: breadth first
            if frame == b:
                path, step = [], came_from[b]
                path.append(b)
                while step is not None:
                    path.append(step)
                    step = came_from[step]
                return path[::-1]
            for neighbour in self._neighbours[frame]:
                if neighbour not in came_from:
                    came_from[neighbour] = frame
                    waiting.append(neighbour)
        return None

    def _edge(self, a: str, b: str) -> tuple["_Track", bool]:
        """Where both frames are given as each other's parent, what is said more often."""
        down, up = self._tracks.get((a, b)), self._tracks.get((b, a))
        if down is not None and (up is None or len(down) >= len(up)):
            return down, True
        assert up is not None  # they are neighbours
        return up, False

    def _drop_unwanted(self, wanted: Callable[[str], bool]) -> None:
        """Forget what is on no way between wanted frames, once the log has named them all."""
        here = [frame for frame in self._neighbours if wanted(frame)]
        kept = {pair for i, a in enumerate(here) for b in here[i + 1 :] for pair in self._pairs_between(a, b)}
        for pair in self._tracks.keys() - kept if kept else ():
            if len(self._tracks[pair]) > 2:
                self._samples -= len(self._tracks[pair])
                del self._tracks[pair]
                self._dropped.add(pair)
                for one, other in (pair, pair[::-1]):
                    self._neighbours[one].remove(other)
        self._routes.clear()
        self._limit = max(_MAX_SAMPLES, 2 * self._samples)

    def _pairs_between(self, a: str, b: str) -> list[Pair]:
        path = self._path(a, b) or []
        return [pair for one, other in pairwise(path) for pair in ((one, other), (other, one))]


class _Track:
    """parent_from_child by stamp."""

    __slots__ = ("_changes", "_sorted", "_stamps", "_static", "_values")

    def __init__(self) -> None:
        self._stamps = array("q")
        self._values = array("d")
        self._static = False
        self._changes = False
        self._sorted = True

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, stamp_ns: int, log_time_ns: int, value: Motion, static: bool) -> int:
        """How many samples more it holds now."""
        count = len(self._stamps)
        if static:
            self._static = True
            del self._stamps[:], self._values[:]
        same = bool(self._stamps) and self._value(-1) == value
        if stamp_ns == 0 and self._stamps and not same:
            stamp_ns = log_time_ns
        if self._stamps and stamp_ns < self._stamps[-1]:
            self._sorted = False
        elif same and len(self._stamps) > 1 and self._value(-2) == value:
            self._stamps[-1] = stamp_ns
            return 0
        self._changes = self._changes or (bool(self._stamps) and not same)
        self._stamps.append(stamp_ns)
        self._values.extend((*value.translation, *value.rotation))
        return len(self._stamps) - count

    def at(self, stamp_ns: int, max_age_ns: int) -> Motion | None:
        if self._static or not self._changes:
            return self._value(-1)
        if not self._sorted:
            self._sort()
        after = bisect_right(self._stamps, stamp_ns)
        if after == 0:
            return self._value(0) if self._stamps[0] - stamp_ns <= max_age_ns else None
        since = stamp_ns - self._stamps[after - 1]
        if after == len(self._stamps):
            return self._value(-1) if since <= max_age_ns else None
        before_value, after_value = self._value(after - 1), self._value(after)
        if since == 0 or before_value == after_value:
            return before_value
        until = self._stamps[after] - stamp_ns
        if min(since, until) > max_age_ns:
            return None
        return between(before_value, after_value, since / (since + until))

    def _value(self, index: int) -> Motion:
        start = 7 * (index % len(self._stamps))
        x, y, z, *rotation = self._values[start : start + 7]
        qx, qy, qz, qw = rotation
        return Motion((x, y, z), (qx, qy, qz, qw))

    def _sort(self) -> None:
        stamps = np.array(self._stamps)
        order = np.argsort(stamps, kind="stable")
        self._stamps = array("q", stamps[order].tobytes())
        self._values = array("d", np.array(self._values).reshape(-1, 7)[order].tobytes())
        self._sorted = True
