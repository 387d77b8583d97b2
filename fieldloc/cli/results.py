"""evaluate, export, report: what to make of estimates."""

import argparse
import json
from pathlib import Path

from fieldloc.cli.commands import RUNS, Commands, positive
from fieldloc.cli.reading import add_meaning_options, open_log
from fieldloc.cli.terminal import bar, say, warning_of
from fieldloc.field import load_field
from logs.reader import LogFile


def add_commands(commands: Commands) -> None:
    """evaluate, export, report."""
    sub = commands.add("evaluate", _evaluate, "Estimates against truth", "evaluate best.mcap --truth woods.mcap")
    sub.add_argument("estimates", type=Path, metavar="OUT.mcap")
    sub.add_argument("--truth", type=Path, required=True, metavar="LOG", help="the log with the truth")
    sub.add_argument("--json", action="store_true", help="all numbers, see docs/metrics.md")
    apart = "pair stamps this close; default: %(default)s"
    sub.add_argument("--max-difference-s", type=positive, default=0.01, metavar="S", help=apart)
    add_meaning_options(sub)

    sub = commands.add("export", _export, "Estimates as text", "export best.mcap --format tum")
    sub.add_argument("log", type=Path, metavar="OUT.mcap")
    sub.add_argument("--format", choices=("tum", "csv"), required=True)
    sub.add_argument("--truth", action="store_true", help="the log's truth instead of its estimates")
    sub.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: OUT.tum or OUT.csv")
    add_meaning_options(sub)

    what, example = "What run or smooth wrote, as compare reports it", "report best.mcap --truth woods.mcap"
    sub = commands.add("report", _report, what, example)
    sub.add_argument("results", type=Path, nargs="+", metavar="OUT.mcap", help="several are runs on the same log")
    sub.add_argument("--truth", type=Path, metavar="LOG", help="the log with the truth, if the results do not hold it")
    sub.add_argument("--field", metavar="NAME|FILE", help="a map by name or TOML file instead of the results' own")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: runs/report")
    add_meaning_options(sub)


def _evaluate(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.evaluate import evaluate
    from logs.table_text import format_metrics

    log, truth_log = LogFile(options.estimates), open_log(options, [options.truth])
    with warning_of(log, truth_log), bar(options, "reading"):
        metrics = evaluate(read_estimates(log), read_truth(truth_log), options.max_difference_s)
    print(json.dumps(metrics.to_dict(), indent=1) if options.json else format_metrics(metrics))


def _export(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.export import write_csv, write_tum
    from logs.output import output_file

    log = open_log(options, [options.log])
    out = output_file(options.output or options.log.with_suffix(f".{options.format}"), options.log)
    with warning_of(log), bar(options, "exporting"):
        trajectory = read_truth(log) if options.truth else read_estimates(log)
        out.parent.mkdir(parents=True, exist_ok=True)
        {"tum": write_tum, "csv": write_csv}[options.format](out, trajectory)
    say(options, f"{out}: {len(trajectory)} poses")


def _report(options: argparse.Namespace) -> None:
    from logs.one_run import score_runs
    from logs.output import output_folder
    from logs.report import write_report
    from logs.table_text import format_table

    out = output_folder(options.output or RUNS / "report")
    field = load_field(options.field) if options.field else None
    results = [LogFile(path) for path in options.results]
    truth = open_log(options, [options.truth]) if options.truth else None
    with warning_of(*results, *([truth] if truth else [])), bar(options, "reading"):
        scored = score_runs(results, truth, field)
    with bar(options, "pictures") as progress:
        page = write_report(out, [scored], progress)
    print(format_table([scored]))
    print(f"report: {page}")
