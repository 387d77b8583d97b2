"""One run's hypotheses over time: their weights stacked, P(mirrored) below, and what befell them above."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimators.base import Ambiguity, Event, EventKind
from fieldloc.pose import FloatArray
from logs.report.style import INK, LOST, OTHERS, TRACKS, WIDTH_IN
from logs.shares import Shares, shares

_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.75, 0.1, 0.58, 0.45
_EVENTS_IN, _WEIGHTS_IN, _MIRRORED_IN, _GAP_IN = 0.3, 1.6, 0.75, 0.12
_MOST_MARKS = 400  # of one kind: more cannot be told apart in the picture's width
_NEVER = 1e-6  # a P(mirrored) that never is above means that nothing looks the same


class _Mark(NamedTuple):
    """lane: how high in the strip of events. line: whether it goes through the panels below."""

    marker: str
    colour: str
    lane: float
    line: bool
    size: float


_MARKS: Mapping[EventKind, _Mark] = MappingProxyType(
    {
        "start": _Mark(">", INK, 0.75, True, 5.5),
        "split": _Mark("|", "#0072B2", 0.25, False, 5.0),
        "merge": _Mark("|", "#B0B6BD", 0.5, False, 5.0),
        "decision": _Mark("D", "#009E73", 0.75, True, 4.5),
        "recovery": _Mark("*", "#D55E00", 0.75, True, 8.0),
        "carried": _Mark("*", "#D55E00", 0.75, True, 8.0),
    }
)


def hypotheses_picture(
    name: str, ambiguities: Sequence[Ambiguity], events: Sequence[Event], start_ns: int, end_ns: int
) -> Figure:
    """Of a run with at least one ambiguity; time from start_ns to end_ns."""
    drawn = shares(ambiguities)
    two_sided = bool(np.max(drawn.mirrored) > _NEVER)
    heights_in = [_EVENTS_IN, _WEIGHTS_IN, *([_MIRRORED_IN] if two_sided else [])]
    figure, panels = _panels(heights_in)
    end_s = max(end_ns - start_ns, 1) / 1e9
    # what is known last holds to the end
    t_s = (np.append(drawn.stamps_ns, max(end_ns, int(drawn.stamps_ns[-1]) + 1)) - start_ns) / 1e9
    _draw_weights(panels[1], t_s, drawn)
    if two_sided:
        _draw_mirrored(panels[2], t_s, drawn.mirrored)
    counts = _draw_events(panels, events, start_ns)
    for panel in panels:
        panel.set_xlim(0.0, end_s)
    figure.text(_LEFT_IN / WIDTH_IN, 1 - 0.12 / figure.get_figheight(), f"{name}: {_told(drawn)}", va="top")
    legend = _legend(drawn, counts)
    figure.legend(
        list(legend.values()), list(legend), loc="upper right", ncols=len(legend), handlelength=1.0, columnspacing=1.2,
        bbox_to_anchor=(1.0, 1 - 0.22 / figure.get_figheight()),
    )  # fmt: skip
    panels[-1].set_xlabel("time [s]")
    panels[-1].tick_params(labelbottom=True)
    return figure


def _panels(heights_in: Sequence[float]) -> tuple[Figure, list[Axes]]:
    total_in = _TOP_IN + _BOTTOM_IN + sum(heights_in) + _GAP_IN * (len(heights_in) - 1)
    figure = Figure(figsize=(WIDTH_IN, total_in))
    panels, top_in = [], total_in - _TOP_IN
    for height_in in heights_in:
        bottom_in = top_in - height_in
        width = (WIDTH_IN - _LEFT_IN - _RIGHT_IN) / WIDTH_IN
        axes = figure.add_axes((_LEFT_IN / WIDTH_IN, bottom_in / total_in, width, height_in / total_in))
        axes.tick_params(labelbottom=False)
        panels.append(axes)
        top_in = bottom_in - _GAP_IN
    return figure, panels


def _draw_weights(axes: Axes, t_s: FloatArray, drawn: Shares) -> None:
    """From the bottom: tracks in the order of their beginnings, all others, lost."""
    below = np.concatenate([np.zeros((len(drawn.weights), 1)), np.cumsum(drawn.weights, axis=1)], axis=1)
    for i, (first, last) in enumerate(drawn.lives()):
        _fill(axes, t_s, slice(first, last + 1), below[:, i], below[:, i + 1], TRACKS[drawn.colours[i]])
    everywhere = slice(0, len(below))
    _fill(axes, t_s, everywhere, below[:, -1], below[:, -1] + drawn.rest, OTHERS)
    _fill(axes, t_s, everywhere, 1.0 - drawn.lost, np.ones(len(below)), LOST)
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([0.0, 0.5, 1.0])
    axes.set_ylabel("weights")


def _draw_mirrored(axes: Axes, t_s: FloatArray, mirrored: FloatArray) -> None:
    _fill(axes, t_s, slice(0, len(mirrored)), np.zeros(len(mirrored)), mirrored, "#CC79A755")
    axes.step(t_s, np.append(mirrored, mirrored[-1]), where="post", color="#A8457F", lw=1.0)
    axes.axhline(0.5, color=INK, lw=0.5, ls=(0, (5, 3)))
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([0.0, 0.5, 1.0])
    axes.set_ylabel("P(mirrored)")


def _fill(axes: Axes, t_s: FloatArray, when: slice, low: FloatArray, high: FloatArray, colour: str) -> None:
    """Between two steps (n,) over time (n + 1,): each value holds to the next time."""
    times = t_s[when.start : when.stop + 1]
    low, high = (np.append(side[when], side[when][-1]) for side in (low, high))
    axes.fill_between(times, low, high, step="post", color=colour, lw=0)


def _draw_events(panels: Sequence[Axes], events: Sequence[Event], start_ns: int) -> dict[EventKind, int]:
    strip = panels[0]
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([])
    strip.grid(visible=False)
    strip.spines["left"].set_visible(False)
    strip.spines["bottom"].set_visible(False)
    strip.tick_params(bottom=False)
    counts: dict[EventKind, int] = {}
    for kind, mark in _MARKS.items():
        t_s = np.array([(event.stamp_ns - start_ns) / 1e9 for event in events if event.kind == kind])
        if not len(t_s):
            continue
        counts[kind] = len(t_s)
        shown = t_s[np.unique(np.linspace(0, len(t_s) - 1, _MOST_MARKS).round().astype(np.intp))]
        strip.plot(
            shown, np.full(len(shown), mark.lane), mark.marker, color=mark.colour, ms=mark.size, mew=0.9, clip_on=False
        )
        if mark.line:
            for panel in panels[1:]:
                for t in shown:
                    panel.axvline(t, color=mark.colour, lw=0.9, ls=(0, (2, 2)))
    return counts


def _told(drawn: Shares) -> str:
    """How it ended."""
    best = float(drawn.weights[-1].max()) if drawn.weights.shape[1] else 0.0
    at_the_end = [f"best hypothesis {100 * best:.1f} %"]
    if np.max(drawn.mirrored) > _NEVER:
        at_the_end.append(f"P(mirrored) {drawn.mirrored[-1]:.3f}")
    return "at the end " + ", ".join(at_the_end)


def _legend(drawn: Shares, counts: Mapping[EventKind, int]) -> dict[str, Artist]:
    out: dict[str, Artist] = {}
    for kind, count in counts.items():
        mark = _MARKS[kind]
        label = kind if count == 1 else f"{kind} ({count})"
        out[label] = Line2D([], [], color=mark.colour, marker=mark.marker, ms=mark.size, lw=0)
    if drawn.rest.max() > 0.01:
        out["others"] = Patch(facecolor=OTHERS)
    if drawn.lost.max() > 0.01:
        out["lost"] = Patch(facecolor=LOST)
    return out
