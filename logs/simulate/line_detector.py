"""The lines that a detector finds in a block of images: parts of what is there, with noise, and some of what is not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from logs.simulate.clipping import on_image, on_screen
from logs.simulate.hiding import hidden_part
from logs.simulate.segments import Segments
from logs.simulate.view import View, share_found
from logs.simulate.vision_settings import LineSettings, NoiseSettings, OtherRobotSettings, VisionSettings

_GAP_SHARE = (0.04, 0.15)  # of a line that is found as two
_GAP_MIDDLE = (0.3, 0.7)
_GHOST_LENGTHS = 4.0  # the longest ghost, in least lengths
_LEAST_PART = 1e-9  # of a segment, rounding


@dataclass(frozen=True, slots=True, eq=False)
class FoundLines:
    """m lines, by image. images: (m,) rows of the view. ends_px: (m, 2, 2). covariance_px2: (m, 4, 4), as claimed."""

    images: NDArray[np.intp]
    ends_px: FloatArray
    covariance_px2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Parts of segments: image and segment (m,), shares of the segment's length where each begins and ends (m,)."""

    images: NDArray[np.intp]
    segments: NDArray[np.intp]
    low: FloatArray
    high: FloatArray

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "_Pieces":
        return _Pieces(self.images[chosen], self.segments[chosen], self.low[chosen], self.high[chosen])

    def between(self, low: FloatArray, high: FloatArray) -> "_Pieces":
        """Those of which something is left between new ends (m,)."""
        return _Pieces(self.images, self.segments, low, high).only(high - low > _LEAST_PART)

    def beside(self, others: "_Pieces") -> "_Pieces":
        return _Pieces(
            np.concatenate([self.images, others.images]),
            np.concatenate([self.segments, others.segments]),
            np.concatenate([self.low, others.low]),
            np.concatenate([self.high, others.high]),
        )


def find_lines(view: View, segments: Segments, settings: VisionSettings, random: np.random.Generator) -> FoundLines:
    """In no order within an image, as a detector knows none."""
    lines, noise = settings.lines, settings.noise
    rays = view.rays(np.concatenate([segments.ends, np.zeros((*segments.ends.shape[:-1], 1))], axis=-1))
    low, high = on_image(view.camera, rays[:, :, 0], rays[:, :, 1])
    images, index = np.nonzero(high - low > _LEAST_PART)
    pieces = _Pieces(images, index, low[images, index], high[images, index])
    if settings.robots.hide:
        pieces = _unhidden(pieces, view, segments, settings.robots)
        pieces = _merged(pieces, lines.merge_chance, random)
    pieces = pieces.only(_is_found(pieces, view, rays, segments.chances, lines, random))
    pieces = _split(pieces, rays, lines.split_chance, random)
    pieces = _shortened(pieces, rays, lines.shortened_share, random)
    ends = _ends(pieces, rays)
    pixels, _ = view.camera.project(ends)
    long_enough = np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=-1) >= lines.least_length_px
    pieces, ends, pixels = pieces.only(long_enough), ends[long_enough], pixels[long_enough]
    blur = noise.blur_share * view.blur_px[pieces.images, None]
    sigma = noise.sigma_px + noise.sigma_px_per_m * np.linalg.norm(ends, axis=-1) + blur
    pixels = pixels + sigma[..., None] * random.standard_normal(pixels.shape)
    haunted, ghosts = _ghosts(view, lines, random)
    images = np.concatenate([pieces.images, haunted])
    pixels = np.concatenate([pixels, ghosts])
    sigma = np.concatenate([sigma, np.full((len(haunted), 2), noise.sigma_px)])
    return _on_screen(view, images, pixels, sigma, noise, random)


def _unhidden(pieces: _Pieces, view: View, segments: Segments, robots: OtherRobotSettings) -> _Pieces:
    """What of the pieces no other robot hides."""
    for column in range(view.others.shape[1]):
        ends = segments.ends[pieces.images, pieces.segments]
        robot = view.others[pieces.images, column]
        low, high = hidden_part(view.centres[pieces.images], robot, robots, ends[:, 0], ends[:, 1])
        hidden = high > low
        before = pieces.between(pieces.low, np.where(hidden, np.minimum(pieces.high, low), pieces.high))
        behind = pieces.between(np.where(hidden, np.maximum(pieces.low, high), np.inf), pieces.high)
        pieces = before.beside(behind)
    return pieces


def _merged(pieces: _Pieces, chance: float, random: np.random.Generator) -> _Pieces:
    """Of some segments that are in pieces, one piece from the first one's beginning to the last one's end."""
    pieces = pieces.only(np.lexsort((pieces.low, pieces.segments, pieces.images)))
    if not len(pieces.images):
        return pieces
    new = np.ones(len(pieces.images), dtype=np.bool_)
    new[1:] = (np.diff(pieces.images) != 0) | (np.diff(pieces.segments) != 0)
    first = np.flatnonzero(new)
    whole = random.uniform(size=len(first)) < chance
    group = np.cumsum(new) - 1
    high = np.where(whole[group], np.maximum.reduceat(pieces.high, first)[group], pieces.high)
    return _Pieces(pieces.images, pieces.segments, pieces.low, high).only(new | ~whole[group])


def _is_found(
    pieces: _Pieces,
    view: View,
    rays: FloatArray,
    chances: FloatArray,
    lines: LineSettings,
    random: np.random.Generator,
) -> NDArray[np.bool_]:
    near, far = np.linalg.norm(_ends(pieces, rays), axis=-1).T
    middle_m = 2.0 * near * far / (near + far)  # where the middle of a picture of the ground lies
    blur_px = view.blur_px[pieces.images]
    share = share_found(
        middle_m, blur_px, lines.near_chance, lines.half_range_m, lines.range_scale_m, lines.blur_half_px
    )
    return np.asarray(random.uniform(size=len(share)) < share * chances[pieces.segments])


def _split(pieces: _Pieces, rays: FloatArray, chance: float, random: np.random.Generator) -> _Pieces:
    count = len(pieces.images)
    draw, middle, half = random.uniform(
        [0.0, _GAP_MIDDLE[0], 0.5 * _GAP_SHARE[0]], [1.0, _GAP_MIDDLE[1], 0.5 * _GAP_SHARE[1]], (count, 3)
    ).T
    broken = draw < chance
    before = pieces.between(pieces.low, np.where(broken, _along(pieces, rays, middle - half), pieces.high))
    behind = pieces.between(np.where(broken, _along(pieces, rays, middle + half), np.inf), pieces.high)
    return before.beside(behind)


def _shortened(pieces: _Pieces, rays: FloatArray, share: float, random: np.random.Generator) -> _Pieces:
    lost = random.uniform(0.0, share, (2, len(pieces.images)))
    return pieces.between(_along(pieces, rays, lost[0]), _along(pieces, rays, 1.0 - lost[1]))


def _along(pieces: _Pieces, rays: FloatArray, share: FloatArray) -> FloatArray:
    """Shares (m,) of the segments at shares (m,) of the pieces' pictures, exact for a lens without distortion.

    A picture's point is the mean of its ends weighted by 1 / depth.
    """
    depth = np.maximum(_ends(pieces, rays)[..., 2], 1e-3)
    weight = share * depth[:, 0]
    weight = weight / (weight + (1.0 - share) * depth[:, 1])
    # exact at both ends
    return np.asarray((1.0 - weight) * pieces.low + weight * pieces.high)


def _ends(pieces: _Pieces, rays: FloatArray) -> FloatArray:
    """Rays (m, 2, 3) to the ends of the pieces."""
    start, end = np.moveaxis(rays[pieces.images, pieces.segments], 1, 0)
    shares = np.stack([pieces.low, pieces.high], axis=-1)[..., None]
    return np.asarray((1.0 - shares) * start[:, None] + shares * end[:, None])


def _ghosts(view: View, lines: LineSettings, random: np.random.Generator) -> tuple[NDArray[np.intp], FloatArray]:
    """Images (g,) in which a line is seen that is not there, and its ends (g, 2, 2), some beside the image."""
    images = np.flatnonzero(random.uniform(size=len(view)) < lines.ghost_chance)
    middle = random.uniform([0.0, 0.0], [view.camera.width_px - 1.0, view.camera.height_px - 1.0], (len(images), 2))
    angle = random.uniform(0.0, np.pi, len(images))
    length = lines.least_length_px * random.uniform(1.0, _GHOST_LENGTHS, len(images))
    half = 0.5 * length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return images, np.stack([middle - half, middle + half], axis=1)


def _on_screen(
    view: View,
    images: NDArray[np.intp],
    pixels: FloatArray,
    sigma: FloatArray,
    noise: NoiseSettings,
    random: np.random.Generator,
) -> FoundLines:
    """The lines cut where noise moved them beside the image, shuffled, with the covariance that is claimed."""
    low, high = on_screen(view.camera, pixels[:, 0], pixels[:, 1])
    shares = np.stack([low, high], axis=-1)[..., None]
    pixels = (1.0 - shares) * pixels[:, :1] + shares * pixels[:, 1:]
    swapped = random.uniform(size=len(images)) < 0.5
    pixels[swapped], sigma[swapped] = pixels[swapped, ::-1], sigma[swapped, ::-1]
    order = np.lexsort((random.uniform(size=len(images)), images))
    order = order[(high > low)[order]]
    claimed = np.maximum(noise.claim_ratio * sigma[order], noise.least_claim_px)
    covariance = np.zeros((len(order), 4, 4))
    covariance[:, range(4), range(4)] = np.repeat(claimed**2, 2, axis=1)
    return FoundLines(images[order], pixels[order], covariance)
