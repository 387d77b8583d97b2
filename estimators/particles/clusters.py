"""Where particles crowd: a grid over poses, and groups of cells that touch."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_CELL_M, _CELL_RAD = 0.5, 2 * np.pi / 18  # as in AMCL: half a metre; twenty degrees
_VEIL = 0.02
_WIDE = 1 << 20  # more cells than any field has, along one axis
# half of a cell's neighbours, the others are the neighbours of those
_BESIDE = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])[14:]


def cells(poses: FloatArray, reference: FloatArray, cell_m: float, cell_rad: float) -> IntArray:
    """(n, 3) of each pose. The grid is that of the reference pose: moving everything moves the grid along."""
    beside = se2.between(reference, poses)
    turns = round(2 * np.pi / cell_rad)
    out = np.floor(beside / [cell_m, cell_m, cell_rad] + 0.5).astype(np.intp)
    out[:, 2] %= turns
    return out


def keys(of: IntArray) -> IntArray:
    """(n,) one number for each cell (n, 3)."""
    return (of[:, 0] * _WIDE + of[:, 1]) * _WIDE + of[:, 2]


def occupied(poses: FloatArray, cell_m: float, cell_rad: float) -> int:
    """How many cells of that size hold a particle."""
    return len(np.unique(keys(cells(poses, poses[0], cell_m, cell_rad))))


def group(poses: FloatArray, weights: FloatArray) -> tuple[IntArray, IntArray]:
    """Labels (n,) of the groups that particles form, and (n,) of the cells within; both count from zero.

    Cells touch where neither is next to empty beside the other: a thin veil of particles ties no crowds together.
    """
    of = cells(poses, poses[0], _CELL_M, _CELL_RAD)
    if not of.any():
        nothing = np.zeros(len(poses), dtype=np.intp)
        return nothing, nothing
    turns = round(2 * np.pi / _CELL_RAD)
    found, first, inverse = np.unique(keys(of), return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1).astype(np.intp)
    mass = np.bincount(inverse, weights)
    cell, edges = of[first], []
    for step in _BESIDE:
        beside = cell + step
        beside[:, 2] %= turns
        key = keys(beside)
        at = np.minimum(np.searchsorted(found, key), len(found) - 1)
        alike = np.minimum(mass, mass[at]) > _VEIL * np.maximum(mass, mass[at])
        (touching,) = np.nonzero((found[at] == key) & alike)
        edges.append(np.stack([touching, at[touching]]))
    rows, columns = np.concatenate(edges, axis=1)
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(found), len(found)))
    _, labels = connected_components(graph, directed=False)
    return labels.astype(np.intp)[inverse], inverse
