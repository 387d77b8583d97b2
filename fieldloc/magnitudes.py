"""Numbers so large that nothing was measured: they would only overflow further on, far from where they came from."""

from collections.abc import Iterator

import numpy as np

from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Measurement, Odometry
from fieldloc.pose import FloatArray

_MOST = 1e6  # metres, pixels, radians: farther than any robot goes, wider than any image
_Numbers = tuple[str, FloatArray | float]


def check_magnitudes(measurement: Measurement) -> None:
    """ValueError naming the first number beyond a million metres, pixels or radians, or a covariance beyond its square.

    Numbers that are not finite pass in scans and images, where they stand for what was not seen; else they are refused.
    """
    missing = isinstance(measurement, LandmarkScan | ImageFeatures)
    for name, numbers in _numbers(measurement):
        limit = _MOST**2 if name.startswith("covariance") else _MOST
        size = np.abs(np.asarray(numbers)).ravel()
        if size.max(initial=0.0) <= limit:
            continue  # all of them are, and none is not finite
        wrong = (size > limit) & np.isfinite(size) if missing else ~(size <= limit)
        if wrong.any():
            raise ValueError(f"{name} of {size[np.argmax(wrong)]:.3g} is no measurement: it is beyond {limit:.0e}")


def _numbers(measurement: Measurement) -> Iterator[_Numbers]:
    match measurement:
        case LandmarkScan():
            yield "range", measurement.range_bearing[:, 0]
            yield "bearing", measurement.range_bearing[:, 1]
            yield "covariance", measurement.covariance
            yield "place of the sensor", measurement.robot_from_sensor
        case ImageFeatures():
            yield from _of_image(measurement)
        case Odometry():
            yield "velocity", measurement.velocity
            if measurement.covariance is not None:
                yield "covariance", measurement.covariance
        case Compass():
            yield "heading", measurement.heading_rad
            yield "standard deviation", measurement.sigma_rad
        case InitialPose():
            yield "pose", measurement.pose
            yield "covariance", measurement.covariance


def _of_image(features: ImageFeatures) -> Iterator[_Numbers]:
    mount = features.mount
    yield "place of the camera", np.array([mount.x_m, mount.y_m, mount.height_m])
    yield "attitude of the camera", np.array([mount.pan_rad, mount.tilt_rad, mount.roll_rad])
    yield "covariance of the camera's place", mount.covariance
    for post in features.posts:
        yield "pixel", post.edges_px
        yield "covariance of a pixel", post.covariance_px2
        if post.foot_px is not None:
            yield "pixel", post.foot_px
        if post.foot_covariance_px2 is not None:
            yield "covariance of a pixel", post.foot_covariance_px2
    for line in features.lines:
        yield "pixel", line.ends_px
        yield "covariance of a pixel", line.covariance_px2
