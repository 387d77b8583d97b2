"""The plane in which straight lines are straight: the picture, or what a lens without distortion would show.

Its unit is the picture's pixel. A wide fisheye has no image of all it sees on a plane; what has none is NaN.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.camera import Camera
from fieldloc.pose import FloatArray

_LEAST_FORWARD = 0.1  # cosine of a ray's angle to the optical axis: farther out the plane is endless


@dataclass(frozen=True, slots=True)
class Plane:
    """camera: None where nothing is known of the lens, which is then taken to be free of distortion."""

    camera: Camera | None = None

    @property
    def is_picture(self) -> bool:
        return self.camera is None or (self.camera.model == "pinhole" and not any(self.camera.distortion))

    def from_picture(self, pixels: FloatArray) -> FloatArray:
        if self.camera is None or self.is_picture:
            return pixels
        rays, exists = self.camera.ray(pixels)
        forward = np.where(exists & (rays[..., 2] > _LEAST_FORWARD), rays[..., 2], np.nan)
        return np.asarray(rays[..., :2] / forward[..., None] * self._focal + self._centre)

    def to_picture(self, points: FloatArray) -> FloatArray:
        if self.camera is None or self.is_picture:
            return points
        flat = (points - self._centre) / self._focal
        pixels, _ = self.camera.project(np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1))
        return pixels

    def chains(self, chains: list[FloatArray]) -> list[FloatArray]:
        """Chains (m, 3) of the picture's points and widths as they are in the plane; without points that are not."""
        if self.is_picture or not chains:
            return chains
        table = np.concatenate(chains)
        points = self.from_picture(table[:, :2])
        zoom = np.linalg.norm(self.from_picture(table[:, :2] + np.sqrt(0.5)) - points, axis=1)
        table = np.column_stack([points, table[:, 2] * zoom])
        found = np.isfinite(table).all(axis=1)
        borders = np.cumsum([len(chain) for chain in chains])[:-1]
        parts = zip(np.split(table, borders), np.split(found, borders), strict=True)
        return [part for part, there in parts if there.all()]

    def normals_in_picture(self, points: FloatArray, across: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of points (..., 2) and unit vectors there, both in the plane: the pixels (..., 2), the unit vectors in the
        picture, and how many of the picture's pixels one of the plane's is along them (...,).
        """
        if self.is_picture:
            return points, across, np.ones(points.shape[:-1])
        vectors = 0.5 * (self.to_picture(points + across) - self.to_picture(points - across))
        zoom = np.hypot(vectors[..., 0], vectors[..., 1])
        return self.to_picture(points), vectors / zoom[..., None], zoom

    @property
    def _focal(self) -> FloatArray:
        assert self.camera is not None
        return np.array([self.camera.fx_px, self.camera.fy_px])

    @property
    def _centre(self) -> FloatArray:
        assert self.camera is not None
        return np.array([self.camera.cx_px, self.camera.cy_px])
