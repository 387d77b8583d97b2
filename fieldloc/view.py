"""What of a line on the ground is in the image: the paper's cut of a line at the image's border (sec. 3.2, Table 1)."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

_SAMPLES = 257  # per line: a visible part shorter than 1/256 of its line may be missed
_HALVINGS = 46  # 1/256 halved so often is below the rounding of the end points


def visible_parts(
    camera: Camera, mount: CameraMount, segments_in_robot: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Visible parts (m, 2, 2) of robot-frame ground segments (n, 2, 2), and the index (m,) of each one's segment.

    A part runs in its segment's direction and ends where the segment ends or leaves the image, exact to rounding. With
    a distorted lens one segment can leave and come back.
    """
    start, along = segments_in_robot[:, 0], segments_in_robot[:, 1] - segments_in_robot[:, 0]

    def visible(index: NDArray[np.intp], share: FloatArray) -> NDArray[np.bool_]:
        points = start[index] + share[:, None] * along[index]
        return project_points(camera, mount, np.column_stack([points, np.zeros(len(points))]))[1]

    count = len(segments_in_robot)
    shares = np.linspace(0.0, 1.0, _SAMPLES)
    seen = visible(np.repeat(np.arange(count), _SAMPLES), np.tile(shares, count)).reshape(count, _SAMPLES)
    padded = np.pad(seen, ((0, 0), (1, 1))).astype(np.int8)
    index, first = np.nonzero(np.diff(padded, axis=1) > 0)
    _, behind_last = np.nonzero(np.diff(padded, axis=1) < 0)
    last = behind_last - 1

    # sight ends between the outermost visible sample and its neighbour, or with the segment
    good = shares[np.concatenate([first, last])]
    bad = shares[np.concatenate([np.maximum(first - 1, 0), np.minimum(last + 1, _SAMPLES - 1)])]
    both = np.tile(index, 2)
    for _ in range(_HALVINGS):
        middle = 0.5 * (good + bad)
        inside = visible(both, middle)
        good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
    ends = good.reshape(2, -1, 1)
    return np.stack([start[index] + share * along[index] for share in ends], axis=1), index
