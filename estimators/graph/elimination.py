"""In what order gtsam eliminates a chain whose poses all know the same few numbers: in time as its length.

gtsam finds its way through a graph by walking from each factor of a variable up to the root of what was eliminated
before. What all factors know comes last, so in a chain that is eliminated from one end to the other each of them walks
over the whole of it, whatever comes of it: a time that grows as the square of the length. Where every second pose goes
first, then every second of those that are left and so on, ways are no longer than the logarithm.
"""

import gtsam
import numpy as np

from fieldloc.mixture import IntArray


def elimination_order(knots: IntArray, knot_count: int, shared: int) -> gtsam.Ordering:
    """Of poses with keys 0 to n - 1, of what they share with the key `shared`, of knots with keys from there on.

    knots: (n,) which knot each pose knows, rising; poses of one knot go before it and the last of them. Without knots
    (`knot_count` 0) each pose is by itself.
    """
    count = len(knots)
    if knot_count == 0:
        knots = np.arange(count)
    last = np.append(knots[1:] != knots[:-1], True)  # of its knot
    level = np.where(last, 1 + _halvings(knots + 1), 0)
    keys, levels, group = np.arange(count), level, knots
    if knot_count:
        each = np.arange(knot_count)
        keys = np.concatenate([keys, shared + 1 + each])
        levels, group = np.concatenate([levels, 1 + _halvings(each + 1)]), np.concatenate([group, each])
    order = np.lexsort((keys, group, levels))
    out = gtsam.Ordering()
    for key in keys[order].tolist():
        out.push_back(key)
    return out


def _halvings(numbers: IntArray) -> IntArray:
    """(n,) how often each number from 1 on can be halved."""
    return np.asarray(np.log2(numbers & -numbers), dtype=np.intp)
