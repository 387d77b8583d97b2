"""Where the lines of a map meet, and how: L, T or X."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray

_PARALLEL = 1e-6  # sine of the angle between two lines that do not cross


class Crossing(NamedTuple):
    """point: (2,) on the field where the middles of two lines, rows of the map, meet."""

    point: FloatArray
    kind: str
    lines: tuple[int, int]


def crossings_of(field_map: FieldMap) -> list[Crossing]:
    """A line that ends within its own width of another one ends there."""
    out = []
    ways = field_map.lines[:, 1] - field_map.lines[:, 0]
    lengths = np.linalg.norm(ways, axis=-1)
    for i, j in combinations(range(len(ways)), 2):
        area = ways[i, 0] * ways[j, 1] - ways[i, 1] * ways[j, 0]
        if abs(area) < _PARALLEL * lengths[i] * lengths[j]:
            continue
        x, y = field_map.lines[j, 0] - field_map.lines[i, 0]
        shares = (x * ways[j, 1] - y * ways[j, 0]) / area, (x * ways[i, 1] - y * ways[i, 0]) / area
        # how far the crossing is from the nearer end of each, below zero beyond it
        inside = [min(share, 1.0 - share) * lengths[row] for share, row in zip(shares, (i, j), strict=True)]
        if min(inside) < -field_map.line_width_m:
            continue
        through = sum(length > field_map.line_width_m for length in inside)
        out.append(Crossing(field_map.lines[i, 0] + shares[0] * ways[i], "LTX"[through], (i, j)))
    return out
