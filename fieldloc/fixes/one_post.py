"""One post at a known distance: a circle of places around it, the heading tied to each (sec. 2.1 with the scale known).

Range and bearing of one landmark leave one unknown, the direction in which the robot stands as seen from the post. The
arc is what a filter's correction or another image must cut; by itself it is no pose.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.covariance import propagate
from fieldloc.fixes.inputs import exactly, semidefinite
from fieldloc.fixes.sizes import SizeModel
from fieldloc.pose import FloatArray, wrap

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)  # out to 2.86 standard deviations
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@dataclass(frozen=True, slots=True)
class RangeBearingArc:
    """All poses from which a post at `centre` is seen at one range and bearing.

    centre: (2,) metres, field frame; centre_covariance: (2, 2) of it.
    covariance: (2, 2) of (range_m, bearing_rad), the range's honest also for a post of few pixels.
    """

    centre: FloatArray
    range_m: float
    bearing_rad: float
    covariance: FloatArray
    centre_covariance: FloatArray

    @property
    def sigma_range_m(self) -> float:
        """Standard deviation of the circle's radius."""
        return float(np.sqrt(self.covariance[0, 0]))

    def pose(self, direction_rad: FloatArray) -> FloatArray:
        """field_from_robot (..., 3) for the directions (...) from the post to the robot, field axes."""
        direction = np.asarray(direction_rad, dtype=np.float64)
        place = self.centre + self.range_m * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        heading = wrap(direction + np.pi - self.bearing_rad)
        return np.concatenate([place, heading[..., None]], axis=-1)

    def covariance_at(self, direction_rad: FloatArray, sigma_direction_rad: float = 0.0) -> FloatArray:
        """(..., 3, 3) of (x_m, y_m, heading_rad) in field axes at each direction.

        With the direction held fixed it is singular along the arc unless the post's position is uncertain; with a
        standard deviation of the direction, say the spacing of poses that cover the arc, it is one piece of a mixture
        along it.
        """
        direction = np.asarray(direction_rad, dtype=np.float64)
        c, s = np.cos(direction), np.sin(direction)
        zero, one = np.zeros_like(c), np.ones_like(c)
        by_range = np.stack([c, s, zero], axis=-1)
        by_bearing = np.stack([zero, zero, -one], axis=-1)
        by_direction = np.stack([-self.range_m * s, self.range_m * c, one], axis=-1)
        noise = np.zeros((5, 5))
        noise[:2, :2] = self.covariance
        noise[2, 2] = sigma_direction_rad**2
        noise[3:, 3:] = self.centre_covariance
        by_centre = np.broadcast_to(np.eye(3, 2), (*c.shape, 3, 2))
        return propagate(np.concatenate([np.stack([by_range, by_bearing, by_direction], -1), by_centre], -1), noise)


def arc_of_one_post(
    bearing_rad: float,
    size: float,
    covariance: FloatArray,
    post: FloatArray,
    size_model: SizeModel,
    post_covariance: FloatArray | None = None,
) -> tuple[RangeBearingArc, ...]:
    """The arc of one post (2,) from its bearing and size, covariance (2, 2) of these; post_covariance (2, 2).

    The range's variance is the second moment over the size's noise, which is first order's while the size is many
    standard deviations; empty where the size has no distance, within about three standard deviations of zero, or for
    NaN.
    """
    centre, noise = exactly(post, (2,), "post"), exactly(semidefinite(covariance, 2), (2, 2), "covariance")
    survey = np.zeros((2, 2)) if post_covariance is None else post_covariance
    survey = exactly(semidefinite(survey, 2, "post_covariance"), (2, 2), "post_covariance")
    sigma_size = np.sqrt(noise[1, 1])
    if not np.all(np.isfinite([bearing_rad, size, *centre])):
        return ()
    at, around = size_model.range_of(np.array(size)), size_model.range_of(size + sigma_size * _NODES)
    if not (np.all(np.isfinite(around)) and np.isfinite(at)):
        return ()
    slope = 1 / size_model.of_range(at)[1]
    variance = float(_WEIGHTS @ (around - at) ** 2)
    first_order = float(slope**2 * noise[1, 1])
    stretch = np.sqrt(variance / first_order) if first_order > 0 else 1.0
    cross = stretch * slope * noise[0, 1]
    spread = np.array([[variance, cross], [cross, noise[0, 0]]])
    return (RangeBearingArc(centre, float(at), float(bearing_rad), spread, survey),)
