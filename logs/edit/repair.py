"""A whole file out of what is left of one."""

from pathlib import Path

from logs.edit.copying import Copy, Summary, opened, profile
from logs.output import output_file
from logs.progress import Progress, unwatched
from logs.source import Container
from logs.writer import LogWriter


def repair(source: Container | Path | str, out: Path | str, progress: Progress = unwatched) -> Summary:
    """All that can be read of a damaged or unfinished log, as a whole, indexed MCAP file in the order of log time.

    `lost` says what could not be read; it is empty where there was nothing to repair, and the file is a copy then.
    FieldlocError for a file that is no log at all, or where `out` cannot be written.
    """
    container = opened(source)
    path = output_file(Path(out), container.path)
    sources = container.sources
    with LogWriter(path, profile=profile(sources.values()), signed=False) as writer:
        copy = Copy(container, writer, progress)
        copy.whole()
    return copy.summary(path, (*container.damage, *copy.missing()))
