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
    pairs = np.stack(np.triu_indices(len(lines), 1), axis=1)
    first, second = normals[pairs[:, 0]], normals[pairs[:, 1]]
    turned = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    kept = np.abs(turned) >= _LEAST_RAD
    pairs, first, second, turned = pairs[kept], first[kept], second[kept], turned[kept]
    # Where n . x = n . (an end) of both lines.
    value = (normals * ends[:, 0]).sum(axis=1)[pairs]
    u = value[:, 0] * second[:, 1] - value[:, 1] * first[:, 1]
    v = value[:, 1] * first[:, 0] - value[:, 0] * second[:, 0]
    points = np.stack([u, v], axis=1) / turned[:, None]
    place = ((points[:, None] - ends[pairs, 0]) * along[pairs]).sum(axis=2)
    far = place > 0.5 * length[pairs]
    inside = np.where(far, length[pairs] - place, place)  # from the nearer end on
    near = width[pairs, far.astype(np.intp)]
    meet = (inside > -(_REACH_PX + 2.0 * near)).all(axis=1) & np.isfinite(points).all(axis=1)
    ending = np.count_nonzero(inside < _WITHIN * np.maximum(near, near[:, ::-1]) + 0.5 * _REACH_PX, axis=1)
    corners = []
    for row in np.flatnonzero(meet):
        one, other = pairs[row].tolist()
        share = place[row] / length[pairs[row]]
        seen = _in_picture(points[row], share, [lines[one], lines[other]], normals[pairs[row]], plane)
        corners.append(SeenCorner(*seen, "XTL"[ending[row]], (one, other)))
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
