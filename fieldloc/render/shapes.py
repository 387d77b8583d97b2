"""What every shape that can be painted knows: a cone of planes around it, to find its pixels, and its share of each.

The silhouette of each is exact, whatever the lens: planes through the camera, or the rim where lines of sight touch it.
"""

from typing import Protocol

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.coverage import between, half_plane

OUTSIDE = 1.0001
"""Of distance over radius, at least: nobody sees a round thing from inside."""


class Shape(Protocol):
    """fills_cone: the planes of `normals` are all of its outline."""

    @property
    def fills_cone(self) -> bool: ...

    def normals(self, eye: FloatArray) -> FloatArray | None:
        """Inward unit normals (k, 3) of planes through the camera at `eye` (3,) around it; None where it cannot be
        seen."""

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        """Covered share (m,) of pixels with rays (m, 3), which change by steps (m, 2, 3) to the next pixel.

        blur_px: of the lens, the standard deviation of a Gaussian.
        """


def inside_cone(normals: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
    """Covered by the cone of planes with inward normals (2 or 4, 3), opposite ones two apart (or the only two)."""
    values = rays @ normals.T
    slopes = (steps.reshape(-1, 3) @ normals.T).reshape(len(rays), 2, len(normals))
    shares = half_plane(values, np.swapaxes(slopes, 1, 2), blur_px)
    if len(normals) == 2:
        return between(shares[:, 0], shares[:, 1])
    return np.asarray(between(shares[:, 0], shares[:, 2]) * between(shares[:, 1], shares[:, 3]))
