"""Penalty marks: small white patches with nothing but turf around them. The centre is that of the white one sees."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenMark
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.turf import Turf
from fieldloc.vision.white import SCAN_STEP_PX

_LARGEST = 0.15  # of the picture's width
_FLATTEST = 10.0  # wide to high, as a mark seen from far is, and no piece of a line
_TALLEST = 1.3  # high to wide: lying on the ground it looks flatter than it is
_LEAST_PX = (9.0, 4.0)  # wide and high: less is a speck
_CLEAR = 5.0  # times the contrast of turf with itself is that of a mark with turf
_AROUND = 40  # points around it, of which
_TURF = 0.95  # this share has to be turf
_FILLED = 0.4  # of the box about it has to be white
_FLOOR_PX = 0.1  # its outline is made of pixels


def find_marks(chains: list[FloatArray], grey: UInt8Array, turf: Turf) -> tuple[SeenMark, ...]:
    """chains: (m, 3) of runs down the picture, which are patches where they are short."""
    patches = [chain for chain in chains if _LEAST_PX[0] <= len(chain) * SCAN_STEP_PX <= _LARGEST * grey.shape[1]]
    if not patches:
        return ()
    middle, size, filled = _boxes(patches)
    flat = size[:, 0] / size[:, 1]
    fits = (size >= _LEAST_PX).all(axis=1) & (flat >= 1.0 / _TALLEST) & (flat <= _FLATTEST) & (filled > _FILLED)
    angle = np.arange(_AROUND) * (2.0 * np.pi / _AROUND)
    ring = middle[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=1) * (0.75 * size + 4.0)[:, None]
    fits &= np.count_nonzero(turf.at(ring), axis=1) >= _TURF * _AROUND
    inside = ((ring > 0.0) & (ring < (grey.shape[1] - 1.0, grey.shape[0] - 1.0))).all(axis=(1, 2))
    found = (_measured(middle[row], size[row], ring[row], grey) for row in np.flatnonzero(fits & inside))
    return tuple(mark for mark in found if mark is not None)


def _boxes(patches: list[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middles (k, 2) and sizes (k, 2) of the boxes about patches, and the shares (k,) of them that are white."""
    counts = np.array([len(patch) for patch in patches])
    begins = np.cumsum(counts) - counts
    u, v, width = np.concatenate(patches).T
    left, right = u[begins] - 0.5 * SCAN_STEP_PX, u[begins + counts - 1] + 0.5 * SCAN_STEP_PX
    upper = np.minimum.reduceat(v - 0.5 * width, begins)
    lower = np.maximum.reduceat(v + 0.5 * width, begins)
    size = np.stack([right - left, lower - upper], axis=1)
    white = np.add.reduceat(width, begins) * SCAN_STEP_PX
    return np.stack([0.5 * (left + right), 0.5 * (upper + lower)], axis=1), size, white / (size[:, 0] * size[:, 1])


def _measured(middle: FloatArray, size: FloatArray, ring: FloatArray, grey: UInt8Array) -> SeenMark | None:
    """A patch about its middle (2,), of size (2,), turf on a ring (n, 2) about it; None for a pale or black one."""
    pixels = np.rint(ring).astype(np.intp)
    around = grey[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    level, spread = float(np.sort(around)[_AROUND // 2]), float(around.std())
    first = np.maximum(np.floor(middle - 0.5 * size - 2.0), 0).astype(np.intp)
    last = np.ceil(middle + 0.5 * size + 3.0).astype(np.intp)
    patch = grey[first[1] : last[1], first[0] : last[0]].astype(np.float64) - level
    if patch.min() < -max(4.0 * spread, 0.5 * patch.max()):  # a ball's black
        return None
    if patch.max() < _CLEAR * spread:
        return None
    bright = np.where(patch > 0.5 * patch.max(), patch, 0.0)
    total = float(bright.sum())
    if not total > 0.0:
        return None
    u, v = np.meshgrid(np.arange(first[0], first[0] + patch.shape[1]), np.arange(first[1], first[1] + patch.shape[0]))
    centre = np.array([float((bright * u).sum()), float((bright * v).sum())]) / total
    # The turf's texture in and at the patch moves the centroid; it is as coarse as the ring's pixels are alike.
    off = around - around.mean()
    alike = float(off[1:] @ off[:-1] + off[0] * off[-1]) / max(float(off @ off), 1e-9)
    likeness = min(max(alike, 0.0), 0.9)
    grain = ((1.0 + likeness) / (1.0 - likeness)) ** 2
    covariance = np.empty((2, 2))
    du, dv = u - centre[0], v - centre[1]
    near = bright > 0.0
    covariance[0] = [float((du * du)[near].sum()), float((du * dv)[near].sum())]
    covariance[1] = [covariance[0, 1], float((dv * dv)[near].sum())]
    return SeenMark(centre, covariance * grain * (spread / total) ** 2 + _FLOOR_PX**2 * np.eye(2))
