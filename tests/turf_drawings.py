"""Pictures of white on turf drawn by distance, with edges as sharp as a lens makes them; there is no camera."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

Picture = NDArray[np.uint8]

GREEN = (50.0, 140.0, 60.0)
WHITE = (235.0, 240.0, 238.0)


def turf(rng: np.random.Generator, *, colour: tuple[float, float, float] = GREEN, top: int = 60) -> FloatArray:
    """(480, 640, 3) turf up to row `top`, a grey wall above."""
    light = np.empty((480, 640, 3))
    light[:] = colour
    light += rng.normal(0.0, 6.0, (480, 640, 1)) * np.array(colour) / max(colour)
    light[:top] = (120.0, 115.0, 125.0)
    return light


def with_stripe(light: FloatArray, first: FloatArray, last: FloatArray, width: tuple[float, float]) -> FloatArray:
    """A white stripe between two points, of width[0] at the first and width[1] at the last."""
    v, u = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    along = (last - first) / np.linalg.norm(last - first)
    place = (u - first[0]) * along[0] + (v - first[1]) * along[1]
    off = (v - first[1]) * along[0] - (u - first[0]) * along[1]
    length = float(np.linalg.norm(last - first))
    half = 0.5 * np.interp(place / length, [0.0, 1.0], width)
    return _painted(light, np.minimum(half - np.abs(off), np.minimum(place, length - place)))


def with_ellipse(light: FloatArray, centre: FloatArray, axes: tuple[float, float], width: float) -> FloatArray:
    """A ring, about as wide everywhere."""
    v, u = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    x, y = (u - centre[0]) / axes[0], (v - centre[1]) / axes[1]
    radius = np.hypot(x, y)
    gradient = np.hypot(x / axes[0], y / axes[1]) / np.maximum(radius, 1e-9)
    return _painted(light, 0.5 * width - np.abs(radius - 1.0) / np.maximum(gradient, 1e-9))


def with_spot(light: FloatArray, centre: FloatArray, axes: tuple[float, float]) -> FloatArray:
    v, u = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    radius = np.hypot((u - centre[0]) / axes[0], (v - centre[1]) / axes[1])
    return _painted(light, (1.0 - radius) * min(axes))


def exposed(light: FloatArray, rng: np.random.Generator, noise: float = 2.0) -> Picture:
    blurred = cv2.GaussianBlur(light, (0, 0), 0.7)
    return np.clip(blurred + rng.normal(0.0, noise, light.shape), 0, 255).astype(np.uint8)


def _painted(light: FloatArray, inside: FloatArray) -> FloatArray:
    """inside: how many pixels inside the white a pixel's middle is."""
    cover = np.clip(inside + 0.5, 0.0, 1.0)[..., None]
    return light * (1.0 - cover) + np.array(WHITE) * cover
