"""The command line: the one file that sees every room, prints and exits."""

import argparse
import io
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import NoReturn, TypeAlias

import numpy as np

from estimators.config import Config
from estimators.config_file import load_config, with_settings
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, load_field
from fieldloc.pose import FloatArray
from logs.progress import Progress, watch
from logs.reader import LogFile

_RUNS = Path("runs")
_ONLINE = ("ekf", "particles", "dead-reckoning")
_COMPARED = "dead-reckoning,ekf,particles,smooth"
Command = Callable[[argparse.Namespace], None]
Subparsers: TypeAlias = "argparse._SubParsersAction[_Parser]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it worked, 1 with one line on stderr when not, 130 after Ctrl-C and 143 after SIGTERM."""
    if arguments is None and not sys.warnoptions:
        warnings.simplefilter("ignore")  # what a person should know is in our own warnings
    if isinstance(sys.stdout, io.TextIOWrapper):  # a file's name may be what a terminal cannot show
        sys.stdout.reconfigure(errors="backslashreplace")
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        options = _parser().parse_args(_with_minus(sys.argv[1:] if arguments is None else arguments))
        options.command(options)
        print(end="", flush=True)
    except FieldlocError as error:
        return _fail(str(error))
    except KeyboardInterrupt as interrupt:
        _fail("interrupted; nothing unfinished was left behind")
        return 128 + int(interrupt.args[0] if interrupt.args else signal.SIGINT)
    except OSError as error:
        with suppress(OSError, ValueError):  # what is left to be written would fail once more when Python exits
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):  # the reader has seen enough
            return 1
        return _fail(f"{error.filename or 'output'}: {error.strerror or error}")
    finally:
        signal.signal(signal.SIGTERM, before)
    return 0


def _import(options: argparse.Namespace) -> None:
    from logs.importers import import_utias, import_woods
    from logs.output import output_file

    if options.source == "woods":
        out, load = Path(f"{options.path.stem}.mcap"), partial(import_woods, options.path)
    else:
        out, load = Path(f"utias-robot{options.robot}.mcap"), partial(import_utias, options.path, options.robot)
    out = output_file(options.output or out, options.path)
    with _bar(options, "importing") as progress:
        done = load(out, options.anonymous, options.max_range_m, progress=progress)
    _warn(done.warnings)
    _say(options, f"{done.path}: " + ", ".join(f"{n} {topic}" for topic, n in sorted(done.counts.items())))


def _info(options: argparse.Namespace) -> None:
    from logs.info import summarize
    from logs.info_text import format_summary

    with _bar(options, "reading"):
        summary = summarize(options.log)
    print(format_summary(summary))
    _warn(summary.warnings)


def _localize(options: argparse.Namespace) -> None:
    from estimators.registry import ALL
    from logs.estimates import write_estimates
    from logs.output import output_file
    from logs.replay import load_recording, replay

    name = options.estimator
    config, field = _settings(options)
    log = LogFile(options.log)
    out = output_file(options.output or _RUNS / f"{options.log.stem}-{name}.mcap", options.log)
    with _warning(log), _bar(options, name) as progress:
        recording = load_recording(log, field, progress)
        done = replay(recording, ALL[name](config), options.start, config.correlation, progress)
        metadata = {
            "estimator": name,
            "log": os.fsencode(options.log.name).decode(errors="replace"),
            "config": json.dumps(asdict(config)),
        }
        write_estimates(out, recording, done, metadata, progress)
    _warn((*recording.warnings, *done.warnings))
    _say(options, f"{out}: {len(done.estimates)} estimates of {name} in {done.total_s:.1f} s")


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
    config, field = _settings(options)
    out = output_folder(options.output or _RUNS / "compare")
    if not options.logs:
        _say(options, "no log given: the sample that ships with fieldloc, a real robot among 17 tubes")
    done = []
    for log in [LogFile(path) for path in options.logs or [sample_path("woods")]]:
        with _warning(log), _bar(options, log.path.stem) as progress:
            done.append(compare(log, {n: ALL[n] for n in names}, config, field, options.start, progress))
        _warn((*done[-1].warnings, *done[-1].failures))
    if all(len(one.failures) == len(one.scored.runs) for one in done):
        raise FieldlocError("nothing to compare: no estimator has an estimate")
    scored = [one.scored for one in done]
    with _bar(options, "pictures") as progress:
        page = write_report(out, scored, progress)
    print(format_table(scored))
    print(f"report: {page}")


def _evaluate(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.evaluate import evaluate
    from logs.table_text import format_metrics

    log, truth_log = LogFile(options.estimates), LogFile(options.truth)
    with _warning(log, truth_log), _bar(options, "reading"):
        metrics = evaluate(read_estimates(log), read_truth(truth_log), options.max_difference_s)
    print(json.dumps(metrics.to_dict(), indent=1) if options.json else format_metrics(metrics))


def _export(options: argparse.Namespace) -> None:
    from logs.estimates import read_estimates, read_truth
    from logs.export import write_csv, write_tum
    from logs.output import output_file

    log = LogFile(options.log)
    out = output_file(options.output or options.log.with_suffix(f".{options.format}"), options.log)
    with _warning(log), _bar(options, "exporting"):
        trajectory = read_truth(log) if options.truth else read_estimates(log)
        out.parent.mkdir(parents=True, exist_ok=True)
        {"tum": write_tum, "csv": write_csv}[options.format](out, trajectory)
    _say(options, f"{out}: {len(trajectory)} poses")


def _settings(options: argparse.Namespace) -> tuple[Config, FieldMap | None]:
    config = with_settings(load_config(options.config) if options.config else Config(), options.set)
    return config, load_field(options.field) if options.field else None


@contextmanager
def _warning(*logs: LogFile) -> Iterator[None]:
    """What is wrong with the logs is said in the end, all the more when it ends badly."""
    try:
        yield
    finally:
        for log in logs:
            _warn(log.warnings)


def _warn(sentences: Sequence[str]) -> None:
    for warning in sentences:
        print(f"fieldloc: warning: {warning}", file=sys.stderr)


def _fail(text: str) -> int:
    print(f"fieldloc: {' '.join(text.splitlines())}", file=sys.stderr)
    return 1


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.quiet:
        print(text)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)


def _bar(options: argparse.Namespace, what: str) -> AbstractContextManager[Progress]:
    return watch(what, None if options.quiet else sys.stderr)


def _start_pose(text: str) -> FloatArray:
    with suppress(ValueError):
        x_m, y_m, heading_deg = (float(part) for part in text.split(","))
        pose = np.array([x_m, y_m, np.radians(heading_deg)])
        if np.isfinite(pose).all():
            return pose
    raise argparse.ArgumentTypeError(f"'{text}' is not X,Y,HEADING_DEG in numbers, for example -2.5,0,90")


def _positive(text: str) -> float:
    with suppress(ValueError):
        if 0.0 < (value := float(text)) < np.inf:
            return value
    raise argparse.ArgumentTypeError(f"'{text}' is not a number above 0")


def _with_minus(arguments: Sequence[str]) -> list[str]:
    """`--start -2,0,90` as `--start=-2,0,90`: argparse takes what begins with a minus for an option."""
    out: list[str] = []
    for argument in arguments:
        if out and out[-1] == "--start":
            out[-1] += f"={argument}"
        else:
            out.append(argument)
    return out


class _Parser(argparse.ArgumentParser):
    """A wrong command line is told as every other mistake."""

    def error(self, message: str) -> NoReturn:
        raise FieldlocError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="fieldloc",
        description="Where a soccer robot stands: from its log to trajectories with covariances, compared and drawn.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=version("fieldloc"))
    parser.set_defaults(quiet=False)
    common = _Parser(add_help=False, argument_default=argparse.SUPPRESS)  # no default, it would hide an earlier --quiet
    common.add_argument("--quiet", action="store_true", help="no progress, no summary; warnings and errors only")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    examples: dict[str, None] = {}

    def add(name: str, run: Command, what: str, example: str, to: Subparsers = commands) -> _Parser:
        examples[f"fieldloc {example}"] = None
        epilog = f"example: fieldloc {example}"
        sub = to.add_parser(name, help=what, description=f"{what}.", epilog=epilog, parents=[common])
        sub.set_defaults(command=run)
        return sub

    woods = "import woods dataset2.mat -o woods.mcap"
    sub = add("import", _import, "A data set to a log", woods)
    sources = sub.add_subparsers(dest="source", metavar="SOURCE", required=True)
    sub = add("woods", _import, "The 'lost in the woods' MATLAB file to a log", woods, sources)
    sub.add_argument("path", type=Path, metavar="FILE.mat")
    _add_import_options(sub, "FILE.mcap")
    utias = "import utias MRCLAM_Dataset6.tar.gz --robot 3"
    sub = add("utias", _import, "One robot of a UTIAS MRCLAM data set to a log", utias, sources)
    sub.add_argument("path", type=Path, metavar="DIR", help="the data set's folder, or its .tar.gz or .zip")
    sub.add_argument("--robot", type=int, required=True, metavar="K", help="1 to 5")
    _add_import_options(sub, "utias-robotK.mcap")

    sub = add("info", _info, "What is in a log", "info woods.mcap")
    sub.add_argument("log", type=Path, metavar="LOG")

    sub = add("run", _localize, "A log through an online estimator", "run woods.mcap --estimator ekf")
    sub.add_argument("log", type=Path, metavar="LOG")
    _add_estimation_options(sub, "OUT.mcap", "runs/LOG-ESTIMATOR.mcap")
    sub.add_argument("--estimator", choices=_ONLINE, default=_ONLINE[0], help="default: %(default)s")

    sub = add("smooth", _localize, "The best trajectory, in hindsight", "smooth woods.mcap -o best.mcap")
    sub.add_argument("log", type=Path, metavar="LOG")
    _add_estimation_options(sub, "OUT.mcap", "runs/LOG-smooth.mcap")
    sub.set_defaults(estimator="smooth")

    sub = add("compare", _compare, "Estimators side by side: a report", "compare woods.mcap --estimators ekf,smooth")
    sub.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="the sample log if none is given")
    sub.add_argument("--estimators", default=_COMPARED, metavar="A,B,...", help="default: %(default)s")
    _add_estimation_options(sub, "DIR", "runs/compare")

    sub = add("evaluate", _evaluate, "Estimates against truth", "evaluate best.mcap --truth woods.mcap")
    sub.add_argument("estimates", type=Path, metavar="OUT.mcap")
    sub.add_argument("--truth", type=Path, required=True, metavar="LOG", help="the log with the truth")
    sub.add_argument("--json", action="store_true", help="all numbers, see docs/metrics.md")
    apart = "pair stamps this close; default: %(default)s"
    sub.add_argument("--max-difference-s", type=_positive, default=0.01, metavar="S", help=apart)

    sub = add("export", _export, "Estimates as text", "export best.mcap --format tum")
    sub.add_argument("log", type=Path, metavar="OUT.mcap")
    sub.add_argument("--format", choices=("tum", "csv"), required=True)
    sub.add_argument("--truth", action="store_true", help="the log's truth instead of its estimates")
    sub.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: OUT.tum or OUT.csv")

    parser.epilog = "\n  ".join(["examples:", *examples])
    return parser


def _add_import_options(sub: argparse.ArgumentParser, default: str) -> None:
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help=f"default: {default}")
    sub.add_argument("--anonymous", action="store_true", help="drop the landmarks' identities")
    sub.add_argument("--max-range-m", type=_positive, metavar="R", help="drop landmarks seen from farther away")


def _add_estimation_options(sub: argparse.ArgumentParser, output: str, default: str) -> None:
    sub.add_argument("-o", "--output", type=Path, metavar=output, help=f"default: {default}")
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
