"""Solid shapes: upright cylinders and boxes, lying cylinders, spheres."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.coverage import half_plane
from fieldloc.render.flat import Quad
from fieldloc.render.shapes import OUTSIDE, inside_cone

_LEAST = 1e-9


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

    def touched(self, eye: FloatArray) -> FloatArray | None:
        """(2, 2) where lines of sight touch it, left and right as seen; None from inside."""
        away = self.centre - eye[:2]
        distance = float(np.hypot(away[0], away[1]))
        if distance < OUTSIDE * self.radius_m:
            return None
        sine = self.radius_m / distance
        left = np.array([-away[1], away[0]])
        ahead, aside = (1.0 - sine**2) * away, sine * np.sqrt(1.0 - sine**2) * left
        return np.array([eye[:2] + ahead + aside, eye[:2] + ahead - aside])

    def foot(self, eye: FloatArray) -> FloatArray:
        """(2,) the middle of its visible contact with the ground."""
        away = self.centre - eye[:2]
        return np.asarray(self.centre - self.radius_m * away / np.linalg.norm(away))

    def normals(self, eye: FloatArray) -> FloatArray | None:
        return _upright(eye, self.touched(eye))

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        normals = self.normals(eye)
        if normals is None:
            return np.zeros(len(rays))
        out = inside_cone(normals, rays, steps, blur_px)
        # a rim's near side is its outline where one looks down at the bottom, or up at the top
        out = out * self._over(eye, rays, steps, blur_px, self.low_m, eye[2] >= self.low_m)
        return np.asarray(out * (1.0 - self._over(eye, rays, steps, blur_px, self.high_m, eye[2] < self.high_m)))

    def _over(
        self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float, level_m: float, near: bool
    ) -> FloatArray:
        """Share of the pixels (m,) that looks over the rim at that height."""
        half = 0.5 * steps
        value = self._height(eye, rays, level_m, near)
        slope = [
            self._height(eye, rays + half[:, k], level_m, near) - self._height(eye, rays - half[:, k], level_m, near)
            for k in (0, 1)
        ]
        return half_plane(value, np.stack(slope, axis=-1), blur_px)

    def _height(self, eye: FloatArray, rays: FloatArray, level_m: float, near: bool) -> FloatArray:
        """By how much rays pass over the near or far side of the rim: metres a unit of their way on the ground."""
        away = self.centre - eye[:2]
        flat = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), _LEAST)
        along = (rays[:, :2] @ away) / flat
        half = np.sqrt(np.maximum(self.radius_m**2 - (away @ away - along**2), 0.0))
        reach = along - half if near else along + half
        return np.asarray((eye[2] - level_m) * flat + reach * rays[:, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An upright one with a square section around centre (2,), radius_m being half of its side, sides along x and y."""

    centre: FloatArray
    radius_m: float
    low_m: float
    high_m: float

    @property
    def fills_cone(self) -> bool:
        return False

    def touched(self, eye: FloatArray) -> FloatArray | None:
        """(2, 2) the outermost of its upright edges, left and right as seen; None from inside."""
        spokes = self._section() - eye[:2]
        away = self.centre - eye[:2]
        if np.abs(away).max() < OUTSIDE * self.radius_m:
            return None
        aside = away[0] * spokes[:, 1] - away[1] * spokes[:, 0]
        tangent = aside / (spokes @ away)
        return eye[:2] + spokes[[int(tangent.argmax()), int(tangent.argmin())]]

    def foot(self, eye: FloatArray) -> FloatArray:
        """(2,) of its contact with the ground, what is nearest on the way to its middle."""
        away = self.centre - eye[:2]
        return np.asarray(self.centre - self.radius_m * away / np.abs(away).max())

    def normals(self, eye: FloatArray) -> FloatArray | None:
        return _upright(eye, self.touched(eye))

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        """The sum of its visible faces: where two of them meet, their shares of a pixel make one."""
        out = np.zeros(len(rays))
        section = self._section()
        low, high = (np.column_stack([section, np.full(4, level)]) for level in (self.low_m, self.high_m))
        for k in range(4):
            outward = section[k] + section[k - 1] - 2.0 * self.centre
            if outward @ (eye[:2] - section[k]) > 0.0:
                out += Quad(np.array([low[k - 1], low[k], high[k], high[k - 1]])).coverage(eye, rays, steps, blur_px)
        for face, seen in ((high, eye[2] > self.high_m), (low, eye[2] < self.low_m)):
            if seen:
                out += Quad(face).coverage(eye, rays, steps, blur_px)
        return np.minimum(out, 1.0)

    def _section(self) -> FloatArray:
        """(4, 2), counter-clockwise."""
        return self.centre + self.radius_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Bar:
    """A lying cylinder from start (3,) to end (3,), cut off square at both."""

    start: FloatArray
    end: FloatArray
    radius_m: float

    @property
    def fills_cone(self) -> bool:
        return True

    def touched(self, eye: FloatArray) -> FloatArray | None:
        """(2, 2, 3) start and end of the lines along which sight touches it, the upper one first; None from inside."""
        along = (self.end - self.start) / np.linalg.norm(self.end - self.start)
        away = self.start - eye
        across = away - (away @ along) * along
        distance = float(np.linalg.norm(across))
        if distance < OUTSIDE * self.radius_m:
            return None
        ahead = across / distance
        side = np.cross(along, ahead)
        side *= np.sign(side[2]) or 1.0
        sine = self.radius_m / distance
        ends = np.array([self.start, self.end]) - self.radius_m * sine * ahead
        aside = self.radius_m * np.sqrt(1.0 - sine**2) * side
        return np.array([ends + aside, ends - aside])

    def normals(self, eye: FloatArray) -> FloatArray | None:
        touched = self.touched(eye)
        if touched is None:
            return None
        (a, b), (c, d) = touched
        return Quad(np.array([a, b, d, c])).normals(eye)

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        normals = self.normals(eye)
        return np.zeros(len(rays)) if normals is None else inside_cone(normals, rays, steps, blur_px)


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
        if distance < OUTSIDE * self.radius_m:
            return None
        ahead = away / distance
        sine = self.radius_m / distance
        cosine = np.sqrt(1.0 - sine**2)
        side = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        other = np.cross(ahead, side)
        return np.array([sine * ahead + cosine * s for s in (side, other, -side, -other)])

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        away = self.centre - eye
        distance = float(np.linalg.norm(away))
        ahead = away / distance
        cosine = np.clip(rays @ ahead, -1.0, 1.0)
        slope = (steps.reshape(-1, 3) @ ahead).reshape(-1, 2) / np.sqrt(np.maximum(1.0 - cosine**2, _LEAST))[:, None]
        return half_plane(np.arcsin(self.radius_m / distance) - np.arccos(cosine), slope, blur_px)


def _upright(eye: FloatArray, touched: FloatArray | None) -> FloatArray | None:
    """Inward normals (2, 3) of upright planes through the left and right points (2, 2) that lines of sight touch."""
    if touched is None:
        return None
    left, right = touched - eye[:2]
    out = np.array([[left[1], -left[0], 0.0], [-right[1], right[0], 0.0]])
    return np.asarray(out / np.linalg.norm(out, axis=-1)[:, None])
