"""A page that plays a result in a browser: one HTML file with everything inside it, nothing loaded from elsewhere."""

import json
import re
import webbrowser
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from logs.atomic import atomic_text
from logs.one_run import load_runs
from logs.reader import LogFile
from logs.results import LogResult
from logs.trajectory import from_truth
from logs.viewing.observations import Seen
from logs.viewing.page_data import Limits, page_document

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # the report's: Okabe and Ito, 2008
_FULL = Limits()
_PAGE = ("frame.html", "style.css")
_SCRIPTS = ("data.js", "state.js", "field.js", "hypotheses.js", "strips.js", "words.js", "controls.js")


def write_page(path: Path, result: LogResult, seen: Seen | None = None, limits: Limits = _FULL) -> None:
    """`seen` is drawn at the pose of the run that is followed. FieldlocError where the file cannot be written."""
    colours = [_COLOURS[i % len(_COLOURS)] for i in range(len(result.runs))]
    text = json.dumps(page_document(result, seen, colours, limits), allow_nan=False, separators=(",", ":"))
    names = ", ".join(run.name for run in result.runs)
    title = f"{names} on {result.log_name}" if names else result.log_name
    folder = resources.files("logs.viewing") / "browser"
    frame, style, *scripts = (
        (folder / name).read_text(encoding="utf-8") for name in ("frame.html", "style.css", *_SCRIPTS)
    )
    parts = {
        "title": escape(title),
        "style": style,
        "data": text.replace("<", "\\u003c"),
        "player": "\n".join(scripts),
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda slot: parts[slot[1]], frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_text(path) as file:
        file.write(page)


def load_view(logs: Sequence[LogFile], truth: LogFile | None = None, field: FieldMap | None = None) -> LogResult:
    """A run for each log that holds estimates, as `load_runs` has them; where none does, the truth alone.

    FieldlocError where there is nothing to draw.
    """
    results = [log for log in logs if log.has(Estimate)]
    if results:
        others = [log for log in logs if log not in results]
        told = truth or next((log for log in others if log.has(Truth)), None)
        maps = [log.field_map() for log in others] if field is None else [field]
        known = next((one for one in maps if one is not None), None)
        return load_runs(results, told, known)
    source = next((log for log in (truth, *logs) if log is not None and log.has(Truth)), None)
    true = None if source is None else from_truth(source.records(Truth))
    if true is None or not len(true):
        names = ", ".join(str(log.path) for log in logs)
        raise FieldlocError(
            f"{names}: neither estimates nor truth to draw; give what fieldloc run or smooth wrote, or name an "
            "estimator with --estimator"
        )
    maps = [field, *(log.field_map() for log in logs)]
    known = next((one for one in maps if one is not None), None)
    duration_s = int(true.stamps_ns[-1] - true.stamps_ns[0]) / 1e9
    return LogResult(logs[0].path.stem, duration_s, known, true, ())


def open_in_browser(path: Path) -> bool:
    """Whether there is a browser to open it in."""
    return webbrowser.open(path.resolve().as_uri())
