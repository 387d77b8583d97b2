"""The pixels of a camera as rays, in blocks, so that a shape looks only at the pixels near it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import robot_from_camera
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, rotation3
from fieldloc.render.coverage import REACH

Float32Array = NDArray[np.float32]
Indices = NDArray[np.intp]

_BLOCK_PX = 8


@dataclass(frozen=True, slots=True, eq=False)
class PixelGrid:
    """Rays of all n pixels, row by row, and of k square blocks of them. Single precision: 1e-4 px.

    rays: (n, 3) unit, camera frame, NaN where the lens has none. steps: (n, 2, 3) its change to the next pixel, right
    and below.
    pixels: (k, b) each block's pixels, some twice at the picture's border. middles: (k, 3), spread_rad: (k,) of each
    block's rays. step_rad: the largest change from pixel to pixel, corner to corner.
    """

    rays: Float32Array
    steps: Float32Array
    pixels: Indices
    middles: Float32Array
    spread_rad: Float32Array
    step_rad: float


@lru_cache(maxsize=2)  # one takes 36 bytes a pixel
def grid_of(camera: Camera) -> PixelGrid:
    width, height = camera.width_px, camera.height_px
    v, u = np.mgrid[:height, :width]
    rays, steps, _ = camera.ray_and_jacobian(np.stack([u.ravel(), v.ravel()], axis=-1).astype(np.float64))
    first_v, first_u = np.mgrid[:height:_BLOCK_PX, :width:_BLOCK_PX]
    inside = np.arange(_BLOCK_PX)
    rows = np.minimum(first_v.reshape(-1, 1, 1) + inside[:, None], height - 1)
    columns = np.minimum(first_u.reshape(-1, 1, 1) + inside, width - 1)
    pixels = (rows * width + columns).reshape(len(first_u.ravel()), -1)
    exists = np.isfinite(rays[:, 0])
    pixels = pixels[exists[pixels].any(axis=1)]
    total = np.where(exists[pixels][..., None], rays[pixels], 0.0).sum(axis=1)
    middles = total / np.maximum(np.linalg.norm(total, axis=-1), 1e-12)[:, None]
    chord = np.where(exists[pixels], np.linalg.norm(rays[pixels] - middles[:, None], axis=-1), 0.0).max(axis=1)
    lengths = np.linalg.norm(steps[exists], axis=1)
    step_rad = float(np.hypot(lengths[:, 0], lengths[:, 1]).max()) if len(lengths) else 0.0
    spread = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    single = np.float32
    return PixelGrid(
        rays.astype(single),
        np.swapaxes(steps, 1, 2).astype(single),
        pixels,
        middles.astype(single),
        spread.astype(single),
        step_rad,
    )


class Eye:
    """A camera at its place over the field: where each pixel looks, in the field's axes.

    centre: (3,) of the camera. rays: (n, 3) of all pixels. blur_px: of its lens. margin_rad: as far from a shape's
    outline a pixel may be that has something of it.
    """

    def __init__(self, camera: Camera, mount: CameraMount, pose: FloatArray, blur_px: float) -> None:
        self.grid = grid_of(camera)
        self.blur_px = blur_px
        self.margin_rad = self.grid.step_rad * (1.0 + REACH * blur_px)
        foot = apply(pose, np.array([mount.x_m, mount.y_m]))
        self.centre: FloatArray = np.array([foot[0], foot[1], mount.height_m])
        self.field_from_camera: FloatArray = rotation3(pose[2]) @ robot_from_camera(mount)
        self._turn = self.field_from_camera.astype(np.float32)
        self.rays: Float32Array = self.grid.rays @ self._turn.T
        self._middles = self.grid.middles @ self._turn.T

    def within(self, normals: FloatArray) -> Indices:
        """Pixels that may show something of the cone of rays on the right side of all planes with these inward unit
        normals (k, 3) through the camera; some of them may come twice."""
        toward = normals.astype(np.float32).T
        near = (self._middles @ toward > -(self.grid.spread_rad + self.margin_rad)[:, None]).all(axis=1)
        pixels = self.grid.pixels[near].ravel()
        fine = (self.rays[pixels] @ toward > -self.margin_rad).all(axis=1)
        return np.asarray(pixels[fine])

    def steps(self, pixels: Indices) -> FloatArray:
        """(m, 2, 3) of some pixels: the change of their rays to the next pixel on the right and below."""
        return (self.grid.steps[pixels].reshape(-1, 3) @ self._turn.T).reshape(-1, 2, 3).astype(np.float64)
