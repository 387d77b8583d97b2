"""Where lines meet: L at the ends of both, T at the end of one, X inside both; with covariance from the lines'."""

import numpy as np

from fieldloc.vision.detections import SeenCorner, SeenLine
from fieldloc.vision.straight import Plane

_REACH_PX = 6.0  # beyond a line's end, beside two of the widths there, may a corner lie
_WITHIN = 1.5  # widths from a line's end on is inside it
_LEAST_RAD = 0.1  # between two lines: flatter crossings tell hardly a place


def find_corners(lines: tuple[SeenLine, ...], plane: Plane) -> tuple[SeenCorner, ...]:
    """The corners of lines in the picture, straight in the plane."""
    if len(lines) < 2:
        return ()
    ends = plane.from_picture(np.array([line.ends_px for line in lines]))
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    along = along / length[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    width = np.array([line.width_px for line in lines])
    number = np.arange(len(lines))
    pairs = np.argwhere(number[:, None] < number)
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
    pairs, points, share, kinds = pairs[meet], points[meet], (place / length[pairs])[meet], ending[meet]
    both = normals[pairs]
    pixels, vectors, _ = plane.normals_in_picture(np.stack([points, points], axis=1), both)
    # Across each line, its error at the corner is that share of the errors at its ends.
    at_ends = np.broadcast_to(both[:, :, None], (*both.shape[:2], 2, 2))
    _, across, _ = plane.normals_in_picture(ends[pairs], at_ends)
    gain = (np.stack([1.0 - share, share], axis=-1)[..., None] * across).reshape(-1, 2, 1, 4)
    errors = np.array([line.covariance_px2 for line in lines])[pairs]
    variance = (gain @ errors @ gain.transpose(0, 1, 3, 2))[..., 0]
    inverse = np.linalg.inv(vectors)
    covariance = inverse @ (variance * inverse.transpose(0, 2, 1))
    rows = zip(pixels[:, 0], covariance, kinds.tolist(), pairs.tolist(), strict=True)
    return tuple(SeenCorner(pixel, own, "XTL"[kind], (one, other)) for pixel, own, kind, (one, other) in rows)
