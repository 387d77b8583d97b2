"""Which motions map a set of lines, circles and landmarks onto itself."""

import numpy as np

from fieldloc.pose import FloatArray, apply, wrap

TOLERANCE_M = 1e-3  # a map is drawn to the millimetre


_SIGMAS = 3.0  # by which landmarks may be apart that are each other's copies for all that is known


def symmetries(
    lines: FloatArray, circles: FloatArray, landmarks: FloatArray, sigmas_m: FloatArray | None = None
) -> FloatArray:
    """Poses (s, 3) that map the map onto itself, without the identity; headings in (-pi, pi], a half turn is +pi.

    lines: (n, 2, 2) end points. circles: (k, 3) x, y, radius. landmarks: (m, 3) x, y, diameter; labels play no part.
    A bounded map can only turn about its middle, so each kind of thing must have its centroid there, and the outermost
    point must land on another one. A map of concentric circles alone turns by any angle: it gets none listed.

    sigmas_m: (m,) how well landmarks are known, None for exactly. Where something else is exact, one that is not need
    only be the copy of another for all that is known.
    """
    segments = merge_segments(lines)
    sigmas_m = np.zeros(len(landmarks)) if sigmas_m is None else sigmas_m
    exact = landmarks[sigmas_m < TOLERANCE_M]
    if not len(segments) + len(circles) + len(exact):
        exact, sigmas_m = landmarks, np.zeros(len(landmarks))
    kinds = [segments.mean(axis=1), circles[:, :2], exact[:, :2]]
    centroids = np.array([points.mean(axis=0) for points in kinds if len(points)])
    if not len(centroids) or np.linalg.norm(centroids - centroids[0], axis=1).max() > TOLERANCE_M:
        return np.zeros((0, 3))
    middle = centroids[0]
    points = np.concatenate([segments.reshape(-1, 2), circles[:, :2], exact[:, :2]]) - middle
    radius = np.linalg.norm(points, axis=1)
    outermost = int(np.argmax(radius))
    if radius[outermost] < TOLERANCE_M:
        return np.zeros((0, 3))
    angles = np.arctan2(points[:, 1], points[:, 0])
    slack = TOLERANCE_M / radius[outermost]
    equally_far = np.abs(radius - radius[outermost]) < TOLERANCE_M
    # in (-pi + slack, pi + slack], so that rounding does not make a half turn negative
    turns = np.sort(slack - wrap(slack + angles[outermost] - angles[equally_far]))
    turns = turns[np.concatenate([[True], np.diff(turns) > slack])]
    found = []
    for turn in turns[np.abs(turns) > slack]:
        pose = np.array([0.0, 0.0, turn])
        pose[:2] = middle - apply(pose, middle)
        pose[np.abs(pose) < 1e-12] = 0.0  # rounding, no motion
        turned_circles = np.column_stack([apply(pose, circles[:, :2]), circles[:, 2]])
        turned_landmarks = np.column_stack([apply(pose, landmarks[:, :2]), landmarks[:, 2]])
        if (
            _same_rows(_either_way(segments), apply(pose, segments).reshape(-1, 4))
            and _same_rows(circles, turned_circles)
            and _same_landmarks(landmarks, turned_landmarks, _SIGMAS * sigmas_m)
        ):
            found.append(pose)
    return np.array(found).reshape(-1, 3)


def merge_segments(lines: FloatArray) -> FloatArray:
    """(m, 2, 2): pieces that continue or overlap each other joined, so that it does not matter how a line was drawn."""
    pieces = [np.asarray(line, dtype=np.float64) for line in lines]
    merged: list[FloatArray] = []
    while pieces:
        line = pieces.pop()
        rest = []
        for other in pieces:
            joined = _join(line, other)
            if joined is None:
                rest.append(other)
            else:
                line = joined
        if len(rest) < len(pieces):
            rest.append(line)  # it grew and may now touch one that it missed
        else:
            merged.append(line)
        pieces = rest
    return np.array(merged).reshape(-1, 2, 2)


def _join(a: FloatArray, b: FloatArray) -> FloatArray | None:
    """One segment (2, 2) if b lies on a's line and touches it."""
    direction = a[1] - a[0]
    length = float(np.hypot(direction[0], direction[1]))
    direction = direction / length
    normal = np.array([-direction[1], direction[0]])
    if np.abs((b - a[0]) @ normal).max() > TOLERANCE_M:
        return None
    along = (b - a[0]) @ direction
    if along.max() < -TOLERANCE_M or along.min() > length + TOLERANCE_M:
        return None
    start, end = min(0.0, float(along.min())), max(length, float(along.max()))
    return np.array([a[0] + start * direction, a[0] + end * direction])


def _either_way(segments: FloatArray) -> FloatArray:
    """(2m, 4): each segment from both ends."""
    return np.concatenate([segments, segments[:, ::-1]]).reshape(-1, 4)


def _same_rows(rows: FloatArray, others: FloatArray) -> bool:
    """Whether each of the others is one of the rows."""
    if not len(others):
        return True
    return bool((np.abs(others[:, None] - rows).max(axis=-1).min(axis=1) < TOLERANCE_M).all())


def _same_landmarks(landmarks: FloatArray, turned: FloatArray, slack_m: FloatArray) -> bool:
    """Whether each that is turned is one of the landmarks; slack_m: (m,) by how much each may be beside its place."""
    apart = np.abs(turned[:, None] - landmarks)
    near = apart[..., :2].max(axis=-1) < TOLERANCE_M + np.hypot(slack_m[:, None], slack_m)
    return bool((near & (apart[..., 2] < TOLERANCE_M)).any(axis=1).all())
