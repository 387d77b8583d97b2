"""Times, and tables of them."""

from collections.abc import Callable, Iterable, Sequence
from time import process_time


def fastest_s(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Processor seconds of each one's fastest run, what is slower was disturbed; they take turns, so that all are."""
    best = [float("inf")] * len(works)
    for _ in range(repeats):
        for i, work in enumerate(works):
            start = process_time()
            work()
            best[i] = min(best[i], process_time() - start)
    return best


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Columns in line, the first to the left and the others to the right."""
    lines = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )
