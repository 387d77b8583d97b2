"""One image of a sensor that a log holds in parts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fieldloc.measurements import LandmarkScan, Measurement

_ONE_IMAGE_NS = 2_000_000  # two stamps rounded to a millisecond; no sensor is that fast


def whole_scans(measurements: Sequence[Measurement]) -> list[Measurement]:
    """In order of stamps, with scans of one sensor that are stamped nearly alike as one, at the first one's stamp.

    Those that name the same landmark stay apart: they are not of one image.
    """
    out: list[Measurement] = []
    last: dict[bytes, int] = {}  # where in the list, by where the sensor is mounted
    for one in measurements:
        if isinstance(one, LandmarkScan):
            mount = one.robot_from_sensor.tobytes()
            before = out[last[mount]] if mount in last else None
            if isinstance(before, LandmarkScan) and _one_image(before, one):
                out[last[mount]] = replace(
                    before,
                    labels=before.labels + one.labels,
                    range_bearing=np.concatenate([before.range_bearing, one.range_bearing]),
                    covariance=np.concatenate([before.covariance, one.covariance]),
                )
                continue
            last[mount] = len(out)
        out.append(one)
    return out


def _one_image(one: LandmarkScan, other: LandmarkScan) -> bool:
    twice = {label for label in one.labels if label is not None} & set(other.labels)
    return other.stamp_ns - one.stamp_ns <= _ONE_IMAGE_NS and not twice
