"""The likelihood of two posts' bearings and sizes when the scale is known, over theta = (bearing 1, bearing 2, rho).

rho = log(C / B), and the closed form of `two_posts` makes the pose of theta. The bearings are linear in theta; only the
sizes' two residuals bend, and they bend in rho alone, along the circle of eq. 1: |w| = C / A, |1 + w| = B / A. So
everything that is not Gaussian about this problem is in the profile over rho.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fieldloc.fixes.sizes import SizeModel
from fieldloc.fixes.two_posts import poses_from_two_posts
from fieldloc.pose import FloatArray, wrap

_MAX_STEPS = 50  # ten do, but for sizes and angle that contradict each other by many standard deviations
_CONVERGED = 1e-6  # the last step in units of the solution's own standard deviations; what it leaves is far smaller
_BEARING_STEPS = 4
_LARGEST_LOG_RATIO = 25.0


class Profile(NamedTuple):
    """Per rho (k,) the best theta (k, 3) and its chi2 (k,), infinite where nothing is seen."""

    theta: FloatArray
    chi2: FloatArray
    bearing_covariance: FloatArray
    """(k, 2, 2), given rho."""


@dataclass(frozen=True, slots=True)
class RangedLikelihood:
    """observed: (4,) bearing 1, bearing 2, size 1, size 2; noise: (4, 4) their covariance; posts (2, 2)."""

    posts: FloatArray
    size_model: SizeModel
    observed: FloatArray
    noise: FloatArray
    weight: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", np.linalg.inv(self.noise))

    def poses(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses (..., 3) of theta (..., 3) and their Jacobian (..., 3, 3)."""
        size2 = np.exp(np.clip(theta[..., 2], -_LARGEST_LOG_RATIO, _LARGEST_LOG_RATIO))
        found = poses_from_two_posts(theta[..., :2], np.stack([np.ones_like(size2), size2], axis=-1), self.posts)
        by_rho = found.jacobian[..., 3:] * size2[..., None, None]
        return found.pose, np.concatenate([found.jacobian[..., :2], by_rho], axis=-1)

    def residual(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Observed minus predicted (..., 4), its Jacobian by theta (..., 4, 3); NaN for a robot infinitely far."""
        rho = theta[..., 2]
        omega = 1j * wrap(theta[..., 1] - theta[..., 0]) - rho
        seen = (omega != 0) & (np.abs(rho) < _LARGEST_LOG_RATIO)
        omega = np.where(seen, omega, 1.0)
        w, w_plus_1 = 1 / np.expm1(omega), -1 / np.expm1(-omega)
        separation = np.hypot(*(self.posts[1] - self.posts[0]))
        ranges = separation * np.abs(np.stack([w, w_plus_1], axis=-1))
        size, slope = self.size_model.of_range(ranges)
        # dlog C = -Re((1 + w) domega), dlog B = -Re(w domega)
        by_alpha, by_rho = np.stack([w.imag, w.imag], axis=-1), np.stack([w_plus_1.real, w.real], axis=-1)
        sizes_by_theta = (slope * ranges)[..., None] * np.stack([-by_alpha, by_alpha, by_rho], axis=-1)
        jacobian = np.concatenate([np.broadcast_to(np.eye(2, 3), sizes_by_theta.shape), sizes_by_theta], axis=-2)
        bearings = wrap(self.observed[:2] - theta[..., :2])
        residual = np.concatenate([bearings, self.observed[2:] - size], axis=-1)
        return np.where(seen[..., None], residual, np.nan), np.where(seen[..., None, None], jacobian, np.nan)

    def chi2(self, residual: FloatArray) -> FloatArray:
        """(...), infinite instead of NaN."""
        value = np.einsum("...i,ij,...j->...", residual, self.weight, residual)
        return np.where(np.isfinite(value), value, np.inf)

    def profile(self, rho: FloatArray) -> Profile:
        """The most likely bearings for each rho (k,), by Gauss-Newton: linear but for what sizes say."""
        theta = np.empty((len(rho), 3))
        theta[:, :2], theta[:, 2] = self.observed[:2], rho
        for step in range(_BEARING_STEPS + 1):
            residual, jacobian = self.residual(theta)
            seen = np.asarray(np.isfinite(residual).all(-1) & np.isfinite(jacobian).all((-1, -2)))
            by_bearings = np.where(seen[:, None, None], jacobian, np.eye(4, 3))[..., :2]
            weighted = np.swapaxes(by_bearings, -1, -2) @ self.weight
            information = weighted @ by_bearings
            # near omega = 0 ranges say infinitely much about the angle: keep the rest from drowning in rounding
            ridge = 1e-15 * np.trace(information, axis1=-2, axis2=-1)
            covariance = np.asarray(np.linalg.inv(information + ridge[:, None, None] * np.eye(2)))
            if step < _BEARING_STEPS:
                gradient = weighted @ np.where(seen[:, None], residual, 0.0)[..., None]
                theta[:, :2] += (covariance @ gradient)[..., 0]
        return Profile(theta, np.where(seen, self.chi2(residual), np.inf), covariance)

    def polish(self, theta: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """The minimum next to theta (3,), its chi2 and information (3, 3), by Levenberg-Marquardt: never uphill."""
        damping = 1e-6
        residual, jacobian = self.residual(theta)
        chi2 = float(self.chi2(residual))
        information = jacobian.T @ self.weight @ jacobian
        for _ in range(_MAX_STEPS):
            gradient = jacobian.T @ self.weight @ residual
            scale = np.maximum(np.diagonal(information), 1e-12 * np.trace(information))
            step = np.linalg.solve(information + damping * np.diag(scale), gradient)
            last = bool(np.sum(gradient**2 / scale) < _CONVERGED**2)
            trial = theta + step
            trial_residual, trial_jacobian = self.residual(trial)
            trial_chi2 = float(self.chi2(trial_residual))
            # the last step is too short for rounding to tell whether chi2 falls
            if np.all(np.isfinite(trial_jacobian)) and (trial_chi2 <= chi2 or (last and np.isfinite(trial_chi2))):
                theta, residual, jacobian, chi2 = trial, trial_residual, trial_jacobian, trial_chi2
                information = jacobian.T @ self.weight @ jacobian
                damping = max(damping / 10, 1e-12)
            else:
                damping *= 10
            if last or damping > 1e10:
                break
        return theta, chi2, np.asarray(information)


def survey_noise(posts: FloatArray, survey: FloatArray, size_model: SizeModel, position: FloatArray) -> FloatArray:
    """(4, 4): what errors of the posts' positions, covariance (4, 4), do to the view from a position (2,)."""
    jacobian = np.zeros((4, 4))
    to_posts = posts - position
    distance = np.hypot(to_posts[:, 0], to_posts[:, 1])
    _, slope = size_model.of_range(distance)
    for post in (0, 1):
        along = to_posts[post] / distance[post]
        jacobian[post, 2 * post : 2 * post + 2] = np.array([-along[1], along[0]]) / distance[post]
        jacobian[2 + post, 2 * post : 2 * post + 2] = slope[post] * along
    return np.asarray(jacobian @ survey @ jacobian.T)
