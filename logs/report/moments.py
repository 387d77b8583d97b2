"""What befell a run's hypotheses, in words, on the time axis of its pictures."""

from html import escape

from logs.results import RunResult
from logs.trajectory import Trajectory

_MATTER = ("start", "decision", "recovery", "carried")
_MOST = 200


def span_ns(run: RunResult, truth: Trajectory | None) -> tuple[int, int]:
    """From the first true pose to the last, as the pictures of errors have it; without truth that of the ambiguities,
    of which the run has some."""
    if truth is not None and len(truth):
        return int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    return int(run.ambiguities[0].stamp_ns), int(run.ambiguities[-1].stamp_ns)


def moments(run: RunResult, truth: Trajectory | None) -> str:
    """A list that opens at a click; empty where nothing is to be told. Splits and merges are in the picture alone."""
    told = [event for event in run.events if event.kind in _MATTER]
    if not told or not run.ambiguities:
        return ""
    begin_ns, _ = span_ns(run, truth)
    rows = [
        f"<dt>{(event.stamp_ns - begin_ns) / 1e9:.2f} s {escape(event.kind)}</dt><dd>{escape(event.text)}</dd>"
        for event in told[:_MOST]
    ]
    head = f"{run.name}: {len(told)} moments" + (f", the first {_MOST}" if len(told) > _MOST else "")
    return f"<details><summary>{escape(head)}</summary><dl>{''.join(rows)}</dl></details>"
