"""The centre circle among chains of white runs: an ellipse through what bends.

It is sought before the lines, as its arcs, taken for lines, are the commonest wrong line. An ellipse is fitted to each
of the longest bent chains and to each two of them; the one that explains most of all chains is fitted again to those.
The fit is the direct least squares one that is always an ellipse (Fitzgibbon, Pilu, Fisher 1999, in the stable form of
Halir and Flusser 1998), each point weighted by the inverse gradient of the conic, so that it counts by its distance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.turf import Mask

View = Callable[
    [FloatArray], tuple[Mask, Mask]
]  # which points (n, 2) are in the picture, which are below the field's border

_ARCS, _CORNERED = 3, 1  # the longest bent chains that are tried, alone and in pairs: smooth ones, those with a corner
_LEAST_SAGITTA_PX = 1.5  # of a bent chain
_NEAR_PX = 1.5  # from the ellipse is on it, beside the next share of the line's width
_NEAR_SHARE = 0.15
_BINS = 48  # of the ellipse's angle
_LEAST_SEEN = 0.25  # share of the visible bins that are explained
_LEAST_BINS = 7
_WINDOW = 8  # points at least of a part of a chain whose bend is compared with the ellipse's
_SIGMAS, _LEAST_BEND_PX = 3.0, 0.3  # a bend is more than so many times its noise, and than this
# Share of the points that are bent as the ellipse is, of those where it is bent.
_BENT, _BENT_MEASURED, _BENT_SHORT = 0.5, 0.75, 0.6
_MANY, _FLOOR_PX = 99, 0.05  # windows of what was measured, and the least bend that it tells
_THINNEST = 2.0  # the shorter semi-axis to how near is on the ellipse: a thinner one might be a straight line
_LARGEST_PX = 1e4  # semi-axis
_CONSTRAINED = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])  # inverse of 4 a c - b^2 as a matrix
_BESIDE = 0.1  # share of the ellipse in the picture that may be above the field's border


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """conic: (6,) a..f of a x^2 + b x y + c y^2 + d x + e y + f = 0 in x, y = (point - origin) / scale."""

    conic: FloatArray
    origin: FloatArray
    scale: float

    def distance(self, points: FloatArray) -> FloatArray:
        """(n,) from the ellipse, positive outside, to first order (Sampson)."""
        value, across, down = self._value(points)
        return np.asarray(self.scale * value / np.maximum(np.hypot(across, down), 1e-9))

    def weights(self, points: FloatArray) -> FloatArray:
        _, across, down = self._value(points)
        return np.asarray(1.0 / np.maximum(np.hypot(across, down), 1e-9))

    def normals(self, points: FloatArray) -> FloatArray:
        """(n, 2) unit vectors outwards."""
        _, across, down = self._value(points)
        return np.asarray((np.stack([across, down]) / np.maximum(np.hypot(across, down), 1e-9)).T)

    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Centre (2,) and semi-axes (2, 2), each a row, the longer first."""
        a, b, c, d, e, f = self.conic
        quadratic = np.array([[a, 0.5 * b], [0.5 * b, c]])
        centre = -0.5 * np.linalg.solve(quadratic, np.array([d, e]))
        level = centre @ quadratic @ centre - f
        values, vectors = np.linalg.eigh(quadratic / level)
        lengths = self.scale / np.sqrt(np.maximum(values, 1e-18))
        return centre * self.scale + self.origin, np.asarray(vectors.T * lengths[:, None])

    def _value(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The conic at points (n, 2) and its change across and down; (n,) each."""
        x, y = (points.T - self.origin[:, None]) / self.scale
        a, b, c, d, e, f = self.conic.tolist()
        slanted = b * x + c * y
        return (a * x + b * y + d) * x + (c * y + e) * y + f, 2.0 * a * x + b * y + d, slanted + c * y + e


def fit_ellipse(points: FloatArray, weights: FloatArray | None = None) -> Ellipse | None:
    """The ellipse through at least six points (n, 2); None where they fix none. Positive outside."""
    if len(points) < 6:
        return None
    origin = points.sum(axis=0) / len(points)
    away = points.T - origin[:, None]
    scale = float(np.abs(away).max()) or 1.0
    rows = np.ones((6, len(points)))
    rows[3:5] = x, y = away / scale
    rows[0], rows[1], rows[2] = x * x, x * y, y * y
    if weights is not None:
        rows *= weights
    products = rows @ rows.T
    scatter, mixed, low = products[:3, :3], products[:3, 3:], products[3:, 3:]
    try:
        back = -np.linalg.solve(low, mixed.T)
        _, vectors = np.linalg.eig(_CONSTRAINED @ (scatter + mixed @ back))
    except np.linalg.LinAlgError:
        return None
    vectors = np.real(vectors)
    good = 4.0 * vectors[0] * vectors[2] - vectors[1] ** 2
    best = int(np.argmax(good))
    if not good[best] > 0.0:
        return None
    top = vectors[:, best] * np.sign(vectors[0, best])
    return Ellipse(np.concatenate([top, back @ top]), origin, scale)


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
    tried = []
    for first in range(len(arcs)):
        for second in range(first, len(arcs)):
            chosen = arcs[first] if first == second else np.concatenate([arcs[first], arcs[second]])
            fitted = fit_ellipse(chosen[:, :2])
            if fitted is not None:
                tried.append((np.abs(fitted.distance(points)) < near, fitted))
    tried.sort(key=lambda one: np.count_nonzero(one[0]), reverse=True)
    best, most = None, 0
    done = np.zeros(len(points), dtype=np.bool_)  # on what has been refined: nothing new comes from there
    for on, start in tried:
        if np.count_nonzero(on & ~done) < 0.5 * np.count_nonzero(on):
            continue
        ellipse = start
        for _ in range(4):
            refined = fit_ellipse(points[on], ellipse.weights(points[on]))
            if refined is None:
                break
            before = on
            ellipse, on = refined, np.abs(refined.distance(points)) < near
            count = _explained(ellipse, windows)
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
    return _explained(ellipse, long, _BENT_MEASURED) > 0 and _explained(ellipse, short, _BENT_SHORT, _FLOOR_PX) > 0


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


def _explained(ellipse: Ellipse, windows: _Windows, least: float = _BENT, least_px: float = _LEAST_BEND_PX) -> int:
    """How many points are in windows on the ellipse; none where these are bent too little for it, as straight lines are
    that it runs along.
    """
    off = ellipse.distance(windows.points)
    on = np.add.reduceat((np.abs(off) < windows.near_px).astype(np.float64), windows.begins) > 0.8 * windows.sizes
    on &= windows.sizes >= _WINDOW
    middle = windows.begins + windows.sizes // 2
    bend = (windows.bend * ellipse.normals(windows.points[middle])).sum(axis=1)
    wanted = bend - np.add.reduceat(windows.bow * off, windows.begins)
    # Every window has a say where the ellipse wants a bend that cannot be noise: a corner is bent much, in one place.
    asked = on & (np.abs(wanted) > np.maximum(_SIGMAS * windows.sigma_px, least_px))
    found = np.clip(bend[asked] / wanted[asked], 0.0, 1.0) @ windows.sizes[asked]
    if not asked.any() or found < least * windows.sizes[asked].sum():
        return 0
    return int(windows.sizes[on].sum())


def _is_bent(chain: FloatArray) -> bool:
    """Whether a parabola over the chord explains what a straight line does not."""
    if len(chain) < 8:
        return False
    (u, v), (u_middle, v_middle), (u_last, v_last) = chain[[0, len(chain) // 2, -1], :2].tolist()
    across, down = u_last - u, v_last - v
    length = math.hypot(across, down)
    sagitta = abs(across * (v_middle - v) - down * (u_middle - u)) / max(length, 1e-9)
    if length < 1.0 or sagitta < 0.5 * _LEAST_SAGITTA_PX:
        return False
    along = np.array([across, down]) / length
    relative = chain[:, :2] - chain[0, :2]
    basis = np.ones((3, len(chain)))
    basis[1] = place = (2.0 / length) * (relative @ along) - 1.0
    basis[2] = place * place
    off = relative @ np.array([-along[1], along[0]])
    sizes = np.linalg.solve(basis @ basis.T + 1e-9 * np.eye(3), basis @ off)
    rest = off - sizes @ basis
    return bool(abs(sizes[2]) > max(_LEAST_SAGITTA_PX, 3.0 * math.sqrt(rest @ rest / len(rest))))


def _arcs(chains: list[FloatArray]) -> list[FloatArray]:
    """The chains (m, 3) that may be the circle's arcs. What bends at a corner may be two lines, or an arc and what it
    runs into: it is tried beside arcs that are smooth, and none is without these.
    """
    bent = sorted((chain for chain in chains if _is_bent(chain)), key=len, reverse=True)
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
    rim, _ = on_rim(centre, axes, np.arange(_BINS) / _BINS)
    in_picture, on_field = view(rim)
    if np.count_nonzero(in_picture & ~on_field) > _BESIDE * np.count_nonzero(in_picture):
        return False
    explained = np.bincount(bins_of(centre, axes, on), minlength=_BINS) > 0
    count = np.count_nonzero(explained & in_picture)
    return bool(count >= max(_LEAST_BINS, _LEAST_SEEN * np.count_nonzero(in_picture)))


def on_rim(centre: FloatArray, axes: FloatArray, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) of the ellipse at turns (n,) of its own angle, 0 to 1, and the unit normals there, outwards."""
    angle = 2.0 * np.pi * turns[:, None]
    normals = np.cos(angle) * axes[0] / (axes[0] @ axes[0]) + np.sin(angle) * axes[1] / (axes[1] @ axes[1])
    normals /= np.hypot(normals[:, :1], normals[:, 1:])
    return centre + np.cos(angle) * axes[0] + np.sin(angle) * axes[1], normals


def bins_of(centre: FloatArray, axes: FloatArray, points: FloatArray) -> NDArray[np.intp]:
    """(n,) which of the equal parts of the ellipse's own angle points (n, 2) are nearest to the middle of."""
    relative = points - centre
    angle = np.arctan2(relative @ axes[1] / (axes[1] @ axes[1]), relative @ axes[0] / (axes[0] @ axes[0]))
    return np.asarray(np.rint(angle / (2.0 * np.pi) * _BINS).astype(np.intp) % _BINS)
