"""import, simulate, info: where logs come from and what is in them."""

import argparse
import json
from functools import partial
from pathlib import Path

from fieldloc.cli.commands import Commands, Parser, image_size, positive, quality, seed
from fieldloc.cli.reading import add_meaning_options, open_log
from fieldloc.cli.terminal import bar, say, warn
from fieldloc.errors import FieldlocError


def add_commands(commands: Commands) -> None:
    """import, simulate, info."""
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

    what, example = "A made-up game as a log, with its truth", "simulate --scenario kidsize-game --seed 3 -o game.mcap"
    sub = commands.add("simulate", _simulate, what, example)
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="default: SCENARIO-SEED.mcap")
    sub.add_argument("--scenario", default="kidsize-game", metavar="NAME|FILE.toml", help="default: %(default)s")
    sub.add_argument("--seed", type=seed, default=0, metavar="N", help="the same seed is the same game")
    sub.add_argument("--duration-s", type=positive, metavar="S", help="in place of the scenario's")
    sub.add_argument(
        "--set", action="append", default=[], metavar="SECTION.NAME=VALUE", help="one setting of the scenario"
    )
    sub.add_argument("--images", action="store_true", help="rendered pictures, in place of what is found in them")
    sub.add_argument("--observations", action="store_true", help="with --images: what a detector finds too")
    sub.add_argument("--image-size", type=image_size, metavar="WxH", help="a camera of fewer pixels, such as 320x240")
    sub.add_argument("--image-hz", type=positive, metavar="HZ", help="in place of the scenario's")
    sub.add_argument("--quality", type=quality, default=90, metavar="Q", help="of JPEG, 1 to 100; default: %(default)s")
    sub.add_argument("--list", action="store_true", help="the scenarios that come with fieldloc, and no game")

    sub = commands.add("info", _info, "What is in a log, and what fieldloc makes of it", "info woods.mcap")
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="several are read as one")
    sub.add_argument("--json", action="store_true", help="all of it, for programs")
    add_meaning_options(sub)


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


def _simulate(options: argparse.Namespace) -> None:
    from logs.output import output_file
    from logs.simulate import SCENARIOS, PictureSettings, load_scenario, simulate, with_camera, with_settings

    if options.list:
        print("\n".join(f"{name:14}{load_scenario(name).about}" for name in SCENARIOS))
        return
    if options.observations and not options.images:
        raise FieldlocError("--observations: what a detector finds is always there without --images")
    scenario = with_settings(load_scenario(options.scenario), options.set)
    if options.image_size or options.image_hz:
        scenario = with_camera(scenario, options.image_size, options.image_hz)
    pictures = PictureSettings(options.quality, options.observations) if options.images else None
    out = output_file(options.output or Path(f"{Path(options.scenario).stem}-{options.seed}.mcap"))
    with bar(options, "simulating") as progress:
        counts = simulate(out, scenario, options.seed, options.duration_s, progress, pictures)
    say(options, f"{out}: " + ", ".join(f"{n} {topic}" for topic, n in sorted(counts.items())))


def _info(options: argparse.Namespace) -> None:
    from logs.info import summarize
    from logs.info_json import summary_document
    from logs.info_text import format_summary

    with bar(options, "reading"):
        log = open_log(options, options.logs)
        summary = summarize(log)
    print(json.dumps(summary_document(summary, log.container), indent=1) if options.json else format_summary(summary))
    warn(summary.warnings)
