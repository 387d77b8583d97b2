"""The report's page: one HTML file with everything inside it, nothing loaded from elsewhere."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from logs.report.moments import moments
from logs.results import ScoredLog
from logs.table import Table, log_table, summary_table


@dataclass(frozen=True, slots=True)
class Picture:
    file_name: str
    caption: str
    png: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A log and what was drawn of it."""

    scored: ScoredLog
    pictures: tuple[Picture, ...]


def page(sections: Sequence[Section]) -> str:
    """The whole document."""
    logs = [section.scored for section in sections]
    summary = summary_table(logs)
    names = list(dict.fromkeys(run.run.name for scored in logs for run in scored.runs))
    title = f"{', '.join(names)} on {', '.join(scored.log.log_name for scored in logs)}"
    parts = [
        f"<header><h1>Localization{', compared' if len(names) > 1 else ''}</h1>",
        f"<p>{escape(title)}</p></header>",
        f"<section><h2>All {len(logs)} logs</h2>{_table(summary)}</section>" if summary else "",
        *(_section(section) for section in sections),
        _READING,
    ]
    body = "\n".join(part for part in parts if part)
    return _FRAME.replace("{title}", escape(f"fieldloc: {title}")).replace("{style}", _STYLE).replace("{body}", body)


def _section(section: Section) -> str:
    log = section.scored.log
    facts = [f"{log.duration_s:.1f} s"]
    if log.field is not None:
        facts.append(f"field {log.field.name}, {len(log.field.landmarks)} landmarks")
    facts.append(f"{len(log.truth):,} true poses" if log.truth else "no truth: trajectories only")
    notes = [f"{run.run.name}: {run.note}" for run in section.scored.runs if run.note and log.truth]
    notes += [
        f"{run.run.name}: covariances that are not positive definite, and count as outside 3σ: {c.unusable}"
        for run in section.scored.runs
        if run.metrics and (c := run.metrics.consistency) and c.unusable
    ]
    return "\n".join(
        [
            f"<section><h2>{escape(log.log_name)}</h2>",
            f'<p class="facts">{escape(" · ".join(facts))}</p>',
            _table(log_table(section.scored)),
            *(f'<p class="note">{escape(note)}</p>' for note in notes),
            *(_figure(picture) for picture in section.pictures),
            *(moments(run.run, log.truth) for run in section.scored.runs),
            "</section>",
        ]
    )


def _figure(picture: Picture) -> str:
    data = b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption} <code>{escape(picture.file_name)}</code></figcaption></figure>"
    )


def _table(table: Table) -> str:
    groups = "".join(
        f'<th colspan="{len(list(span))}" scope="colgroup">{escape(group)}</th>'
        for group, span in groupby(group for group, _ in table.headings)
    )
    titles = "".join(f'<th scope="col">{escape(title)}</th>' for _, title in table.headings)
    rows = "".join(
        "<tr>"
        + f'<th scope="row">{escape(row[0].text)}</th>'
        + "".join(f"<td{' class=best' if cell.is_best else ''}>{escape(cell.text)}</td>" for cell in row[1:])
        + "</tr>"
        for row in table.rows
    )
    head = f"<thead><tr>{groups}</tr><tr>{titles}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{rows}</tbody></table></div>'


_FRAME = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""

_STYLE = """
:root { --ink: #1f2328; --soft: #59636e; --line: #d1d9e0; --back: #ffffff; --best: #0b6e4f; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6edf3; --soft: #9198a1; --line: #3d444d; --back: #0d1117; --best: #56d4a4; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.5rem 4rem; max-width: 72rem; color: var(--ink); background: var(--back);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; font-weight: 600; margin: 0; }
h2 { font-size: 1.25rem; font-weight: 600; margin: 2.5rem 0 .2rem; padding-top: 1rem;
  border-top: 1px solid var(--line); }
header p, .facts, figcaption { color: var(--soft); margin: .2rem 0 .8rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .84rem; font-variant-numeric: tabular-nums;
  border-top: 1.5px solid var(--ink); border-bottom: 1.5px solid var(--ink); }
th, td { padding: .28rem .5rem; text-align: right; white-space: nowrap; font-weight: 400; }
th[scope=row], th[scope=col]:first-child { text-align: left; }
th[scope=row] { font-weight: 600; }
thead th { color: var(--soft); }
thead tr:first-child th { text-align: center; padding: .3rem .5rem 0; }
thead tr:first-child th[colspan]:not([colspan="1"])::after { content: ""; display: block;
  border-bottom: 1px solid var(--line); }
thead tr:last-child th { border-bottom: 1px solid var(--ink); }
td.best { font-weight: 700; color: var(--best); }
.note { margin: .5rem 0; padding-left: .7rem; border-left: 3px solid #d55e00; }
figure { margin: 1.4rem 0; }
img { display: block; width: 100%; height: auto; background: #fff; border-radius: 4px; }
figcaption { font-size: .84rem; margin-top: .3rem; }
code { font: .78rem ui-monospace, Menlo, Consolas, monospace; opacity: .8; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1.2rem; font-size: .88rem; }
dt { font-weight: 600; } dd { margin: 0; }
summary { cursor: pointer; margin: .5rem 0; font-size: .88rem; }
@media print { section { break-before: page; } figure { break-inside: avoid; } }
"""

_READING = """<section><h2>How to read this</h2>
<dl>
<dt>ATE</dt><dd>Distance of the estimated from the true position at the same time; nothing is aligned first.</dd>
<dt>RPE over 1 m</dt><dd>RMSE of the motion over each metre of the path: without the error the metre began with.</dd>
<dt>ANEES</dt><dd>Squared error in units of the claimed covariance, mean over 3: 1 is honest, above is too sure, below
too modest. The 95 % band holds for independent errors. Errors of consecutive poses are not independent: the true band
is wider, and a value a little outside is no proof.</dd>
<dt>3 sigma</dt><dd>Share of poses inside the claimed 99.73 % ellipsoid of x, y and heading.</dd>
<dt>known</dt><dd>Share of the truth's time in which there is an estimate.</dd>
<dt>update</dt><dd>Time that one observation takes. A smoother's work is in the total.</dd>
<dt>Field</dt><dd>A 3σ ellipse is that of the position alone and should hold the truth with 98.9 %. Of large ones a few
outlines are drawn.</dd>
<dt>Errors</dt><dd>Shaded: ±3σ as claimed. NEES: x, y and heading together, dashed its 99.73 % quantile. Grey: no
estimate, or no truth to compare with.</dd>
<dt>Hypotheses</dt><dd>Weights of the poses that the robot may have, as the estimator told them while it ran, stacked: a
colour each; light grey: all others; dark grey: it may be anywhere. P(mirrored): that the robot stands where the map's
symmetry takes the estimate to; 0.5: nobody can tell. Marks: moments at which hypotheses began, split, merged, one was
left or one side, and the robot was found elsewhere.</dd>
</dl></section>"""
