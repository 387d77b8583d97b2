"""import, info: logs as they are."""

import argparse
from functools import partial
from pathlib import Path

from fieldloc.cli.commands import Commands, Parser, positive
from fieldloc.cli.terminal import bar, say, warn


def add_commands(commands: Commands) -> None:
    """import, info."""
    woods = "import woods dataset2.mat -o woods.mcap"
    sub = commands.add("import", _import, "A data set to a log", woods)
    sources = sub.add_subparsers(dest="source", metavar="SOURCE", required=True)
    sub = commands.add("woods", _import, "The 'lost in the woods' MATLAB file to a log", woods, sources)
    sub.add_argument("path", type=Path, metavar="FILE.mat")
    _add_import_options(sub, "FILE.mcap")
    utias = "import utias MRCLAM_Dataset6.tar.gz --robot 3"
    sub = commands.add("utias", _import, "One robot of a UTIAS MRCLAM data set to a log", utias, sources)
    sub.add_argument("path", type=Path, metavar="DIR", help="the data set's folder, or its .tar.gz or .zip")
    sub.add_argument("--robot", type=int, required=True, metavar="K", help="1 to 5")
    _add_import_options(sub, "utias-robotK.mcap")

    sub = commands.add("info", _info, "What is in a log", "info woods.mcap")
    sub.add_argument("log", type=Path, metavar="LOG")


def _add_import_options(sub: Parser, default: str) -> None:
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help=f"default: {default}")
    sub.add_argument("--anonymous", action="store_true", help="drop the landmarks' identities")
    sub.add_argument("--max-range-m", type=positive, metavar="R", help="drop landmarks seen from farther away")


def _import(options: argparse.Namespace) -> None:
    from logs.importers import import_utias, import_woods
    from logs.output import output_file

    if options.source == "woods":
        out, load = Path(f"{options.path.stem}.mcap"), partial(import_woods, options.path)
    else:
        out, load = Path(f"utias-robot{options.robot}.mcap"), partial(import_utias, options.path, options.robot)
    out = output_file(options.output or out, options.path)
    with bar(options, "importing") as progress:
        done = load(out, options.anonymous, options.max_range_m, progress=progress)
    warn(done.warnings)
    say(options, f"{done.path}: " + ", ".join(f"{n} {topic}" for topic, n in sorted(done.counts.items())))


def _info(options: argparse.Namespace) -> None:
    from logs.info import summarize
    from logs.info_text import format_summary

    with bar(options, "reading"):
        summary = summarize(options.log)
    print(format_summary(summary))
    warn(summary.warnings)
