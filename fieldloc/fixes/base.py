"""The record every analytic solver returns."""

from dataclasses import dataclass

from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True)
class Fix:
    """One pose of the robot that explains what was seen.

    pose: (3,) field_from_robot.
    covariance: (3, 3) of (x_m, y_m, heading_rad) in field axes, propagated from the observation; to first order where
    that is honest, and beyond it wide enough to cover how the solution really moves.
    log_weight: log-likelihood of the observation, up to a constant common to all solutions of one image.
    solver: the function that found it.
    """

    pose: FloatArray
    covariance: FloatArray
    log_weight: float = 0.0
    solver: str = ""
