"""Flat shapes: quads anywhere, discs and rings on the ground."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.coverage import half_plane
from fieldloc.render.shapes import inside_cone

_LEAST = 1e-9
_CELLS = 3  # per pixel and axis, where an edge is curved
_OFFSETS = np.arange(_CELLS) - 0.5 * (_CELLS - 1)  # in cells


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

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        normals = self.normals(eye)
        return np.zeros(len(rays)) if normals is None else inside_cone(normals, rays, steps, blur_px)


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

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        out = self._of_cell(eye, rays, steps, blur_px)
        edge = (out > 0.0) & (out < 1.0)
        rays, steps = rays[edge], steps[edge] / _CELLS
        total = np.zeros(len(rays))
        for u in _OFFSETS:
            for v in _OFFSETS:
                total += self._of_cell(eye, rays + u * steps[:, 0] + v * steps[:, 1], steps, _CELLS * blur_px)
        out[edge] = total / _CELLS**2
        return out

    def _of_cell(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        down = -rays[:, 2]
        safe = np.maximum(down, _LEAST)
        from_foot = rays[:, :2] / safe[:, None]
        away = eye[:2] + eye[2] * from_foot - self.centre
        moved = (eye[2] / safe)[:, None, None] * (steps[..., :2] + from_foot[:, None] * steps[..., 2:])
        distance = np.hypot(away[:, 0], away[:, 1])
        inward = -away / np.maximum(distance, _LEAST)[:, None]
        slope = np.sum(inward[:, None] * moved, axis=-1)
        out = half_plane(self.outer_m - distance, slope, blur_px)
        if self.inner_m > 0.0:
            out -= half_plane(self.inner_m - distance, slope, blur_px)
        return np.where(down > _LEAST, np.maximum(out, 0.0), 0.0)


def strip(start: FloatArray, end: FloatArray, width_m: float) -> Quad:
    """A painted line on the ground around its middle from start (2,) to end (2,), cut off square."""
    along = (end - start) / np.linalg.norm(end - start)
    half = 0.5 * width_m * np.array([-along[1], along[0]])
    corners = np.array([start + half, end + half, end - half, start - half])
    return Quad(np.column_stack([corners, np.zeros(4)]))
