"""The command line: the one file that sees every room, prints and exits."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import numpy as np
from tqdm import tqdm

from estimators.base import Estimate
from estimators.config import Config
from estimators.config_file import load_config, with_settings
from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from fieldloc.measurements import Truth
from fieldloc.pose import FloatArray
from logs.trajectory import Trajectory

_RUNS = Path("runs")
_PATIENCE_S = 1.0  # work that is done by then shows no bar
_ONLINE = ("ekf", "particles", "dead-reckoning")
_COMPARED = "dead-reckoning,ekf,particles,smooth"

Progress = Callable[[int, int], None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 when it worked, 1 with one line on stderr when it did not, 130 after Ctrl-C."""
    options = _parser().parse_args(arguments)
    try:
        options.command(options)
    except FieldlocError as error:
        print(f"fieldloc: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("fieldloc: interrupted; nothing unfinished was left behind", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return 0


def _import(options: argparse.Namespace) -> None:
    from logs.importers import import_utias, import_woods

    with _bar(options, "importing") as progress:
        if options.source == "woods":
            out = options.output or Path(f"{options.file.stem}.mcap")
            done = import_woods(options.file, out, options.anonymous, options.max_range_m, progress=progress)
        else:
            out = options.output or Path(f"utias-robot{options.robot}.mcap")
            done = import_utias(
                options.directory, options.robot, out, options.anonymous, options.max_range_m, progress=progress
            )
    _warn(done.warnings)
    _say(options, f"{done.path}: " + ", ".join(f"{n} {topic}" for topic, n in sorted(done.counts.items())))


def _info(options: argparse.Namespace) -> None:
    from logs.info import summarize
    from logs.info_text import format_summary

    summary = summarize(options.log)
    print(format_summary(summary))
    _warn(summary.warnings)


def _run(options: argparse.Namespace) -> None:
    _localize(options, options.estimator)


def _smooth(options: argparse.Namespace) -> None:
    _localize(options, "smooth")


def _localize(options: argparse.Namespace, name: str) -> None:
    from estimators.registry import ALL
    from logs.reader import LogFile
    from logs.replay import load_recording, replay
    from logs.writer import LogWriter

    out = options.output or _RUNS / f"{options.log.stem}-{name}.mcap"
    if out.exists() and options.log.exists() and out.samefile(options.log):
        raise FieldlocError(f"-o {out}: is the log itself; give another file")
    config = _config(options)
    log = LogFile(options.log)
    recording = load_recording(log, load_field(options.field) if options.field else None)
    with _bar(options, name) as progress:
        done = replay(recording, ALL[name](config), options.start, progress)
    metadata = {"estimator": name, "log": options.log.name, "config": json.dumps(asdict(config))}
    with LogWriter(out, metadata) as writer:
        writer.write(log.roles["field"], recording.field, recording.measurements[0].stamp_ns)
        for estimate in done.estimates:
            writer.write(log.roles["estimate"], estimate)
    _warn((*log.warnings, *done.warnings))
    _say(options, f"{out}: {len(done.estimates)} estimates of {name} in {done.total_s:.1f} s")


def _compare(options: argparse.Namespace) -> None:
    from estimators.registry import ALL
    from logs.reader import LogFile
    from logs.replay import load_recording, replay
    from logs.report import write_report
    from logs.results import LogResult, RunResult, score
    from logs.samples import sample_path
    from logs.table_text import format_table
    from logs.trajectory import from_estimates, from_truth

    names = list(dict.fromkeys(options.estimators.split(",")))
    if unknown := [name for name in names if name not in ALL]:
        raise FieldlocError(f"--estimators {options.estimators}: no estimator {unknown[0]}; known: {', '.join(ALL)}")
    config = _config(options)
    if not options.logs:
        _say(
            options, "no log given: comparing on the sample log that ships with fieldloc (a real robot among 17 tubes)"
        )
    scored = []
    for path in options.logs or [sample_path("woods")]:
        log = LogFile(path)
        recording = load_recording(log, load_field(options.field) if options.field else None)
        truth = from_truth(log.records(Truth))
        runs = []
        warnings: dict[str, None] = {}
        for name in names:
            with _bar(options, f"{recording.name} {name}") as progress:
                done = replay(recording, ALL[name](config), options.start, progress)
            runs.append(RunResult(name, from_estimates(done.estimates), done.update_s, done.total_s))
            warnings |= dict.fromkeys(done.warnings)
        _warn((*log.warnings, *warnings))
        scored.append(score(LogResult(recording.name, recording.duration_s, recording.field, truth, tuple(runs))))
    with _bar(options, "pictures") as progress:
        page = write_report(options.output, scored, progress)
    print(format_table(scored))
    print(f"report: {page}")


def _evaluate(options: argparse.Namespace) -> None:
    from logs.evaluate import evaluate
    from logs.reader import LogFile
    from logs.table_text import format_metrics
    from logs.trajectory import from_truth

    truth_log = LogFile(options.truth)
    truth = from_truth(truth_log.records(Truth))
    if not len(truth):
        raise FieldlocError(f"--truth {options.truth}: no usable message on {truth_log.roles['truth']}")
    metrics = evaluate(_estimates(options.estimates), truth, options.max_difference_s)
    print(json.dumps(metrics.to_dict(), indent=1) if options.json else format_metrics(metrics))


def _export(options: argparse.Namespace) -> None:
    from logs.export import write_csv, write_tum
    from logs.reader import LogFile
    from logs.trajectory import from_truth

    out = options.output or options.log.with_suffix(f".{options.format}")
    if options.truth:
        log = LogFile(options.log)
        trajectory = from_truth(log.records(Truth))
        if not len(trajectory):
            raise FieldlocError(f"{options.log}: no usable message on {log.roles['truth']}")
    else:
        trajectory = _estimates(options.log)
    {"tum": write_tum, "csv": write_csv}[options.format](out, trajectory)
    _say(options, f"{out}: {len(trajectory)} poses")


def _estimates(path: Path) -> Trajectory:
    from logs.reader import LogFile
    from logs.trajectory import from_estimates

    log = LogFile(path)
    trajectory = from_estimates(log.records(Estimate))
    _warn(log.warnings)
    if not len(trajectory):
        raise FieldlocError(f"{path}: no usable message on {log.roles['estimate']}; give what run or smooth wrote")
    return trajectory


def _config(options: argparse.Namespace) -> Config:
    return with_settings(load_config(options.config) if options.config else Config(), options.set)


def _warn(warnings: Sequence[str]) -> None:
    for warning in warnings:
        print(f"fieldloc: warning: {warning}", file=sys.stderr)


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.quiet:
        print(text)


@contextmanager
def _bar(options: argparse.Namespace, what: str) -> Iterator[Progress]:
    """A progress bar on stderr for work that takes a while."""
    with tqdm(desc=what, delay=_PATIENCE_S, disable=options.quiet or None, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield progress


def _start_pose(text: str) -> FloatArray:
    try:
        x_m, y_m, heading_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not X,Y,HEADING_DEG, for example -2.5,0,90") from None
    pose = np.array([x_m, y_m, np.radians(heading_deg)])
    if not np.isfinite(pose).all():
        raise argparse.ArgumentTypeError(f"'{text}' holds a value that is not finite")
    return pose


def _metres(text: str) -> float:
    value = float(text)
    if not 0.0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fieldloc",
        description="Where a soccer robot stands: from its log to trajectories with covariances, compared and drawn.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=version("fieldloc"))
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(
        name: str, run: Callable[[argparse.Namespace], None], what: str, example: str
    ) -> argparse.ArgumentParser:
        sub = commands.add_parser(
            name,
            help=f"{what}; {example}",
            description=f"{what[0].upper()}{what[1:]}.",
            epilog=f"example: {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(command=run)
        sub.add_argument("--quiet", action="store_true", help="no progress, no summary; warnings and errors only")
        return sub

    sub = command("import", _import, "a data set to a log", "fieldloc import woods dataset2.mat -o woods.mcap")
    sources = sub.add_subparsers(dest="source", metavar="SOURCE", required=True)
    woods = sources.add_parser("woods", help="the 'lost in the woods' MATLAB file")
    woods.add_argument("file", type=Path, metavar="FILE.mat")
    utias = sources.add_parser("utias", help="a robot of a UTIAS MRCLAM data set: its folder, .tar.gz or .zip")
    utias.add_argument("directory", type=Path, metavar="DIR")
    utias.add_argument("--robot", type=int, required=True, metavar="K", help="1 to 5")
    for source in (woods, utias):
        source.add_argument("-o", "--output", type=Path, metavar="OUT.mcap")
        source.add_argument("--anonymous", action="store_true", help="drop the landmarks' identities")
        source.add_argument("--max-range-m", type=_metres, metavar="R", help="drop landmarks seen from farther away")
        source.add_argument("--quiet", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)

    sub = command("info", _info, "what is in a log", "fieldloc info woods.mcap")
    sub.add_argument("log", type=Path, metavar="LOG")

    sub = command("run", _run, "a log through an online estimator", "fieldloc run woods.mcap --estimator ekf")
    _add_log_options(sub)
    sub.add_argument("--estimator", choices=_ONLINE, default=_ONLINE[0])

    sub = command("smooth", _smooth, "the best trajectory, in hindsight", "fieldloc smooth woods.mcap -o best.mcap")
    _add_log_options(sub)

    sub = command("compare", _compare, "estimators on the same logs: table, pictures, report", "fieldloc compare")
    sub.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="the sample log if none is given")
    sub.add_argument("--estimators", default=_COMPARED, metavar="A,B,...", help=f"default: {_COMPARED}")
    sub.add_argument("-o", "--output", type=Path, default=_RUNS / "compare", metavar="DIR", help="default: %(default)s")
    _add_estimation_options(sub)

    sub = command("evaluate", _evaluate, "estimates against truth", "fieldloc evaluate best.mcap --truth woods.mcap")
    sub.add_argument("estimates", type=Path, metavar="OUT.mcap")
    sub.add_argument("--truth", type=Path, required=True, metavar="LOG", help="the log with the truth")
    sub.add_argument("--json", action="store_true", help="all numbers, see docs/metrics.md")
    sub.add_argument(
        "--max-difference-s",
        type=_metres,
        default=0.01,
        metavar="S",
        help="pair stamps this close; default: %(default)s",
    )

    sub = command("export", _export, "estimates as text", "fieldloc export best.mcap --format tum")
    sub.add_argument("log", type=Path, metavar="OUT.mcap")
    sub.add_argument("--format", choices=("tum", "csv"), required=True)
    sub.add_argument("--truth", action="store_true", help="the log's truth instead of its estimates")
    sub.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: OUT.tum or OUT.csv")
    return parser


def _add_log_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("log", type=Path, metavar="LOG")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="default: runs/LOG-ESTIMATOR.mcap")
    _add_estimation_options(sub)


def _add_estimation_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--field", metavar="NAME|FILE", help="a map by name or TOML file instead of the log's own")
    sub.add_argument(
        "--start",
        type=_start_pose,
        metavar="X,Y,HEADING_DEG",
        help="pose at the first measurement, known to about 0.1 m and 5 deg; found from what is seen if not given",
    )
    sub.add_argument("--config", type=Path, metavar="FILE.toml", help="settings that differ from the defaults")
    sub.add_argument(
        "--set", action="append", default=[], metavar="SECTION.NAME=NUMBER", help="one setting, may be repeated"
    )


if __name__ == "__main__":
    sys.exit(main())
