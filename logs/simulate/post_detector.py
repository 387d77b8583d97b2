"""The goal posts that a detector finds in a block of images: some of those in sight, with noise, and some others.

The edges of a cylinder are where lines of sight touch it. They are seen at the camera's own height (the horizon) where
that is in the image and not hidden, else as near to it as can be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.pose import FloatArray
from logs.simulate.clipping import on_image
from logs.simulate.cylinders import Cylinders
from logs.simulate.hiding import hidden_below
from logs.simulate.view import View, share_found
from logs.simulate.vision_settings import NoiseSettings, PostSettings, VisionSettings

_GHOST_WIDTHS_PX = (4.0, 30.0)
_LEAST_SLOPE = 1.0001  # of distance over radius: nobody sees a post from inside


@dataclass(frozen=True, slots=True, eq=False)
class FoundPosts:
    """m posts, by image. images: (m,) rows of the view. edges_px: (m, 2, 2) left and right. feet_px: (m, 2), NaN where
    not seen. covariance_px2 (m, 4, 4), foot_covariance_px2 (m, 2, 2), as claimed."""

    images: NDArray[np.intp]
    edges_px: FloatArray
    covariance_px2: FloatArray
    feet_px: FloatArray
    foot_covariance_px2: FloatArray


def find_posts(view: View, cylinders: Cylinders, settings: VisionSettings, random: np.random.Generator) -> FoundPosts:
    """In no order within an image, as a detector knows none."""
    posts, noise = settings.posts, settings.noise
    images, index, low, high, tangents = _in_sight(view, cylinders, settings)
    range_m = np.linalg.norm(cylinders.positions[images, index] - view.centres[images, :2], axis=-1)
    share = share_found(
        range_m, view.blur_px[images], posts.near_chance, posts.half_range_m, posts.range_scale_m, posts.blur_half_px
    )
    found = random.uniform(size=len(images)) < share * cylinders.chances[index]
    images, index, low, high = images[found], index[found], low[found], high[found]
    tangents, range_m = tangents[found], range_m[found]
    edges = _edges(view, images, tangents, np.clip(view.centres[images, 2], low, high))
    tops, bottoms = _edges(view, images, tangents, high), _edges(view, images, tangents, low)
    feet = _feet(view, cylinders, settings, images, index)
    wide = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=-1) >= posts.least_width_px
    high_enough = np.linalg.norm(tops[:, 0] - bottoms[:, 0], axis=-1) >= posts.least_height_px
    seen = wide & high_enough
    images, edges, feet, range_m = images[seen], edges[seen], feet[seen], range_m[seen]
    sigma = noise.sigma_px + noise.sigma_px_per_m * range_m + noise.blur_share * view.blur_px[images]
    noisy = edges + sigma[:, None, None] * random.standard_normal(edges.shape)
    feet = feet + noise.foot_sigma_ratio * sigma[:, None] * random.standard_normal(feet.shape)
    in_order = np.sum((noisy[:, 1] - noisy[:, 0]) * (edges[:, 1] - edges[:, 0]), axis=-1) > 0.0
    haunted, ghost_edges, ghost_feet = _ghosts(view, posts, random)
    return _as_found(
        view.camera,
        np.concatenate([images[in_order], haunted]),
        np.concatenate([noisy[in_order], ghost_edges]),
        np.concatenate([feet[in_order], ghost_feet]),
        np.concatenate([sigma[in_order], np.full(len(haunted), noise.sigma_px)]),
        noise,
        random,
    )


def _in_sight(
    view: View, cylinders: Cylinders, settings: VisionSettings
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
    """Images and cylinders (m,) of which both edges are in sight; from which height to which (m,); tangents (m, 2, 2).

    A tangent is where a line of sight touches the cylinder, in the field frame; the left one first.
    """
    away = cylinders.positions - view.centres[:, None, :2]
    distance = np.hypot(away[..., 0], away[..., 1])
    outside = distance > _LEAST_SLOPE * cylinders.radii_m  # False for NaN
    sine = cylinders.radii_m / np.where(outside, distance, np.inf)
    cosine = np.sqrt(1.0 - sine**2)
    ahead = cosine[..., None] * away
    left = sine[..., None] * np.stack([-away[..., 1], away[..., 0]], axis=-1)
    from_camera = cosine[..., None, None] * np.stack([ahead + left, ahead - left], axis=-2)
    tangents = view.centres[:, None, None, :2] + from_camera
    tangents = np.where(outside[..., None, None], tangents, np.nan)
    ground = np.concatenate([tangents, np.zeros((*tangents.shape[:-1], 1))], axis=-1)
    top = ground + cylinders.heights_m[:, None, None] * np.array([0.0, 0.0, 1.0])
    low, high = on_image(view.camera, view.rays(ground), view.rays(top))
    hidden = hidden_below(view.centres, view.others, settings.robots, tangents.reshape(len(view), -1, 2))
    low = np.maximum(low * cylinders.heights_m[:, None], hidden.reshape(low.shape)).max(axis=-1)
    high = (high * cylinders.heights_m[:, None]).min(axis=-1)
    images, index = np.nonzero(high > low)
    return images, index, low[images, index], high[images, index], tangents[images, index]


def _edges(view: View, images: NDArray[np.intp], tangents: FloatArray, height_m: FloatArray) -> FloatArray:
    """Pixels (m, 2, 2) of the tangents at heights (m,)."""
    heights = np.broadcast_to(height_m[:, None, None], (len(images), 2, 1))
    return _pixels(view, images, np.concatenate([tangents, heights], axis=-1))


def _feet(
    view: View, cylinders: Cylinders, settings: VisionSettings, images: NDArray[np.intp], index: NDArray[np.intp]
) -> FloatArray:
    """Pixels (m, 2) of the middles of the cylinders' feet as seen; NaN where hidden or beside the image."""
    camera_at = view.centres[images]
    away = cylinders.positions[images, index] - camera_at[:, :2]
    distance = np.hypot(away[:, 0], away[:, 1])
    feet = camera_at[:, :2] + (1.0 - cylinders.radii_m[index] / distance)[:, None] * away
    pixels = _pixels(view, images, np.column_stack([feet, np.zeros(len(feet))])[:, None])[:, 0]
    hidden = hidden_below(camera_at, view.others[images], settings.robots, feet[:, None])[:, 0] > 0.0
    return np.where((view.camera.contains(pixels) & ~hidden)[:, None], pixels, np.nan)


def _pixels(view: View, images: NDArray[np.intp], points: FloatArray) -> FloatArray:
    """Pixels (m, c, 2) of points (m, c, 3) of the field in images (m,)."""
    rays = (points - view.centres[images, None]) @ np.swapaxes(view.camera_from_field[images], -1, -2)
    return view.camera.project(rays)[0]


def _ghosts(
    view: View, posts: PostSettings, random: np.random.Generator
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Images (g,) in which a post is seen that is not there, its edges (g, 2, 2) and its foot (g, 2)."""
    images = np.flatnonzero(random.uniform(size=len(view)) < posts.ghost_chance)
    width, height = view.camera.width_px - 1.0, view.camera.height_px - 1.0
    middle = random.uniform([0.0, 0.0], [width, 0.5 * height], (len(images), 2))
    half = 0.5 * random.uniform(*_GHOST_WIDTHS_PX, len(images))[:, None] * np.array([1.0, 0.0])
    below = random.uniform(0.5 * height, height, len(images))
    return images, np.stack([middle - half, middle + half], axis=1), np.column_stack([middle[:, 0], below])


def _as_found(
    camera: Camera,
    images: NDArray[np.intp],
    edges: FloatArray,
    feet: FloatArray,
    sigma: FloatArray,
    noise: NoiseSettings,
    random: np.random.Generator,
) -> FoundPosts:
    """The posts held on the image, shuffled, with the covariances that are claimed."""
    order = np.lexsort((random.uniform(size=len(images)), images))
    last = np.array([camera.width_px, camera.height_px]) - 0.5
    claimed = noise.claim_ratio * sigma[order]
    for_edges = np.maximum(claimed, noise.least_claim_px) ** 2
    for_feet = np.maximum(noise.foot_sigma_ratio * claimed, noise.least_claim_px) ** 2
    return FoundPosts(
        images[order],
        np.clip(edges[order], -0.5, last),
        for_edges[:, None, None] * np.eye(4),
        np.clip(feet[order], -0.5, last),
        for_feet[:, None, None] * np.eye(2),
    )
