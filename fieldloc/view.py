"""What of a line on the ground is in the image: the paper's cut of a line at the image's border (sec. 3.2, Table 1)."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

_SAMPLES = 257  # per line: a visible part shorter than 1/256 of its line may be missed
_HALVINGS = 50  # 1/256 halved fifty times is below the rounding of the end points


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

    def border(inside: NDArray[np.intp], outside: NDArray[np.intp]) -> FloatArray:
        """The share at which sight ends between two neighbouring samples; the sample itself at the segment's end."""
        beyond = (outside < 0) | (outside >= _SAMPLES)
        good, bad = shares[inside], shares[np.clip(outside, 0, _SAMPLES - 1)]
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            is_good = visible(index, middle)
            good, bad = np.where(is_good, middle, good), np.where(is_good, bad, middle)
        return np.where(beyond, shares[inside], good)

    ends = np.stack([border(first, first - 1), border(last, last + 1)], axis=-1)
    return start[index][:, None] + ends[..., None] * along[index][:, None], index
