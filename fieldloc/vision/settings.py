"""What the search for lines may be told. The defaults work on every picture seen so far."""

from dataclasses import dataclass
from typing import Literal

Finder = Literal["runs", "lsd", "hough"]


@dataclass(frozen=True, slots=True)
class VisionSettings:
    """finder: where candidates for lines come from: white runs on scan lines, OpenCV's line segment detector, or
    Canny's edges with Hough's transform, as in the paper's experiment. The edges are fitted afterwards whatever it is.

    least_contrast: of 255, between a line and the turf beside it. least_length_px: of a piece of line, in pictures of
    640 x 480; it grows with the picture. widest: a line's width is at most this share of the picture's height.
    """

    finder: Finder = "runs"
    least_contrast: float = 12.0
    least_length_px: float = 20.0
    widest: float = 0.15
