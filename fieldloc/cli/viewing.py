"""view: a log, or an estimator at work on it, to look at."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fieldloc.cli.commands import RUNS, Commands, positive, seconds_from_start
from fieldloc.cli.localize import ONLINE, add_estimation_options, settings
from fieldloc.cli.reading import add_meaning_options, open_log
from fieldloc.cli.terminal import bar, say, warn, warning_of
from fieldloc.errors import FieldlocError
from logs.progress import Progress
from logs.reader import LogFile

if TYPE_CHECKING:
    from logs.results import LogResult

_OPENED = Path("runs")  # stands for a page that is named after the log
_SEGMENTS = 40_000  # of what was seen, in a page: some megabytes at most


def add_commands(commands: Commands) -> None:
    """view."""
    what, example = "A log to look at: in Foxglove, in Lichtblick, or as a page", "view best.mcap"
    sub = commands.add("view", _view, what, example)
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="several are read as one; runs in one page")
    sub.add_argument("--estimator", choices=ONLINE, help="what this estimator makes of the log, while it is played")
    add_estimation_options(sub)
    sub.add_argument(
        "--html",
        nargs="?",
        type=Path,
        const=_OPENED,
        metavar="FILE.html",
        help="a page that plays in any browser; without FILE it is runs/LOG.html, and opened",
    )
    sub.add_argument("--truth", type=Path, metavar="LOG", help="page: the log with the truth")
    sub.add_argument("--host", default="127.0.0.1", help="server: where to listen; default: %(default)s")
    sub.add_argument("--port", type=_port, default=8765, help="server: 0 takes any; default: %(default)s")
    sub.add_argument("--rate", type=positive, default=1.0, metavar="X", help="server: times real time")
    sub.add_argument(
        "--from", dest="begin_s", type=seconds_from_start, default=0.0, metavar="S", help="server: begin here"
    )
    sub.add_argument("--loop", action="store_true", help="server: from the end back to the beginning")
    sub.add_argument("--now", action="store_true", help="server: play at once, not when the first viewer looks")
    add_meaning_options(sub)


def _view(options: argparse.Namespace) -> None:
    if options.html:
        _page(options)
    else:
        _serve(options)


def _serve(options: argparse.Namespace) -> None:
    from estimators.registry import ALL
    from logs.recording import load_recording
    from logs.replay import Run
    from logs.viewing.server import Address, ServeOptions, serve

    log, run = open_log(options, options.logs), None
    config, field = settings(options)
    with warning_of(log):
        if options.estimator:
            with bar(options, "reading") as progress:
                recording = load_recording(log, field, progress)
            run = Run(recording, ALL[options.estimator](config), options.start, config)
            warn(recording.warnings)

        def ready(address: Address) -> None:
            say(options, f"serving {address.websocket} until Ctrl-C; open it in Foxglove or Lichtblick, or")
            say(options, f"  {address.foxglove}")
            say(options, f"  {address.lichtblick}")

        listening = ServeOptions(
            options.host, options.port, options.rate, options.begin_s, options.loop, wait=not options.now
        )
        try:
            serve(log, listening, ready, run)
        except KeyboardInterrupt as interrupt:
            if interrupt.args:  # SIGTERM: whoever sent it wants to see it
                raise
            say(options, "closed")


def _page(options: argparse.Namespace) -> None:
    from logs.output import output_file
    from logs.viewing.observations import load_seen
    from logs.viewing.page import load_view, open_in_browser, write_page

    truth = [options.truth] if options.truth else []
    is_opened = options.html is _OPENED
    out = output_file(RUNS / f"{options.logs[0].stem}.html" if is_opened else options.html, *options.logs, *truth)
    logs = [open_log(options, [path]) for path in options.logs]
    true = open_log(options, truth) if truth else None
    _, field = settings(options)
    with warning_of(*logs, *([true] if true else [])), bar(options, "reading") as progress:
        if options.estimator:
            result = _estimated(options, logs, progress)
        else:
            result = load_view(logs, true, field)
        sights = [load_seen(log, _SEGMENTS) for log in (*logs, *([true] if true else []))]
        write_page(out, result, next((seen for seen in sights if len(seen)), None))
    say(options, f"page: {out}")
    if is_opened and not open_in_browser(out):
        say(options, "no browser here: open it in one")


def _estimated(options: argparse.Namespace, logs: list[LogFile], progress: Progress) -> "LogResult":
    from estimators.registry import ALL
    from logs.comparison import compare

    if len(logs) > 1:
        raise FieldlocError(f"--estimator {options.estimator}: takes one LOG for a page, got {len(logs)}")
    config, field = settings(options)
    chosen = {options.estimator: ALL[options.estimator]}
    done = compare(logs[0], chosen, config, field, options.start, progress)
    warn(done.warnings)
    if done.failures:
        raise FieldlocError(done.failures[0])
    return done.scored.log


def _port(text: str) -> int:
    if text.isascii() and text.isdigit() and int(text) < 65536:
        return int(text)
    raise argparse.ArgumentTypeError(f"'{text}' is not a port, 0 to 65535")
