"""What has been painted so far, and in which order: whatever is painted later is nearer."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.grid import Eye, Float32Array, Indices
from fieldloc.render.scene import Colour
from fieldloc.render.shapes import Shape


class Canvas:
    """light: (n, 3) of all pixels. rank: (n,) of what covers most of a pixel: 0 ground and sky, then as painted.

    gamma: of the picture that it will be; light is what adds up, before it.
    """

    def __init__(self, eye: Eye, gamma: float = 1.0) -> None:
        self.eye = eye
        self._gamma = gamma
        count = len(eye.rays)
        self.light: Float32Array = np.zeros((count, 3), dtype=np.float32)
        self.rank = np.zeros(count, dtype=np.int16)
        self._painted = 0

    def light_of(self, colour: Colour) -> Float32Array:
        """(3,): the light that looks like this in the picture."""
        return np.asarray(255.0 * (np.array(colour) / 255.0) ** self._gamma, dtype=np.float32)

    def shares(self, shape: Shape) -> tuple[Indices, FloatArray]:
        """Pixels (m,) on which the shape is, hidden or not, and the share (m,) of each that it covers."""
        normals = shape.normals(self.eye.centre)
        if normals is None:
            return np.zeros(0, dtype=np.intp), np.zeros(0)
        eye = self.eye
        pixels = eye.within(normals)
        share = np.ones(len(pixels))
        edge = np.arange(len(pixels))
        if shape.fills_cone:
            well_inside = (eye.rays[pixels] @ normals.astype(np.float32).T > eye.margin_rad).all(axis=1)
            edge = np.flatnonzero(~well_inside)
        at_edge = pixels[edge]
        share[edge] = shape.coverage(eye.centre, eye.rays[at_edge].astype(np.float64), eye.steps(at_edge), eye.blur_px)
        some = share > 0.0
        return pixels[some], share[some]

    def paint(self, pixels: Indices, share: FloatArray, light: Float32Array) -> int:
        """Lay light, (3,) or (m, 3), over pixels; the rank it gets."""
        self._painted += 1
        part = share[:, None].astype(np.float32)
        self.light[pixels] += part * (light - self.light[pixels])
        self.rank[pixels[share > 0.5]] = self._painted
        return self._painted

    def shade(self, pixels: Indices, share: FloatArray, gain: float) -> None:
        """Darken or lighten, without hiding anything."""
        self.light[pixels] *= (1.0 + share[:, None] * (gain - 1.0)).astype(np.float32)
