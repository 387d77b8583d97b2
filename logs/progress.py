"""Who watches the work: a person at a terminal, or nobody."""

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO

from tqdm import tqdm

_PATIENCE_S = 1.0  # work that is done by then shows nothing
_CLOCK, _BAR = "{desc} {elapsed}", "{desc} {percentage:3.0f} % {bar} {elapsed}"


class Progress(Protocol):
    """Told now and then how many steps of how many are done, and of what; total 0 where nobody can count them."""

    def __call__(self, done: int, total: int, doing: str = "") -> None: ...


def unwatched(done: int, total: int, doing: str = "") -> None:
    """Nobody watches."""


@contextmanager
def watch(what: str, stream: TextIO | None) -> Iterator[Progress]:
    """A line on the stream, if it is a terminal, from the first second to the end: what is being done and how far.

    Its clock goes on while nobody counts steps.
    """
    if stream is None or not stream.isatty():
        yield unwatched
        return
    over = threading.Event()
    columns, rows = shutil.get_terminal_size()  # some terminals say 0, which is 80 x 24
    line = {"ncols": min(columns, 100), "nrows": rows, "file": stream, "leave": False}
    with tqdm(bar_format=_CLOCK, delay=1, **line) as bar:  # drawn only below

        def progress(done: int, total: int, doing: str = "") -> None:
            bar.n, bar.total, bar.bar_format = done, total, _BAR if total else _CLOCK
            bar.set_description_str(f"{what} {doing}".strip(), refresh=False)

        def draw() -> None:
            while not over.wait(_PATIENCE_S):
                bar.delay = 0  # else tqdm believes to the end that nothing was shown, and leaves it there
                bar.refresh()

        progress(0, 0)
        drawing = threading.Thread(target=draw, daemon=True)
        drawing.start()
        try:
            yield progress
        finally:
            over.set()
            drawing.join()
