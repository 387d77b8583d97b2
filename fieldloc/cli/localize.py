"""run, smooth and compare: a log through one estimator or several."""

import argparse
import json
import os
from dataclasses import asdict, replace
from pathlib import Path

from estimators.config import ENGINES, Config
from estimators.config_file import load_config, with_settings
from fieldloc.cli.commands import RUNS, Commands, Parser, start
from fieldloc.cli.reading import add_meaning_options, add_part_options, open_log
from fieldloc.cli.terminal import bar, patience, say, warn, warning_of
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, load_field
from fieldloc.regions import REGIONS

ONLINE = ("mixture", "ekf", "particles", "amcl-style", "bhuman-style", "dead-reckoning")
_COMPARED = "dead-reckoning,ekf,particles,mixture,smooth"


def add_commands(commands: Commands) -> None:
    """run, smooth, compare."""
    sub = commands.add("run", _localize, "A log through an online estimator", "run woods.mcap --estimator mixture")
    _add_result_options(sub, "runs/LOG-ESTIMATOR.mcap")
    sub.add_argument("--estimator", choices=ONLINE, default=ONLINE[0], help="default: %(default)s")
    sub.set_defaults(engine=None)

    sub = commands.add("smooth", _localize, "The best trajectory, in hindsight", "smooth woods.mcap -o best.mcap")
    _add_result_options(sub, "runs/LOG-smooth.mcap")
    engine_help = "what solves for all poses: gtsam, or chain, which is faster and the same (default: graph.engine's)"
    sub.add_argument("--engine", choices=ENGINES, help=engine_help)
    sub.set_defaults(estimator="smooth")

    what, example = "Estimators side by side: a report", "compare woods.mcap --estimators ekf,smooth"
    sub = commands.add("compare", _compare, what, example)
    sub.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="the sample log if none is given")
    sub.add_argument("--estimators", default=_COMPARED, metavar="A,B,...", help="default: %(default)s")
    _add_options(sub, "DIR", "runs/compare")


def add_estimation_options(sub: Parser) -> None:
    """What an estimator needs to know beside the log."""
    sub.add_argument("--field", metavar="NAME|FILE", help="a map by name or TOML file instead of the log's own")
    sub.add_argument(
        "--start",
        type=start,
        metavar="X,Y,HEADING_DEG|REGION",
        help="pose at the first measurement, known to about 0.1 m and 5 deg, or where it is roughly: "
        f"{', '.join(REGIONS)}; found from what is seen if not given",
    )
    sub.add_argument("--config", type=Path, metavar="FILE.toml", help="settings that differ from the defaults")
    sub.add_argument(
        "--set", action="append", default=[], metavar="SECTION.NAME=NUMBER", help="one setting, may be repeated"
    )


def settings(options: argparse.Namespace) -> tuple[Config, FieldMap | None]:
    """What --config, --set and --field say."""
    config = with_settings(load_config(options.config) if options.config else Config(), options.set)
    return config, load_field(options.field) if options.field else None


def _add_options(sub: Parser, output: str, default: str) -> None:
    sub.add_argument("-o", "--output", type=Path, metavar=output, help=f"default: {default}")
    add_estimation_options(sub)
    add_part_options(sub)
    add_meaning_options(sub)


def _add_result_options(sub: Parser, default: str) -> None:
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="several are read as one")
    _add_options(sub, "OUT.mcap", default)
    sub.add_argument("--merge", action="store_true", help="all of the log's own messages into the result too")
    sub.add_argument("--ros2", action="store_true", help="the result for ROS 2 and nobody else")


def _localize(options: argparse.Namespace) -> None:
    from estimators import engines
    from estimators.registry import ALL
    from logs.estimates import write_estimates
    from logs.output import output_file
    from logs.recording import load_recording
    from logs.replay import replay
    from logs.result_streams import clock_offset_ns

    name, first = options.estimator, options.logs[0]
    config, field = settings(options)
    if options.engine is not None:
        config = replace(config, graph=replace(config.graph, engine=options.engine))
    log = open_log(options, options.logs)
    out = output_file(options.output or RUNS / f"{first.stem}-{name}.mcap", *options.logs)
    if name == "smooth":
        with patience(options, "the chain engine is being made ready: once, for up to half a minute"):
            engines.prepare(config)
    with warning_of(log), bar(options, name) as progress:
        recording = load_recording(log, field, progress)
        done = replay(recording, ALL[name](config), options.start, config, progress)
        metadata = {
            "estimator": name,
            "log": os.fsencode(first.name).decode(errors="replace"),
            "config": json.dumps(asdict(config)),
            "total_s": f"{done.total_s:.3f}",
        }
        merge, offset_ns = (log.container, clock_offset_ns(log)) if options.merge else (None, 0)
        unwritten = write_estimates(out, recording, done, metadata, progress, merge, options.ros2, offset_ns)
    warn((*recording.warnings, *done.warnings, *unwritten))
    say(options, f"{out}: {len(done.estimates)} estimates of {name} in {done.total_s:.1f} s")


def _compare(options: argparse.Namespace) -> None:
    from estimators.registry import ALL
    from logs.comparison import compare
    from logs.output import output_folder
    from logs.report import write_report
    from logs.samples import sample_path
    from logs.table_text import format_table

    names = options.estimators.split(",")
    if unknown := [name for name in names if name not in ALL]:
        raise FieldlocError(
            f"--estimators {options.estimators}: no estimator '{unknown[0]}'; there is {', '.join(ALL)}"
        )
    config, field = settings(options)
    out = output_folder(options.output or RUNS / "compare")
    if not options.logs:
        say(options, "no log given: the sample that ships with fieldloc, a real robot among 17 tubes")
    done = []
    for log in [open_log(options, [path]) for path in options.logs or [sample_path("woods")]]:
        with warning_of(log), bar(options, log.path.stem) as progress:
            done.append(compare(log, {n: ALL[n] for n in names}, config, field, options.start, progress))
        warn((*done[-1].warnings, *done[-1].failures))
    if all(len(one.failures) == len(one.scored.runs) for one in done):
        raise FieldlocError("nothing to compare: no estimator has an estimate")
    scored = [one.scored for one in done]
    with bar(options, "pictures") as progress:
        page = write_report(out, scored, progress)
    print(format_table(scored))
    print(f"report: {page}")
