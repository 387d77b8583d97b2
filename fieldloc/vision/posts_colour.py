"""How much of a post's colour there is in a pixel."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.colours import Colour
from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array

_CHROMATIC = 40  # of 255, between the largest and the least part of a colour that has a hue

_SAME_HUE = 0.87  # the cosine of 30 degrees


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture as one looks for a post's colour in it."""

    picture: UInt8Array
    colour: Colour

    def colours_at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """(..., 3) the nearest pixels, those of the border beside the picture."""
        return nearest(self.picture, u, v).astype(np.float64)

    def likeness_at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return self.likeness(nearest(self.picture, u, v))

    def likeness(self, pixels: UInt8Array) -> FloatArray:
        """(...,) of pixels (..., 3)."""
        if not pixels.size:
            return np.zeros(pixels.shape[:-1])
        alike = likeness(pixels.reshape(-1, pixels.shape[-2], 3), self.colour)
        return alike.reshape(pixels.shape[:-1]).astype(np.float64)

    def likeness_of(self, colours: FloatArray) -> FloatArray:
        """As `likeness`, of colours (..., 3)."""
        direction = _hue_direction(self.colour)
        if direction is not None:
            return np.asarray(np.maximum(colours @ direction, 0.0))
        first, second, third = colours[..., 0], colours[..., 1], colours[..., 2]
        if max(self.colour) > 127:
            return np.minimum(np.minimum(first, second), third)
        return np.asarray(255.0 - np.maximum(np.maximum(first, second), third))

    def has_hue(self, colours: FloatArray) -> NDArray[np.bool_]:
        """Whether colours (..., 3) have the hue; all of them where a post has none."""
        direction = _hue_direction(self.colour)
        if direction is None:
            return np.ones(colours.shape[:-1], dtype=np.bool_)
        away = colours - colours.mean(axis=-1, keepdims=True)
        return np.asarray(away @ direction > _SAME_HUE * np.linalg.norm(away, axis=-1))

    def contains(self, u: FloatArray, v: FloatArray) -> NDArray[np.bool_]:
        height, width = self.picture.shape[:2]
        return np.asarray((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1))


def likeness(picture: UInt8Array, colour: Colour) -> UInt8Array:
    """(h, w) how much of the colour is in each pixel: for white the least of its parts, for black what the largest
    lacks, for a hue the part of the pixel's own hue along it."""
    direction = _hue_direction(colour)
    if direction is not None:
        return np.asarray(cv2.transform(picture, direction[None]), dtype=np.uint8)
    blue, green, red = picture[..., 0], picture[..., 1], picture[..., 2]
    if max(colour) > 127:
        return np.asarray(np.minimum(np.minimum(blue, green), red))
    return np.asarray(255 - np.maximum(np.maximum(blue, green), red))


def nearest(picture: UInt8Array, u: FloatArray, v: FloatArray) -> UInt8Array:
    """(..., c) or (...,) the nearest pixels to points, those of the border beside the picture."""
    shape = np.broadcast(u, v).shape
    if not math.prod(shape):
        return np.zeros(shape + picture.shape[2:], dtype=np.uint8)
    places = np.empty((2, *shape), dtype=np.float32)
    places[0], places[1] = u, v
    across, down = places.reshape(2, -1, shape[-1])
    pixels = cv2.remap(picture, across, down, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(pixels, dtype=np.uint8).reshape(shape + picture.shape[2:])


def _hue_direction(colour: Colour) -> FloatArray | None:
    """(3,) of length 1 in BGR, at right angles to grey; None for a colour without a hue."""
    if max(colour) - min(colour) < _CHROMATIC:
        return None
    direction = np.array(colour[::-1], dtype=np.float64)
    direction -= direction.mean()
    return np.asarray(direction / np.linalg.norm(direction))
