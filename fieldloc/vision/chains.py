"""White runs that follow each other from one scan line to the next: the pieces that lines and circles are made of."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.turf import Mask
from fieldloc.vision.white import SCAN_STEP_PX, Runs

_STEEPEST = 1.3  # along the scan line for one across; steeper pieces are found by the other scan lines
_WIDTHS = 2.5  # ratio of the widths of two runs of one line
_MOST = 400  # chains
_SKIPPED = 3  # scan lines that a chain may miss, less than `SCAN_GAP`


def link(runs: Runs) -> NDArray[np.intp]:
    """(n,) the number of the chain each run is in. Every run has one predecessor and one successor at most."""
    count = len(runs.scan)
    after, before = np.full(count, -1), np.full(count, -1)
    # One sorted key for (scan line, place): neighbours in another scan line are found by bisection for all at once.
    stride = 1e6
    middle, width = runs.middle_px, runs.last_px - runs.first_px
    spot = runs.scan * stride + middle
    order = np.argsort(spot, kind="stable")
    keys = spot[order]
    for skip in range(1, _SKIPPED + 1):
        wanted = spot + skip * stride
        place = np.searchsorted(keys, wanted)
        upper = np.minimum(place, count - 1)
        lower = np.maximum(place, 1) - 1
        nearer = np.abs(keys[lower] - wanted) <= np.abs(keys[upper] - wanted)
        best = order[np.where(nearer, lower, upper)]
        away = np.abs(spot[best] - wanted)
        ratio = width[best] / width
        fits = (away <= _STEEPEST * SCAN_STEP_PX * skip) & (ratio < _WIDTHS) & (ratio > 1.0 / _WIDTHS)
        fits &= (after < 0) & (before[best] < 0)
        # Of several that want the same successor the nearest has it.
        wanting = np.flatnonzero(fits)
        wanting = wanting[np.argsort(-away[wanting], kind="stable")]
        before[best[wanting]] = wanting
        held = before[best[wanting]] == wanting
        after[wanting[held]] = best[wanting[held]]
    return _roots(before)


def _roots(before: NDArray[np.intp]) -> NDArray[np.intp]:
    """The first run of every run's chain, by doubling the steps back."""
    root = np.where(before < 0, np.arange(len(before)), before)
    while not np.array_equal(further := root[root], root):
        root = further
    return root


def chains_of(runs: Runs) -> tuple[list[FloatArray], list[FloatArray]]:
    """Every chain of two runs or more, those of scan lines down the picture and those of scan lines across it, as
    (m, 3): u, v of the runs' middles and their width, in scan order; of more than anyone paints the longest."""
    if len(runs.scan) == 0:
        return [], []
    roots = link(runs)
    order = np.lexsort((runs.scan, roots))
    borders = [0, *(np.flatnonzero(np.diff(roots[order])) + 1).tolist(), len(order)]
    table = np.column_stack([*runs.pixels(runs.middle_px), runs.last_px - runs.first_px])[order]
    spans = [(begin, end) for begin, end in pairwise(borders) if end - begin >= 2]
    last_down = np.count_nonzero(runs.down)  # chains are in the order of their first runs
    down, across = (
        sorted(sorted(some, key=lambda span: span[0] - span[1])[:_MOST])
        for some in ([span for span in spans if span[0] < last_down], [span for span in spans if span[0] >= last_down])
    )
    return [table[begin:end] for begin, end in down], [table[begin:end] for begin, end in across]


def parts(chains: list[FloatArray], masks: list[Mask], wanted: bool) -> list[FloatArray]:
    """The parts of chains where their masks are as wanted."""
    out = []
    for chain, mask in zip(chains, masks, strict=True):
        borders = [0, *(np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist(), len(mask)]
        out += [chain[begin:end] for begin, end in pairwise(borders) if mask[begin] == wanted]
    return out
