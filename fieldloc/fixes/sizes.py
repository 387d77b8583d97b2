"""What a post's size says about its distance once the scale is known: the ways to state it, one seam."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fieldloc.pose import FloatArray


class SizeModel(Protocol):
    """Size <-> distance of the post's axis, strictly monotonic. Arrays (...) that broadcast with the model's own."""

    def of_range(self, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The size seen from positive distances, and its derivative."""

    def range_of(self, size: FloatArray) -> FloatArray:
        """The distance from which a positive size is seen; NaN where there is none."""


@dataclass(frozen=True, slots=True)
class Ranges:
    """The size is the distance itself, in metres: laser, depth camera, a foot on the ground."""

    def of_range(self, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        return range_m, np.ones_like(range_m)

    def range_of(self, size: FloatArray) -> FloatArray:
        return np.where(size > 0, size, np.nan)


@dataclass(frozen=True, slots=True)
class InverseRanges:
    """The size is 1 / distance, per metre: in what a post's width and its foot's depth below the horizon are linear."""

    def of_range(self, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 1 / range_m, -1 / range_m**2

    def range_of(self, size: FloatArray) -> FloatArray:
        return np.asarray(1 / np.where(size > 0, size, np.nan))


@dataclass(frozen=True, slots=True)
class HalfWidths:
    """The size is half the angle between a cylinder's edges, radians: asin(radius / distance), exact.

    radius_m: one for all posts, or (n,) each post's own.
    """

    radius_m: FloatArray | float

    def __post_init__(self) -> None:
        if not np.all(np.asarray(self.radius_m) > 0):
            raise ValueError(f"radius_m is {self.radius_m}, must be positive")

    def of_range(self, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        # inside the post the angle stays at 90 degrees: a search that strays there is sent back by its residual
        sine = np.minimum(self.radius_m / range_m, 1.0)
        cosine = np.sqrt((1 - sine) * (1 + sine))
        slope = -sine / (range_m * np.where(cosine > 0, cosine, np.inf))
        return np.arcsin(sine), slope

    def range_of(self, size: FloatArray) -> FloatArray:
        possible = (size > 0) & (size < np.pi / 2)
        return np.asarray(self.radius_m / np.sin(np.where(possible, size, np.nan)))


@dataclass(frozen=True, slots=True)
class PaperSizes:
    """The paper's d = f D / C (above eq. 3): focal length in pixels, diameter in metres, size in pixels."""

    focal_px: float
    diameter_m: FloatArray | float

    def __post_init__(self) -> None:
        if not (self.focal_px > 0 and np.all(np.asarray(self.diameter_m) > 0)):
            raise ValueError(f"focal_px is {self.focal_px}, diameter_m {self.diameter_m}, must be positive")

    def of_range(self, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        size = self.focal_px * self.diameter_m / range_m
        return size, -size / range_m

    def range_of(self, size: FloatArray) -> FloatArray:
        return np.asarray(self.focal_px * self.diameter_m / np.where(size > 0, size, np.nan))
