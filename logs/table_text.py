"""A comparison and a single evaluation, for the terminal."""

from collections.abc import Sequence
from itertools import groupby
from math import degrees

from logs.metrics import ErrorStatistics, Metrics, RelativeError
from logs.results import ScoredLog
from logs.table import Table, log_table, summary_table

_GAP = "  "


def format_table(logs: Sequence[ScoredLog]) -> str:
    """Per log its table and what kept a run out of it, then the table over all logs; no newline at the end."""
    blocks = [_log_block(scored) for scored in logs]
    summary = summary_table(logs)
    if summary is not None:
        blocks.append(f"all {len(logs)} logs\n{format_columns(summary)}")
    return "\n\n".join(blocks)


def format_columns(table: Table) -> str:
    """Aligned columns under their headings: the first to the left, numbers to the right, a group over its columns."""
    lines = [[title for _, title in table.headings], *([cell.text for cell in row] for row in table.rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    groups = []
    for group, span in groupby(range(len(widths)), key=lambda i: table.headings[i][0]):
        first, *others = span
        room = sum(widths[i] + len(_GAP) for i in others)
        widths[first] = max(widths[first], len(group) - room)
        groups.append(group.rjust(widths[first] + room))
    aligned = [
        [
            text.rjust(width) if i else text.ljust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    ]
    return "\n".join(_GAP.join(line).rstrip() for line in [groups, *aligned])


def format_metrics(metrics: Metrics) -> str:
    """One evaluation, a line per kind of number; no newline at the end."""
    m = metrics
    lines = [
        f"compared     {m.matched} pairs of {m.estimates} estimates and {m.truths} true poses; "
        f"{100 * m.truth_covered:.1f} % of the truth's time, from {m.time_to_first_estimate_s:.1f} s on",
        f"ATE          {_statistics(m.ate_m, 1.0, 'm')}",
        f"heading      {_statistics(m.heading_rad, degrees(1.0), 'deg')}",
        f"RPE, 1 frame {_relative(m.rpe_frame)}",
        f"RPE, 1 m     {_relative(m.rpe_metre)}",
    ]
    if m.consistency is None:
        return "\n".join([*lines, "ANEES        none: the estimates have no usable covariances"])
    c = m.consistency
    x, y, heading = (f"{100 * share:.2f}" for share in c.within_3sigma_axes)
    lines += [
        f"ANEES        {c.anees:.3g} (1 is honest; 95 % band {c.anees_low:.3f} to {c.anees_high:.3f} "
        f"if the {c.samples} errors were independent)",
        f"in 3 sigma   {100 * c.within_3sigma:.2f} % (x {x}, y {y}, heading {heading}; 99.73 is honest)",
    ]
    if c.unusable:
        lines.append(f"             covariances that are not positive definite, and count as outside: {c.unusable}")
    return "\n".join(lines)


def _log_block(scored: ScoredLog) -> str:
    log = scored.log
    truth = f"{len(log.truth)} true poses" if log.truth else "no truth"
    notes = [f"{run.run.name}: {run.note}" for run in scored.runs if run.note and log.truth]
    return "\n".join([f"{log.log_name}: {log.duration_s:.1f} s, {truth}", format_columns(log_table(scored)), *notes])


def _statistics(s: ErrorStatistics, scale: float, unit: str) -> str:
    named = (("RMSE", s.rmse), ("median", s.median), ("mean", s.mean), ("max", s.max))
    return "  ".join(f"{name} {scale * value:.4f} {unit}" for name, value in named)


def _relative(rpe: RelativeError | None) -> str:
    if rpe is None:
        return "none: the matched path is too short"
    return f"{rpe.translation_rmse_m:.4f} m  {degrees(rpe.rotation_rmse_rad):.4f} deg  RMSE of {rpe.pairs} motions"
