"""evaluate, export: what to make of estimates."""

import argparse
import json
from pathlib import Path

from fieldloc.cli.commands import Commands, positive
from fieldloc.cli.terminal import bar, say, warning_of
from logs.reader import LogFile


def add_commands(commands: Commands) -> None:
    """evaluate, export."""
    sub = commands.add("evaluate", _evaluate, "Estimates against truth", "evaluate best.mcap --truth woods.mcap")
    sub.add_argument("estimates", type=Path, metavar="OUT.mcap")
    sub.add_argument("--truth", type=Path, required=True, metavar="LOG", help="the log with the truth")
    sub.add_argument("--json", action="store_true", help="all numbers, see docs/metrics.md")
    apart = "pair stamps this close; default: %(default)s"
    sub.add_argument("--max-difference-s", type=positive, default=0.01, metavar="S", help=apart)

    sub = commands.add("export", _export, "Estimates as text", "export best.mcap --format tum")
    sub.add_argument("log", type=Path, metavar="OUT.mcap")
    sub.add_argument("--format", choices=("tum", "csv"), required=True)
    sub.add_argument("--truth", action="store_true", help="the log's truth instead of its estimates")
    sub.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: OUT.tum or OUT.csv")


def _evaluate(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.evaluate import evaluate
    from logs.table_text import format_metrics

    log, truth_log = LogFile(options.estimates), LogFile(options.truth)
    with warning_of(log, truth_log), bar(options, "reading"):
        metrics = evaluate(read_estimates(log), read_truth(truth_log), options.max_difference_s)
    print(json.dumps(metrics.to_dict(), indent=1) if options.json else format_metrics(metrics))


def _export(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.export import write_csv, write_tum
    from logs.output import output_file

    log = LogFile(options.log)
    out = output_file(options.output or options.log.with_suffix(f".{options.format}"), options.log)
    with warning_of(log), bar(options, "exporting"):
        trajectory = read_truth(log) if options.truth else read_estimates(log)
        out.parent.mkdir(parents=True, exist_ok=True)
        {"tum": write_tum, "csv": write_csv}[options.format](out, trajectory)
    say(options, f"{out}: {len(trajectory)} poses")
