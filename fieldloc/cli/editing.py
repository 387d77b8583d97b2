"""cut, merge and repair: recordings copied message by message, whatever is in them."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fieldloc.cli.commands import Commands, names
from fieldloc.cli.reading import add_part_options, part
from fieldloc.cli.terminal import bar, say, warn
from fieldloc.errors import FieldlocError
from logs.output import output_file
from logs.reader.container import open_container

if TYPE_CHECKING:
    from logs.edit import Summary


def add_commands(commands: Commands) -> None:
    """cut, merge, repair."""
    what, example = "Some time or some topics of a log", "cut match.mcap --from 60 --to 120 -o minute.mcap"
    sub = commands.add("cut", _cut, what, example)
    sub.add_argument("log", type=Path, metavar="LOG")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="default: LOG-cut.mcap")
    add_part_options(sub)
    patterns = "names or patterns such as '/camera/*', with commas between"
    sub.add_argument("--topics", type=names, metavar="A,B,...", help=f"only these topics: {patterns}")
    sub.add_argument("--without", type=names, default=(), metavar="A,B,...", help="all but these topics")

    what, example = "Several logs as one, in the order of time", "merge match_0.mcap match_1.mcap -o match.mcap"
    sub = commands.add("merge", _merge, what, example)
    sub.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.mcap")
    sub.add_argument(
        "--prefixes", type=_prefixes, default=(), metavar="A,B,...", help="before the topics of each log: robot1,robot2"
    )

    what, example = "What can be read of a broken log, as a whole one", "repair match.mcap -o whole.mcap"
    sub = commands.add("repair", _repair, what, example)
    sub.add_argument("log", type=Path, metavar="LOG")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT.mcap", help="default: LOG-repaired.mcap")


def _cut(options: argparse.Namespace) -> None:
    from logs.edit import cut

    limits_s = part(options)
    if limits_s == (None, None) and not options.topics and not options.without:
        raise FieldlocError("cut: nothing to cut; say which part with --from, --to, --topics or --without")
    out = output_file(options.output or options.log.with_name(f"{options.log.stem}-cut.mcap"), options.log)
    container = open_container(options.log)
    first_ns = container.span_ns[0] if container.span_ns else 0
    start_ns, end_ns = (None if after_s is None else first_ns + round(after_s * 1e9) for after_s in limits_s)
    with bar(options, "cutting") as progress:
        done = cut(container, out, start_ns, end_ns, options.topics, options.without, progress)
    tell(options, done)


def _merge(options: argparse.Namespace) -> None:
    from logs.edit import merge

    out = output_file(options.output, *options.logs)
    with bar(options, "merging") as progress:
        done = merge([open_container(path) for path in options.logs], out, options.prefixes, progress)
    tell(options, done)


def _repair(options: argparse.Namespace) -> None:
    from logs.edit import repair

    out = output_file(options.output or options.log.with_name(f"{options.log.stem}-repaired.mcap"), options.log)
    with bar(options, "repairing") as progress:
        done = repair(open_container(options.log), out, progress)
    tell(options, done)
    if not done.lost:
        say(options, f"{options.log}: nothing was broken")


def tell(options: argparse.Namespace, done: "Summary") -> None:
    warn(done.lost)
    files = f" and {done.attachments} files" if done.attachments else ""
    lasting = f", {(done.span_ns[1] - done.span_ns[0]) * 1e-9:.1f} s" if done.span_ns else ""
    say(options, f"{done.path}: {done.messages} messages{files} on {len(done.counts)} topics{lasting}")
    for note in done.notes:
        say(options, note)


def _prefixes(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))
