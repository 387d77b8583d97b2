"""The centre circle among chains of white runs: an ellipse through what bends.

It is sought before the lines, as its arcs, taken for lines, are the commonest wrong line. An ellipse is fitted to each
of the longest bent chains and to each two of them; the one that explains most of all chains is fitted again to those.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.ellipse import PARTS, Ellipse, fit_ellipse, fit_ellipses, on_rim, parts_of
from fieldloc.vision.turf import Mask

View = Callable[
    [FloatArray], tuple[Mask, Mask]
]  # which points (n, 2) are in the picture, which are below the field's border

_ARCS, _CORNERED = 3, 1  # the longest bent chains that are tried, alone and in pairs: smooth ones, those with a corner
_LEAST_SAGITTA_PX = 1.5  # of a bent chain
_NEAR_PX = 1.5  # from the ellipse is on it, beside the next share of the line's width
_NEAR_SHARE = 0.15
_LEAST_SEEN = 0.25  # share of the visible bins that are explained
_LEAST_BINS = 7
_WINDOW = 8  # points at least of a part of a chain whose bend is compared with the ellipse's
_SIGMAS, _LEAST_BEND_PX = 3.0, 0.3  # a bend is more than so many times its noise, and than this
# Share of the points that are bent as the ellipse is, of those where it is bent.
_BENT, _BENT_MEASURED, _BENT_SHORT = 0.5, 0.75, 0.6
_MANY, _FLOOR_PX = 99, 0.05  # windows of what was measured, and the least bend that it tells
_THINNEST = 2.0  # the shorter semi-axis to how near is on the ellipse: a thinner one might be a straight line
_LARGEST_PX = 1e4  # semi-axis
_BESIDE = 0.1  # share of the ellipse in the picture that may be above the field's border


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """All chains' points (n, 2) in k windows. near_px: (n,) how near is on the ellipse. begins, sizes: (k,) of windows.

    bow: (n,) of unit square in each window, what of its points is parabola: the bend (k, 2) is the points' share in it,
    and sigma_px (k,) what noise makes of that.
    """

    points: FloatArray
    near_px: FloatArray
    begins: NDArray[np.intp]
    sizes: NDArray[np.intp]
    bow: FloatArray
    bend: FloatArray
    sigma_px: FloatArray


def find_ellipse(chains: list[FloatArray], view: View) -> tuple[Ellipse, list[Mask]] | None:
    """The circle's ellipse and per chain (m, 3) which of its points are on it; None without one."""
    arcs = _arcs(chains)
    if not arcs:
        return None
    windows = _windows(chains)
    points, near = windows.points, windows.near_px
    choices = [some for count in (1, 2) for some in combinations(range(len(arcs)), count)]
    starts = [start for start in fit_ellipses([arc[:, :2] for arc in arcs], choices) if start is not None]
    tried = []
    for start in starts:
        off, weights = start.beside(points)
        tried.append((np.abs(off) < near, weights))
    tried.sort(key=lambda one: np.count_nonzero(one[0]), reverse=True)
    best, most = None, 0
    done = np.zeros(len(points), dtype=np.bool_)  # on what has been refined: nothing new comes from there
    for on, weights in tried:
        if np.count_nonzero(on & ~done) < 0.5 * np.count_nonzero(on):
            continue
        for _ in range(4):
            ellipse = fit_ellipse(points[on], weights[on])
            if ellipse is None:
                break
            before, (off, weights) = on, ellipse.beside(points)
            on = np.abs(off) < near
            count = _explained(ellipse, off, windows)
            if count > most and is_seen(ellipse, points[on], near[on], view):
                best, most = ellipse, count
            if (on == before).all():
                break
        done |= on
    if best is None:
        return None
    return best, points_on(best, chains)


def points_on(ellipse: Ellipse, chains: list[FloatArray]) -> list[Mask]:
    """Per chain (m, 3) which of its points are on an ellipse."""
    table = np.concatenate(chains)
    on = np.abs(ellipse.distance(table[:, :2])) < _NEAR_PX + _NEAR_SHARE * table[:, 2]
    return np.split(on, np.cumsum([len(chain) for chain in chains])[:-1])


def is_round(ellipse: Ellipse, chains: list[FloatArray]) -> bool:
    """Whether chains (m, 3) that were measured on the ellipse's line are bent as it is."""
    if not chains:
        return False
    # Between the corners at its ends, a straight line is straight in many short windows.
    long, short = _windows(chains), _windows(chains, _MANY)
    off = ellipse.distance(long.points)
    return (
        _explained(ellipse, off, long, _BENT_MEASURED) > 0
        and _explained(ellipse, off, short, _BENT_SHORT, _FLOOR_PX) > 0
    )


def _count_of(points: int, most: int = 3) -> int:
    """Windows of a chain; a corner of two lines is in one of three at most."""
    return min(max(1, points // _WINDOW), most)


def _windows(chains: list[FloatArray], most: int = 3) -> _Windows:
    table = np.concatenate(chains)
    sizes = []
    for chain in chains:
        count = _count_of(len(chain), most)
        sizes += [(len(chain) + part) // count for part in range(count)]
    size = np.array(sizes)
    begins = np.cumsum(size) - size
    x = np.arange(len(table)) - np.repeat(begins + 0.5 * (size - 1), size)
    bow = x * x - np.repeat((size * size - 1.0) / 12.0, size)  # less its mean
    bow /= np.sqrt(np.maximum(np.add.reduceat(bow * bow, begins), 1e-9)).repeat(size)
    points = table[:, :2]
    bend = np.add.reduceat(bow[:, None] * points, begins)
    # Noise from the points' second differences, of which those across a window's border do not count. Along the chain
    # they are even, or they jump over a gap: what is across is the lesser of both directions.
    rough = np.zeros_like(points)
    rough[1:-1] = points[2:] - 2.0 * points[1:-1] + points[:-2]
    rough[begins] = rough[begins + size - 1] = 0.0
    square = np.add.reduceat(rough * rough, begins).min(axis=1)
    sigma = np.sqrt(square / (6.0 * np.maximum(size - 2, 1)))
    return _Windows(points, _NEAR_PX + _NEAR_SHARE * table[:, 2], begins, size, bow, bend, sigma)


def _explained(
    ellipse: Ellipse, off: FloatArray, windows: _Windows, least: float = _BENT, least_px: float = _LEAST_BEND_PX
) -> int:
    """How many points are in windows on the ellipse; none where these are bent too little for it, as straight lines are
    that it runs along. off: (n,) of the points from the ellipse.
    """
    on = np.add.reduceat((np.abs(off) < windows.near_px).astype(np.float64), windows.begins) > 0.8 * windows.sizes
    on &= windows.sizes >= _WINDOW
    middle = windows.begins + windows.sizes // 2
    bend = (windows.bend * ellipse.normals(windows.points[middle])).sum(axis=1)
    wanted = bend - np.add.reduceat(windows.bow * off, windows.begins)
    # Every window has a say where the ellipse wants a bend that cannot be noise: a corner is bent much, in one place.
    asked = on & (np.abs(wanted) > np.maximum(_SIGMAS * windows.sigma_px, least_px))
    found = np.minimum(np.maximum(bend[asked] / wanted[asked], 0.0), 1.0) @ windows.sizes[asked]
    if not asked.any() or found < least * windows.sizes[asked].sum():
        return 0
    return int(windows.sizes[on].sum())


def _bent(chains: list[FloatArray]) -> list[FloatArray]:
    """The chains of which a parabola over the chord explains what a straight line does not."""
    chains = [chain for chain in chains if len(chain) >= _WINDOW]
    if not chains:
        return []
    size = np.array([len(chain) for chain in chains])
    last = np.cumsum(size) - 1
    begins = last - size + 1
    points = np.concatenate(chains)[:, :2].T
    chord = points[:, last] - points[:, begins]
    length = np.maximum(np.hypot(chord[0], chord[1]), 1e-9)
    across, down = (chord / length).repeat(size, axis=1)
    u, v = points - points[:, begins].repeat(size, axis=1)
    terms = np.ones((4, len(u)))
    terms[1] = place = (2.0 / length).repeat(size) * (u * across + v * down) - 1.0
    terms[2], terms[3] = place * place, v * across - u * down
    products = np.add.reduceat(terms[:, None] * terms, begins, axis=2).transpose(2, 0, 1)
    wanted = products[:, :3, 3]
    parabola = np.linalg.solve(products[:, :3, :3] + 1e-9 * np.eye(3), wanted[..., None])[..., 0]
    rest = np.maximum(products[:, 3, 3] - (parabola * wanted).sum(axis=1), 0.0)
    bent = np.abs(parabola[:, 2]) > np.maximum(_LEAST_SAGITTA_PX, 3.0 * np.sqrt(rest / size))
    bent &= (length >= 1.0) & (np.abs(terms[3, begins + size // 2]) >= 0.5 * _LEAST_SAGITTA_PX)
    return [chains[n] for n in np.flatnonzero(bent)]


def _arcs(chains: list[FloatArray]) -> list[FloatArray]:
    """The chains (m, 3) that may be the circle's arcs. What bends at a corner may be two lines, or an arc and what it
    runs into: it is tried beside arcs that are smooth, and none is without these.
    """
    bent = sorted(_bent(chains), key=len, reverse=True)
    if not bent:
        return []
    told = list(zip(bent, _are_smooth(bent), strict=True))
    smooth = [chain for chain, is_smooth in told if is_smooth][:_ARCS]
    return smooth + [chain for chain, is_smooth in told if not is_smooth][:_CORNERED] if smooth else []


def _are_smooth(arcs: list[FloatArray]) -> list[bool]:
    """Whether most windows of each chain are bent to one side: a corner of two lines is bent in one of three."""
    windows = _windows(arcs)
    counts = [_count_of(len(arc)) for arc in arcs]
    last = np.cumsum(counts)
    smooth = []
    for begin, end in zip((last - counts).tolist(), last.tolist(), strict=True):
        bend = windows.bend[begin:end]
        total = bend.sum(axis=0)
        aside = bend @ total / max(float(np.hypot(*total)), 1e-9)
        clear = aside > np.maximum(_SIGMAS * windows.sigma_px[begin:end], _LEAST_BEND_PX)
        smooth.append(bool(2 * np.count_nonzero(clear) > len(clear)))
    return smooth


def is_seen(ellipse: Ellipse, on: FloatArray, near: FloatArray, view: View) -> bool:
    """Whether enough of the ellipse is explained by the points on it, it is no straight line, and on the field."""
    centre, axes = ellipse.axes()
    long, short = np.hypot(axes[:, 0], axes[:, 1])
    if not (np.isfinite([long, short]).all() and short > _THINNEST * near.mean() and long < _LARGEST_PX):
        return False
    rim, _ = on_rim(centre, axes, np.arange(PARTS) / PARTS)
    in_picture, on_field = view(rim)
    if np.count_nonzero(in_picture & ~on_field) > _BESIDE * np.count_nonzero(in_picture):
        return False
    explained = np.bincount(parts_of(centre, axes, on), minlength=PARTS) > 0
    count = np.count_nonzero(explained & in_picture)
    return bool(count >= max(_LEAST_BINS, _LEAST_SEEN * np.count_nonzero(in_picture)))
