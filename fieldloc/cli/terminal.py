"""What a person sees: summaries on stdout, warnings, mistakes and progress on stderr."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from threading import Timer
from typing import Protocol

from logs.progress import Progress, watch

_A_MOMENT_S = 1.0


class Warned(Protocol):
    """Something that learns while it is read what is wrong with it."""

    @property
    def warnings(self) -> tuple[str, ...]: ...


@contextmanager
def warning_of(*logs: Warned) -> Iterator[None]:
    """What is wrong with the logs is said in the end, all the more when it ends badly."""
    try:
        yield
    finally:
        for log in logs:
            warn(log.warnings)


def warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        print(f"fieldloc: warning: {sentence}", file=sys.stderr)


def fail(text: str) -> int:
    """One line for a mistake; the exit code of one."""
    print(f"fieldloc: {' '.join(text.splitlines())}", file=sys.stderr)
    return 1


def say(options: argparse.Namespace, text: str) -> None:
    """A summary, for who wants one."""
    if not options.quiet:
        print(text, flush=True)


@contextmanager
def patience(options: argparse.Namespace, why: str) -> Iterator[None]:
    """Says why nothing happens, if it takes more than a moment."""
    late = Timer(_A_MOMENT_S, lambda: None if options.quiet else print(f"fieldloc: {why}", file=sys.stderr, flush=True))
    late.start()
    try:
        yield
    finally:
        late.cancel()
        late.join()


def bar(options: argparse.Namespace, what: str) -> AbstractContextManager[Progress]:
    return watch(what, None if options.quiet else sys.stderr)
