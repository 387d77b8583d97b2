"""Ellipses: fitted to points, and points on them.

The fit is the direct least squares one that is always an ellipse (Fitzgibbon, Pilu, Fisher 1999, in the stable form of
Halir and Flusser 1998), each point weighted by the inverse gradient of the conic, so that it counts by its distance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

PARTS = 48
"""Equal parts of an ellipse's own angle, for `parts_of`."""
_CONSTRAINED = np.array([[0.0, 0.0, 0.5], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]])  # inverse of 4 a c - b^2 as a matrix
_LEAST_SPREAD = 1e-12  # of points across a straight line, by their number: they fix no ellipse, and break no solver


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """conic: (6,) a..f of a x^2 + b x y + c y^2 + d x + e y + f = 0 in x, y = (point - origin) / scale."""

    conic: FloatArray
    origin: FloatArray
    scale: float

    def distance(self, points: FloatArray) -> FloatArray:
        """(n,) from the ellipse, positive outside, to first order (Sampson)."""
        return self.beside(points)[0]

    def weights(self, points: FloatArray) -> FloatArray:
        """(n,) the inverse gradient of the conic, so that points (n, 2) count by their distance."""
        return self.beside(points)[1]

    def beside(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`distance` and `weights` (n,) of points (n, 2)."""
        places, half = self._half_change(points)
        weights = 0.5 / np.maximum(np.hypot(half[0], half[1]), 1e-9)
        return self.scale * (places * half).sum(axis=0) * weights, weights

    def normals(self, points: FloatArray) -> FloatArray:
        """(n, 2) unit vectors outwards."""
        _, half = self._half_change(points)
        return np.asarray((half[:2] / np.maximum(np.hypot(half[0], half[1]), 1e-9)).T)

    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Centre (2,) and semi-axes (2, 2), each a row, the longer first."""
        a, b, c, d, e, f = self.conic
        quadratic = np.array([[a, 0.5 * b], [0.5 * b, c]])
        centre = -0.5 * np.linalg.solve(quadratic, np.array([d, e]))
        level = centre @ quadratic @ centre - f
        values, vectors = np.linalg.eigh(quadratic / level)
        lengths = self.scale / np.sqrt(np.maximum(values, 1e-18))
        return centre * self.scale + self.origin, np.asarray(vectors.T * lengths[:, None])

    def _half_change(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3, n) x, y, 1 of points (n, 2) and half the conic's derivatives by them: their product is the conic."""
        a, b, c, d, e, f = (0.5 * self.conic).tolist()
        places = np.ones((3, len(points)))
        places[:2] = (points.T - self.origin[:, None]) / self.scale
        return places, np.array([[2.0 * a, b, d], [b, 2.0 * c, e], [d, e, 2.0 * f]]) @ places


def fit_ellipse(points: FloatArray, weights: FloatArray | None = None) -> Ellipse | None:
    """The ellipse through at least six points (n, 2); None where they fix none. Positive outside."""
    if len(points) < 6:
        return None
    frame = _frame(points)
    return _ellipses(_products(points, *frame, weights)[None], *frame)[0]


def fit_ellipses(parts: list[FloatArray], choices: Sequence[tuple[int, ...]]) -> list[Ellipse | None]:
    """As `fit_ellipse`, through each choice of the parts' points (n, 2) together."""
    frame = _frame(np.concatenate(parts))
    products = np.array([_products(part, *frame) for part in parts])
    counts = [sum(len(parts[n]) for n in choice) for choice in choices]
    fitted = _ellipses(np.stack([products[list(choice)].sum(axis=0) for choice in choices]), *frame)
    return [one if count >= 6 else None for one, count in zip(fitted, counts, strict=True)]


def _frame(points: FloatArray) -> tuple[FloatArray, float]:
    """Origin (2,) and scale that bring points (n, 2) to within -1 and 1."""
    origin = points.sum(axis=0) / len(points)
    return origin, float(np.abs(points - origin).max()) or 1.0


def _products(points: FloatArray, origin: FloatArray, scale: float, weights: FloatArray | None = None) -> FloatArray:
    """(6, 6) sums of the products of x^2, x y, y^2, x, y and 1 over points (n, 2)."""
    rows = np.ones((6, len(points)))
    rows[3:5] = x, y = (points.T - origin[:, None]) / scale
    rows[0], rows[1], rows[2] = x * x, x * y, y * y
    if weights is not None:
        rows *= weights
    return np.asarray(rows @ rows.T)


def _ellipses(products: FloatArray, origin: FloatArray, scale: float) -> list[Ellipse | None]:
    """Of `_products` (k, 6, 6) each."""
    scatter, mixed, low = products[:, :3, :3], products[:, :3, 3:], products[:, 3:, 3:]
    try:
        back = -np.linalg.solve(low + _LEAST_SPREAD * low[:, 2:, 2:] * np.eye(3), mixed.transpose(0, 2, 1))
        _, vectors = np.linalg.eig(_CONSTRAINED @ (scatter + mixed @ back))
    except np.linalg.LinAlgError:
        return [None] * len(products)
    vectors = np.real(vectors)
    good = 4.0 * vectors[:, 0] * vectors[:, 2] - vectors[:, 1] ** 2
    best, each = good.argmax(axis=1), np.arange(len(products))
    tops = vectors[each, :, best] * np.sign(vectors[each, 0, best])[:, None]
    conics = np.concatenate([tops, (back @ tops[..., None])[..., 0]], axis=1)
    fixed = (good[each, best] > 0.0).tolist()
    return [Ellipse(conic, origin, scale) if there else None for conic, there in zip(conics, fixed, strict=True)]


def on_rim(centre: FloatArray, axes: FloatArray, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) of the ellipse at turns (n,) of its own angle, 0 to 1, and the unit normals there, outwards."""
    angle = 2.0 * np.pi * turns[:, None]
    normals = np.cos(angle) * axes[0] / (axes[0] @ axes[0]) + np.sin(angle) * axes[1] / (axes[1] @ axes[1])
    normals /= np.hypot(normals[:, :1], normals[:, 1:])
    return centre + np.cos(angle) * axes[0] + np.sin(angle) * axes[1], normals


def parts_of(centre: FloatArray, axes: FloatArray, points: FloatArray) -> NDArray[np.intp]:
    """(n,) which of the equal parts of the ellipse's own angle points (n, 2) are nearest to the middle of."""
    relative = points - centre
    angle = np.arctan2(relative @ axes[1] / (axes[1] @ axes[1]), relative @ axes[0] / (axes[0] @ axes[0]))
    return np.asarray(np.rint(angle / (2.0 * np.pi) * PARTS).astype(np.intp) % PARTS)
