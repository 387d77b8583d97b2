"""White runs: where scan lines, down and across the picture, go from turf over something white to turf again.

What is white is told from sunlit turf by the colour of the step, not by its brightness: from turf to white, blue and
red rise more than green; from shade to sun, less. So a thin, blurred or shaded line passes, a stripe of sun does not.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.turf import Mask, Turf

Single = NDArray[np.float32]

SCAN_STEP_PX = 4  # from one scan line to the next, of which all pixels are averaged
SCAN_GAP = 8  # numbers between the last scan line down the picture and the first across it

_SIGMAS = 2.25  # above the turf's own texture
_WIDE_SHARE, _NEAR_SHARE = 10, 32  # windows for the turf around a pixel are such a part of the picture's width
_LEAST_SHARE = 0.25  # of the near window in turf, for it to count
_CLIP = 1.5  # what is farther from the mean than so many standard deviations is no turf
_CLIPPED = 1.35  # a normal distribution's standard deviation to that of its part within _CLIP
_BEYOND_PX = np.array([1.5, 3.5, 6.0])
_ASIDE = np.array([-1, 0, 1])[:, None, None]
_COLOUR_STEP = 0.8  # of blue and red to that of green: about 0.5 from shade to sun, above 1 from turf to white


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """n runs along scan lines, of which some go down the picture and others, whose numbers follow after a gap, across.

    scan: (n,) number of the scan line, in ascending order; down: (n,) whether it goes down; at_px: (n,) its place
    across (u where it goes down, v else); first_px, last_px: (n,) where the run begins and ends along it.
    """

    scan: NDArray[np.intp]
    down: Mask
    at_px: FloatArray
    first_px: FloatArray
    last_px: FloatArray

    def take(self, which: NDArray[np.intp]) -> "Runs":
        return Runs(self.scan[which], self.down[which], self.at_px[which], self.first_px[which], self.last_px[which])

    def pixels(self, along_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., n) u and v of places (..., n) along the scan lines."""
        return np.where(self.down, self.at_px, along_px), np.where(self.down, along_px, self.at_px)

    @property
    def middle_px(self) -> FloatArray:
        return 0.5 * (self.first_px + self.last_px)


_NONE = Runs(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.bool_), np.zeros(0), np.zeros(0), np.zeros(0))


def weights_of(colour: FloatArray) -> FloatArray:
    """(3,) for blue, green and red, of sum 1: the sum of a pixel's colours in which white stands out most from turf."""
    green = max(float(colour[1]), 1.0)
    darker = np.maximum(green - colour, 0.0) + 0.1 * green
    return np.asarray(darker / darker.sum(), dtype=np.float64)


def grey_of(picture: UInt8Array, turf: Turf) -> UInt8Array:
    """(h, w): that sum of a picture's colours."""
    # To three channels, of which two are dropped: OpenCV has vector instructions for that, and none for one channel.
    weights = np.tile(weights_of(turf.colour), (3, 1))
    return np.asarray(cv2.extractChannel(cv2.transform(picture, weights), 0), dtype=np.uint8)


def find_runs(picture: UInt8Array, turf: Turf, settings: VisionSettings) -> Runs:
    """The runs on scan lines down the picture and across it, in its pixels."""
    height, width = picture.shape[:2]
    if turf.boundary_px is None:
        return _NONE
    # Nothing above the field's border is looked at. What is left goes evenly into all the grids of common pictures:
    # OpenCV averages whole pixels many times faster than parts of them.
    above = max(0, int(turf.boundary_px[:, 1].min() / turf.scale[1]) - 2) // SCAN_STEP_PX * SCAN_STEP_PX
    top = round(above * turf.scale[1])
    below = picture[top:]
    grey = grey_of(below, turf)
    level = _turf_level(grey, turf.mask[above:], settings)
    down, across = _scan_lines(np.asarray(cv2.transpose(grey), dtype=np.uint8)), _scan_lines(grey)
    widest_px = settings.widest * height
    first, second = _runs(down, level.T, width, widest_px), _runs(across, level, height - top, widest_px)
    scan, at_px, begins, ends = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    goes_down = np.arange(len(scan)) < len(first[0])
    scan[~goes_down] += len(down) + SCAN_GAP
    at_px[~goes_down] += top
    begins[goes_down] += top
    ends[goes_down] += top
    return _white_on_turf(Runs(scan, goes_down, at_px, begins, ends), picture, turf)


def _scan_lines(grey: UInt8Array) -> UInt8Array:
    """The means of every few rows."""
    height, width = grey.shape
    if height % SCAN_STEP_PX:
        return _reduced(grey, width, max(1, height // SCAN_STEP_PX))
    # The same as a resize, but whole rows at once, several times faster.
    first, second, third, fourth = (grey[row::SCAN_STEP_PX] for row in range(SCAN_STEP_PX))
    total = np.add(first, second, dtype=np.uint16) + np.add(third, fourth, dtype=np.uint16)
    return np.asarray(cv2.convertScaleAbs(total, alpha=1.0 / SCAN_STEP_PX), dtype=np.uint8)


def _reduced(picture: UInt8Array, width: int, height: int) -> UInt8Array:
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _turf_level(grey: UInt8Array, turf_mask: Mask, settings: VisionSettings) -> UInt8Array:
    """On a grid twice as coarse as the turf's mask: what has to be exceeded to be no turf, from the turf around."""
    width = turf_mask.shape[1]
    grey = _reduced(grey, width, turf_mask.shape[0])
    mask = turf_mask.view(np.uint8) * np.uint8(255)
    wide, near = max(3, width // _WIDE_SHARE // 2), max(3, width // _NEAR_SHARE // 2)
    far_mean, far_spread, _ = _around(grey, mask, wide)
    mask = _like(grey, mask, far_mean, far_spread)
    # Once more without what stands out from the turf close by: lines as pale as turf, which are in the mask.
    mean, spread, share = _around(grey, mask, near)
    mask = _like(grey, mask, mean, spread)
    mean, spread, share = _around(grey, mask, near)
    # Beside something wide there is none close by.
    few = share < _LEAST_SHARE
    np.copyto(mean, far_mean, where=few)
    np.copyto(spread, far_spread, where=few)
    level = mean + np.maximum(np.float32(_SIGMAS * _CLIPPED) * spread, settings.least_contrast)
    return np.asarray(cv2.convertScaleAbs(level), dtype=np.uint8)


def _around(grey: UInt8Array, mask: UInt8Array, window: int) -> tuple[Single, Single, Single]:
    """Mean and standard deviation of what is in the mask in a window around each pixel, and the mask's share of it.

    255 and 0 where that is nothing: no pixel exceeds it. On a grid twice as coarse.
    """
    size = max(1, grey.shape[1] // 2), max(1, grey.shape[0] // 2)
    # In 256ths, as whole numbers would be too coarse: the mean of four pixels is rounded up by an eighth on average,
    # which takes 40 from the variance of turf as bright as 150.
    masked = cv2.bitwise_and(grey, mask)
    share, mean, square = (
        np.asarray(
            cv2.boxFilter(cv2.resize(part, size, interpolation=cv2.INTER_AREA), cv2.CV_32F, (window, window)),
            np.float32,
        )
        for part in (
            np.multiply(one, by, dtype=np.uint16) for one, by in ((mask, 256), (masked, 256), (masked, masked))
        )
    )
    share *= np.float32(1.0 / (255.0 * 256.0))
    count = share + np.float32(1e-3)
    mean /= np.float32(256.0) * count
    square /= count
    square -= mean * mean
    spread = np.sqrt(np.maximum(square, np.float32(0.0), out=square), out=square)
    mean[share < 0.01] = 255.0
    return mean, spread, share


def _like(grey: UInt8Array, mask: UInt8Array, mean: Single, spread: Single) -> UInt8Array:
    """The mask without pixels that are farther from the mean around than turf is."""
    size = grey.shape[1], grey.shape[0]
    around = cv2.resize(cv2.convertScaleAbs(mean), size)
    limit = cv2.resize(cv2.convertScaleAbs(spread, alpha=_CLIP, beta=-0.5), size)  # down: whole numbers below it
    near = cv2.compare(cv2.absdiff(grey, around), limit, cv2.CMP_LE)
    return np.asarray(cv2.bitwise_and(near, mask), dtype=np.uint8)


def _runs(
    grey: UInt8Array, level: UInt8Array, extent_px: int, widest_px: float
) -> tuple[NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
    """Scan lines, their places across, where runs begin and where they end, (k,) each.

    grey: (n, length) a scan line per row. level: `_turf_level`, a scan line per row. extent_px: of all of them.
    """
    count, length = grey.shape
    grey = np.asarray(cv2.GaussianBlur(grey, (3, 1), 0), dtype=np.uint8)
    bar = np.asarray(cv2.resize(level, (length, count), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    apart = np.zeros((count, length + 1), dtype=np.uint8)  # so that no run goes on in the next row
    white = cv2.compare(grey, bar, cv2.CMP_GT)
    apart[:, :-1] = cv2.morphologyEx(white, cv2.MORPH_CLOSE, np.ones((1, 3), dtype=np.uint8))
    flat = apart.ravel()
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        changes = changes[1:]  # begins at the picture's corner
    pairs = changes[: len(changes) // 2 * 2].reshape(-1, 2)
    scan, first = np.divmod(pairs[:, 0], length + 1)
    last = pairs[:, 1] % (length + 1) - 1  # -1 after the modulo: a run up to the picture's border ends at length - 1
    inside = (first > 0) & (last < length - 1) & (last - first < widest_px)
    scan, first, last = scan[inside], first[inside], last[inside]
    before, after = _beyond(grey, bar, scan, np.array([first, last]), np.array([first - 1, last + 1]))
    return scan, (scan + 0.5) * (extent_px / count) - 0.5, first - before, last + after


def _white_on_turf(runs: Runs, picture: UInt8Array, turf: Turf) -> Runs:
    """Those with turf on either side that are white beside it."""
    aside = 0.15 * (runs.last_px - runs.first_px)
    # A thin line's halo in the compressed colours reaches some pixels.
    away = _BEYOND_PX[:, None] + aside
    places = np.array([runs.first_px - away, runs.last_px + away])
    kept = turf.at_uv(*runs.pixels(places)).any(axis=1).all(axis=0)
    places = np.array([runs.first_px - 2.0 - aside, runs.last_px + 2.0 + aside, runs.middle_px])
    before, after, white = _colours(picture, *runs.pixels(places), runs.down)
    step = white - 0.5 * (before + after)
    kept &= step @ weights_of(turf.colour) > _COLOUR_STEP * step[:, 1]
    kept &= np.minimum(np.minimum(step[:, 0], step[:, 1]), step[:, 2]) > 0.5 * _COLOUR_STEP * step[:, 1]
    return runs.take(np.flatnonzero(kept))


def _colours(picture: UInt8Array, u: FloatArray, v: FloatArray, down: Mask) -> FloatArray:
    """(..., n, 3) of the pixels at u, v (..., n), with their neighbours across the scan lines."""
    column = np.rint(u).astype(np.intp) + _ASIDE * down
    row = np.rint(v).astype(np.intp) + _ASIDE * ~down
    column = np.minimum(np.maximum(column, 0), picture.shape[1] - 1)
    row = np.minimum(np.maximum(row, 0), picture.shape[0] - 1)
    nearest = picture.reshape(-1, 3).take(row * picture.shape[1] + column, axis=0)
    return np.asarray(nearest.sum(axis=0, dtype=np.int32) / 3.0)


def _beyond(
    grey: UInt8Array, bar: UInt8Array, scan: NDArray[np.intp], inner: NDArray[np.intp], outer: NDArray[np.intp]
) -> FloatArray:
    """How far from the last pixel of a run, inner (..., n), to the next, outer, its border is, 0 to 1."""
    above = grey[scan, inner].astype(np.float64) - bar[scan, inner]
    below = bar[scan, outer].astype(np.float64) - grey[scan, outer]
    return np.minimum(np.maximum(above / np.maximum(above + below, 1e-6), 0.0), 1.0)
