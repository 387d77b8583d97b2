"""What is found in one picture, in pixels, each with the covariance of its own fit. Knows no map and no camera.

Pixels are (u, v) with pixel centres at integers, as in `fieldloc.camera`. What is found need not be what it looks like:
a window frame passes for a post, a robot's leg for a line. Who solves for the pose has to reckon with it.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.measurements import LineObservation, PostObservation
from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SeenLine:
    """The visible part of a white line's middle.

    ends_px: (2, 2). covariance_px2: (4, 4) of (u0, v0, u1, v1), which says nothing of where along it a line ends.
    width_px: (2,) across the line at either end, NaN where only one edge was found; width_sigma_px: (2,).
    """

    ends_px: FloatArray
    covariance_px2: FloatArray
    width_px: FloatArray
    width_sigma_px: FloatArray

    def observation(self) -> LineObservation:
        return LineObservation(self.ends_px, self.covariance_px2)


@dataclass(frozen=True, slots=True, eq=False)
class SeenPost:
    """A goal post: two edges, each a straight piece from its upper to its lower end.

    left_px, right_px: (2, 2) upper and lower end of each. covariance_px2: (8, 8) of both, in that order, across the
    edges; along them the ends are where the picture or the post ends and say nothing.
    foot_px: (2,) the middle of its visible contact with the ground, so a radius in front of its axis, None where it
    is hidden or beside the picture; foot_covariance_px2: (2, 2) with it.
    top_px: (2,) where the crossbar's upper edge ends at this post's outer edge; None where it is not seen.
    """

    left_px: FloatArray
    right_px: FloatArray
    covariance_px2: FloatArray
    foot_px: FloatArray | None = None
    foot_covariance_px2: FloatArray | None = None
    top_px: FloatArray | None = None
    top_covariance_px2: FloatArray | None = None

    @property
    def box_px(self) -> FloatArray:
        """(4,) left, upper, right, lower of all that is seen of it."""
        ends = np.concatenate([self.left_px, self.right_px])
        return np.concatenate([ends.min(axis=0), ends.max(axis=0)])

    def observation(self) -> PostObservation:
        """The middle of either edge: what one image's fix takes."""
        half = np.zeros((4, 8))
        half[:2, 0:2] = half[:2, 2:4] = half[2:, 4:6] = half[2:, 6:8] = 0.5 * np.eye(2)
        edges = np.stack([self.left_px.mean(axis=0), self.right_px.mean(axis=0)])
        return PostObservation(edges, half @ self.covariance_px2 @ half.T, self.foot_px, self.foot_covariance_px2)


@dataclass(frozen=True, slots=True, eq=False)
class SeenCircle:
    """The visible part of a circle's line: points_px (n, 2) on the middle of the line, sigma_px (n,) across it.

    ellipse: (5,) centre u, v, semi-axes (larger first), angle of the larger from u (rad); points fix it better than
    the five numbers do where little of it is seen.
    """

    points_px: FloatArray
    sigma_px: FloatArray
    ellipse: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SeenCorner:
    """Where lines meet: point_px (2,), covariance_px2 (2, 2), kind "L", "T" or "X".

    lines: rows of the lines that meet.
    """

    point_px: FloatArray
    covariance_px2: FloatArray
    kind: str
    lines: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class SeenMark:
    """A penalty mark (or the centre's): centre_px (2,), covariance_px2 (2, 2)."""

    centre_px: FloatArray
    covariance_px2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """All of one picture of width_px by height_px.

    boundary_px: (k, 2) the upper border of the field from left to right; None where no field is seen.
    """

    width_px: int
    height_px: int
    lines: tuple[SeenLine, ...] = ()
    posts: tuple[SeenPost, ...] = ()
    circles: tuple[SeenCircle, ...] = ()
    corners: tuple[SeenCorner, ...] = ()
    marks: tuple[SeenMark, ...] = ()
    boundary_px: FloatArray | None = None
