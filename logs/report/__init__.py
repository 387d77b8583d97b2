"""The report of a comparison or of one run: report.html, pictures, metrics.json. Only this room knows matplotlib."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from logs.atomic import atomic_directory
from logs.report.error_picture import error_picture
from logs.report.field_picture import field_picture
from logs.report.hypotheses_picture import hypotheses_picture
from logs.report.moments import span_ns
from logs.report.page import Picture, Section, page
from logs.report.style import DPI, colours, pictures_style
from logs.results import RunResult, ScoredLog, metrics_document
from logs.trajectory import Trajectory

PAGE, METRICS = "report.html", "metrics.json"


@dataclass(frozen=True, slots=True)
class _Sketch:
    """A picture before it is drawn."""

    file_stem: str
    caption: str
    draw: Callable[[], Figure]


def write_report(
    directory: Path, logs: Sequence[ScoredLog], on_picture: Callable[[int, int], None] = lambda done, total: None
) -> Path:
    """The page's path. The directory is made if needed; all files get there together at the end, or none.

    on_picture is told how many pictures of how many are done. FieldlocError where the directory cannot be written.
    """
    colour_of = colours([run.run.name for scored in logs for run in scored.runs])
    stems = _file_stems([scored.log.log_name for scored in logs])
    sketches = [list(_sketches(scored, stem, colour_of)) for scored, stem in zip(logs, stems, strict=True)]
    done, total = 0, sum(map(len, sketches))
    sections = []
    with atomic_directory(directory) as unfinished, pictures_style():
        for scored, of_log in zip(logs, sketches, strict=True):
            pictures = []
            for sketch in of_log:
                pictures.append(Picture(f"{sketch.file_stem}.png", sketch.caption, _png(sketch.draw())))
                (unfinished / pictures[-1].file_name).write_bytes(pictures[-1].png)
                done += 1
                on_picture(done, total)
            sections.append(Section(scored, tuple(pictures)))
        document = json.dumps(metrics_document(logs), indent=1, allow_nan=False)
        (unfinished / METRICS).write_text(document + "\n", encoding="utf-8")
        (unfinished / PAGE).write_text(page(sections), encoding="utf-8")
    return directory / PAGE


def _sketches(scored: ScoredLog, stem: str, colour_of: Mapping[str, str]) -> Iterator[_Sketch]:
    if scored.runs:
        yield _Sketch(f"{stem}-field", "Trajectories on the field", partial(field_picture, scored, colour_of))
    truth = scored.log.truth
    for run in scored.runs:
        if run.run.ambiguities:
            yield _Sketch(
                f"{stem}-{_plain(run.run.name)}-hypotheses",
                f"{run.run.name}: hypotheses over time",
                partial(_hypotheses, run.run, truth),
            )
        if truth is None or run.errors is None or run.metrics is None:
            continue
        errors, metrics, name = run.errors, run.metrics, run.run.name
        yield _Sketch(
            f"{stem}-{_plain(name)}-errors",
            f"{name}: errors over time",
            partial(error_picture, name, errors, metrics, truth, colour_of[name]),
        )


def _hypotheses(run: RunResult, truth: Trajectory | None) -> Figure:
    return hypotheses_picture(run.name, run.ambiguities, run.events, *span_ns(run, truth))


def _png(figure: Figure) -> bytes:
    out = BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()


def _file_stems(names: Sequence[str]) -> list[str]:
    """Names as files may be called, numbered where two would be called the same."""
    plain = [_plain(name) for name in names]
    return [stem if plain.count(stem) == 1 else f"{i}-{stem}" for i, stem in enumerate(plain, start=1)]


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-") or "log"
