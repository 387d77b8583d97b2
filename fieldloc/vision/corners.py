"""Where lines meet: L at the ends of both, T at the end of one, X inside both; with covariance from the lines'."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenCorner, SeenLine
from fieldloc.vision.straight import Plane

_REACH_PX = 6.0  # beyond a line's end, beside two of the widths there, may a corner lie
_WITHIN = 1.5  # widths from a line's end on is inside it
_LEAST_RAD = 0.1  # between two lines: flatter crossings tell hardly a place


def find_corners(lines: tuple[SeenLine, ...], plane: Plane) -> tuple[SeenCorner, ...]:
    """The corners of lines in the picture, straight in the plane."""
    if len(lines) < 2:
        return ()
    ends = plane.from_picture(np.stack([line.ends_px for line in lines]))
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    along = along / length[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    width = np.stack([line.width_px for line in lines])
    corners = []
    for one, other in zip(*np.triu_indices(len(lines), 1), strict=True):
        rows = np.array([one, other])
        if abs(along[one] @ normals[other]) < _LEAST_RAD:
            continue
        point = np.linalg.solve(normals[rows], (normals[rows] * ends[rows, 0]).sum(axis=1))
        place = ((point - ends[rows, 0]) * along[rows]).sum(axis=1)
        far = place > 0.5 * length[rows]
        inside = np.where(far, length[rows] - place, place)  # from the nearer end on
        near = width[rows, far.astype(np.intp)]
        if not ((inside > -(_REACH_PX + 2.0 * near)).all() and np.isfinite(point).all()):
            continue
        ending = inside < _WITHIN * np.maximum(near, near[::-1]) + 0.5 * _REACH_PX
        kind = "XTL"[int(ending.sum())]
        share = place / length[rows]
        pixel, covariance = _in_picture(point, share, [lines[one], lines[other]], normals[rows], plane)
        corners.append(SeenCorner(pixel, covariance, kind, (int(one), int(other))))
    return tuple(corners)


def _in_picture(
    point: FloatArray, share: FloatArray, lines: list[SeenLine], normals: FloatArray, plane: Plane
) -> tuple[FloatArray, FloatArray]:
    """The pixel of a corner (2,) of the plane and its covariance. share: (2,) of either line's length where it lies."""
    places, vectors, _ = plane.normals_in_picture(np.stack([point, point]), normals)
    variance = np.zeros(2)
    for row, line in enumerate(lines):
        # Across the line, its error at the corner is that share of the errors at its ends.
        at_ends = plane.from_picture(line.ends_px)
        across = plane.normals_in_picture(at_ends, np.broadcast_to(normals[row], (2, 2)))[1]
        weight = np.array([1.0 - share[row], share[row]])
        gain = (weight[:, None] * across).ravel()
        variance[row] = gain @ line.covariance_px2 @ gain
    inverse = np.linalg.inv(vectors)
    return places[0], inverse @ np.diag(variance) @ inverse.T
