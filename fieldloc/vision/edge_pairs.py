"""Candidates for lines from OpenCV's own finders: straight edges, two and two with white between them.

`lsd`: the line segment detector (Grompone von Gioi et al. 2010) on the picture at half its size. Its default scale of
0.8 returns coordinates 0.125 pixels too small. `hough`: Canny's edges and the probabilistic Hough transform, as in the
paper's experiment. Both find the edges of everything; the profiles across tell which pairs are lines.
"""

import cv2
import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.ellipse import Ellipse
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.segments import Segments
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.straight import Plane
from fieldloc.vision.turf import Turf

_LSD_OFFSET_PX = 0.125
_CANNY = (50, 150)
_HOUGH_VOTES, _HOUGH_GAP_PX = 30, 5
_MOST = 400  # edges, the longest
_PARALLEL = 0.15  # sine of the angle between the edges of a line: perspective makes it wider at one end
_OVERLAP = 0.5  # of the shorter edge beside the longer


def edge_pairs(
    grey: UInt8Array, turf: Turf, circle: Ellipse | None, plane: Plane, settings: VisionSettings
) -> Segments:
    """The middles between edges side by side, straight in the plane, but for those that are the circle's."""
    edges = (_lsd if settings.finder == "lsd" else _hough)(grey, settings.least_length_px)
    edges = edges[(turf.below_px(edges) > 0.0).all(axis=1)]
    edges = plane.from_picture(edges)
    along = edges[:, 1] - edges[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    order = np.argsort(-length)[:_MOST]
    edges, along, length = edges[order], along[order] / length[order, None], length[order]
    if len(edges) < 2:
        return Segments(np.zeros((0, 2, 2)), np.zeros((0, 2)))
    # Of the longer (row) to the shorter edge (column): places along and distances across of both its ends.
    relative = edges[None] - edges[:, None, :1]
    place = (relative * along[:, None, None]).sum(axis=-1)
    off = relative[..., 1] * along[:, None, None, 0] - relative[..., 0] * along[:, None, None, 1]
    together = np.clip(place, 0.0, length[:, None, None])
    overlap = np.abs(together[..., 1] - together[..., 0])
    middle = np.abs(off.mean(axis=-1))
    pairs = (overlap > _OVERLAP * length) & (middle < settings.widest * grey.shape[0]) & (middle > 1.0)
    pairs &= np.abs(off[..., 1] - off[..., 0]) < _PARALLEL * length + 2.0
    pairs &= (off[..., 0] * off[..., 1] > 0.0) & (np.arange(len(edges)) > np.arange(len(edges))[:, None])
    first, second = np.nonzero(pairs)
    across = np.stack([-along[first, 1], along[first, 0]], axis=1)
    distance = off[first, second]
    ends = edges[second] - 0.5 * distance[..., None] * across[:, None]
    if circle is not None and len(ends):
        aside = np.abs(circle.distance(ends.mean(axis=1))) < np.abs(distance).max(axis=1) + 2.0
        ends, distance = ends[~aside], distance[~aside]
    return Segments(ends, np.abs(distance))


def _lsd(grey: UInt8Array, least_length_px: float) -> FloatArray:
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    found = cv2.createLineSegmentDetector().detect(small)[0]
    if found is None:
        return np.zeros((0, 2, 2))
    ends = 2.0 * (np.asarray(found, dtype=np.float64).reshape(-1, 2, 2) + _LSD_OFFSET_PX) + 0.5
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0.5 * least_length_px
    return np.asarray(ends[long])


def _hough(grey: UInt8Array, least_length_px: float) -> FloatArray:
    edges = cv2.Canny(cv2.GaussianBlur(grey, (5, 5), 0), *_CANNY)
    found = cv2.HoughLinesP(edges, 1.0, np.pi / 360.0, _HOUGH_VOTES, None, 0.8 * least_length_px, _HOUGH_GAP_PX)
    return np.zeros((0, 2, 2)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 2, 2)
