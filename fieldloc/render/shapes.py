"""What can be painted: quads, discs and rings on the ground, upright cylinders, lying ones, spheres.

Every shape knows a cone of planes around it, to find its pixels, and how much of each of them it covers. The silhouette
of each is exact, whatever the lens: planes through the camera, or the rim where lines of sight touch it.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.coverage import between, half_plane

_LEAST = 1e-9
_OUTSIDE = 1.0001  # of distance over radius: nobody sees a cylinder from inside
_CELLS = 3  # per pixel and axis, where an edge is curved


class Shape(Protocol):
    """fills_cone: the planes of `normals` are all of its outline."""

    @property
    def fills_cone(self) -> bool: ...

    def normals(self, eye: FloatArray) -> FloatArray | None:
        """Inward unit normals (k, 3) of planes through the camera at `eye` (3,) around it; None where it cannot be
        seen."""

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        """Covered share (m,) of pixels with rays (m, 3), which change by steps (m, 2, 3) to the next pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Quad:
    """A flat convex quadrilateral: corners (4, 3) in the field frame, one after the other."""

    corners: FloatArray

    @property
    def fills_cone(self) -> bool:
        return True

    def normals(self, eye: FloatArray) -> FloatArray | None:
        spokes = self.corners - eye
        out = np.cross(spokes, np.roll(spokes, -1, axis=0))
        length = np.linalg.norm(out, axis=-1)
        middle = spokes.mean(axis=0)
        if length.min() < _LEAST:
            return None
        out /= length[:, None]
        side = out @ middle
        if np.abs(side).max() < _LEAST * np.linalg.norm(middle):  # seen edge on
            return None
        return np.asarray(out * np.sign(side[:, None]))

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        normals = self.normals(eye)
        return np.zeros(len(rays)) if normals is None else _inside(normals, rays, steps)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """On the ground, from radius `inner_m` (0: a disc) to `outer_m` around centre (2,)."""

    centre: FloatArray
    outer_m: float
    inner_m: float = 0.0

    @property
    def fills_cone(self) -> bool:
        return False

    def normals(self, eye: FloatArray) -> FloatArray | None:
        corners = self.outer_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) + self.centre
        return Quad(np.column_stack([corners, np.zeros(4)])).normals(eye)

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        total = np.zeros(len(rays))
        offsets = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
        for u in offsets:
            for v in offsets:
                total += self._of_cell(eye, rays + u * steps[:, 0] + v * steps[:, 1], steps / _CELLS)
        return total / _CELLS**2

    def _of_cell(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        down = -rays[:, 2]
        safe = np.maximum(down, _LEAST)
        from_foot = rays[:, :2] / safe[:, None]
        away = eye[:2] + eye[2] * from_foot - self.centre
        moved = (eye[2] / safe)[:, None, None] * (steps[..., :2] + from_foot[:, None] * steps[..., 2:])
        slope = -2.0 * np.sum(away[:, None] * moved, axis=-1)
        square = np.sum(away**2, axis=-1)
        out = half_plane(self.outer_m**2 - square, slope)
        if self.inner_m > 0.0:
            out -= half_plane(self.inner_m**2 - square, slope)
        return np.where(down > _LEAST, np.maximum(out, 0.0), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Pillar:
    """An upright cylinder around centre (2,), from low_m to high_m above the ground."""

    centre: FloatArray
    radius_m: float
    low_m: float
    high_m: float

    @property
    def fills_cone(self) -> bool:
        return False

    def normals(self, eye: FloatArray) -> FloatArray | None:
        """Of the planes that touch it on its left and on its right."""
        away = self.centre - eye[:2]
        distance = float(np.hypot(away[0], away[1]))
        if distance < _OUTSIDE * self.radius_m:
            return None
        sine = self.radius_m / distance
        ahead = away / distance
        left = np.array([-ahead[1], ahead[0]])
        cosine = np.sqrt(1.0 - sine**2)
        inward = np.array([sine * ahead - cosine * left, sine * ahead + cosine * left])
        return np.column_stack([inward, np.zeros(2)])

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        normals = self.normals(eye)
        if normals is None:
            return np.zeros(len(rays))
        out = _inside(normals, rays, steps)
        # a rim's near side is its outline where one looks down at the bottom, or up at the top
        out = out * self._over(eye, rays, steps, self.low_m, eye[2] >= self.low_m)
        return np.asarray(out * (1.0 - self._over(eye, rays, steps, self.high_m, eye[2] < self.high_m)))

    def _over(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, level_m: float, near: bool) -> FloatArray:
        """Share of the pixels (m,) that looks over the rim at that height."""
        half = 0.5 * steps
        value = self._height(eye, rays, level_m, near)
        slope = [
            self._height(eye, rays + half[:, k], level_m, near) - self._height(eye, rays - half[:, k], level_m, near)
            for k in (0, 1)
        ]
        return half_plane(value, np.stack(slope, axis=-1))

    def _height(self, eye: FloatArray, rays: FloatArray, level_m: float, near: bool) -> FloatArray:
        """By how much rays pass over the near or far side of the rim: metres a unit of their way on the ground."""
        away = self.centre - eye[:2]
        flat = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), _LEAST)
        along = (rays[:, :2] @ away) / flat
        half = np.sqrt(np.maximum(self.radius_m**2 - (away @ away - along**2), 0.0))
        reach = along - half if near else along + half
        return np.asarray((eye[2] - level_m) * flat + reach * rays[:, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Bar:
    """A lying cylinder from start (3,) to end (3,), cut off square at both."""

    start: FloatArray
    end: FloatArray
    radius_m: float

    @property
    def fills_cone(self) -> bool:
        return True

    def normals(self, eye: FloatArray) -> FloatArray | None:
        along = (self.end - self.start) / np.linalg.norm(self.end - self.start)
        away = self.start - eye
        across = away - (away @ along) * along
        distance = float(np.linalg.norm(across))
        if distance < _OUTSIDE * self.radius_m:
            return None
        ahead = across / distance
        side = np.cross(along, ahead)
        sine = self.radius_m / distance
        cosine = np.sqrt(1.0 - sine**2)
        out = [sine * ahead - cosine * side, sine * ahead + cosine * side]
        for end, inward in ((self.start, 1.0), (self.end, -1.0)):
            plane = inward * np.cross(side, end - eye)  # through the eye, the end and its square cut
            plane *= np.sign(plane @ along) * inward
            out.insert(1 if inward > 0 else 3, plane / np.linalg.norm(plane))
        return np.array(out)

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        normals = self.normals(eye)
        return np.zeros(len(rays)) if normals is None else _inside(normals, rays, steps)


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """centre: (3,)."""

    centre: FloatArray
    radius_m: float

    @property
    def fills_cone(self) -> bool:
        return False

    def normals(self, eye: FloatArray) -> FloatArray | None:
        away = self.centre - eye
        distance = float(np.linalg.norm(away))
        if distance < _OUTSIDE * self.radius_m:
            return None
        ahead = away / distance
        sine = self.radius_m / distance
        cosine = np.sqrt(1.0 - sine**2)
        side = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        other = np.cross(ahead, side)
        return np.array([sine * ahead + cosine * s for s in (side, other, -side, -other)])

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
        away = self.centre - eye
        distance = float(np.linalg.norm(away))
        ahead = away / distance
        cosine = np.sqrt(max(1.0 - (self.radius_m / distance) ** 2, 0.0))
        return half_plane(rays @ ahead - cosine, (steps.reshape(-1, 3) @ ahead).reshape(-1, 2))


def strip(start: FloatArray, end: FloatArray, width_m: float) -> Quad:
    """A painted line on the ground around its middle from start (2,) to end (2,), cut off square."""
    along = (end - start) / np.linalg.norm(end - start)
    half = 0.5 * width_m * np.array([-along[1], along[0]])
    corners = np.array([start + half, end + half, end - half, start - half])
    return Quad(np.column_stack([corners, np.zeros(4)]))


def _inside(normals: FloatArray, rays: FloatArray, steps: FloatArray) -> FloatArray:
    """Covered by the cone of planes with inward normals (2 or 4, 3), opposite ones two apart (or the only two)."""
    values = rays @ normals.T
    slopes = (steps.reshape(-1, 3) @ normals.T).reshape(len(rays), 2, len(normals))
    shares = half_plane(values, np.swapaxes(slopes, 1, 2))
    if len(normals) == 2:
        return between(shares[:, 0], shares[:, 1])
    return np.asarray(between(shares[:, 0], shares[:, 2]) * between(shares[:, 1], shares[:, 3]))
