"""The pose from the bearings of three or more identified landmarks, without any range.

Sugihara 1988 treats this as the case of distinguished landmarks; Krotkov 1989 adds errors of the bearings and of the
surveyed positions. Three bearings give the pose in closed form, more are fitted, starting from the best three.
"""

from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from fieldloc.covariance import check_covariance, propagate
from fieldloc.fixes.inputs import exactly, posts_covariance_of
from fieldloc.fixes.landmarks import LandmarkFix
from fieldloc.pose import FloatArray, compose, inverse, wrap

_MAX_ITERATIONS = 20
_CONVERGED = 1e-12  # squared length of a step in its own sigmas
_MAX_TRIPLES = 60  # tried for a start: all of up to eight landmarks
_PROBE_SIGMAS = 2.0
_FIRST_ORDER = 0.05  # nonlinearity up to which the first-order covariance is within a few percent
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def resection_fix(
    positions: FloatArray,
    bearings_rad: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
) -> tuple[LandmarkFix, ...]:
    """The pose from which the landmarks appear at these bearings: one, or none where they do not determine it.

    positions: (n, 2) of the landmarks on the map, metres, field frame; positions_covariance: (n, 2, 2) of these.
    bearings_rad: (n,) counter-clockwise from the sensor's forward axis; covariance: (n, n) of these.
    robot_from_sensor: (3,) where the sensor sits; on the robot's origin when not given.
    None for fewer than three, on or near the danger circle (landmarks and robot on one circle), for landmarks all in
    line with the robot or coincident, for bearings no pose can have, and for values that are not finite.
    The covariance is first-order where the likelihood is near a Gaussian; elsewhere it covers how the solution moves
    along its weakest direction.
    Raises ValueError for shapes that do not fit and a covariance that is not positive definite.
    """
    n = len(positions)
    exactly(positions, (n, 2), "positions")
    exactly(bearings_rad, (n,), "bearings_rad")
    exactly(covariance, (n, n), "covariance")
    survey = posts_covariance_of(positions_covariance, n)
    mount = np.zeros(3) if robot_from_sensor is None else exactly(robot_from_sensor, (3,), "robot_from_sensor")
    if n < 3 or not (np.isfinite(positions).all() and np.isfinite(bearings_rad).all()):
        return ()
    noise = check_covariance(covariance, n)
    problem = _Problem(positions, noise, survey, mount)
    fitted = problem.fit(bearings_rad)
    if fitted is None:
        return ()
    pose, first_order = fitted
    error, jacobian, residual_covariance = problem.at(pose, bearings_rad)
    weakest = problem.weakest(pose, first_order)
    information = np.asarray(np.linalg.inv(residual_covariance), dtype=np.float64)
    chi2 = float(error @ information @ error)
    _, log_det = np.linalg.slogdet(2 * np.pi * residual_covariance)
    honest, nonlinearity = first_order, 0.0
    for k in (-_PROBE_SIGMAS, _PROBE_SIGMAS):
        aside, _, aside_covariance = problem.at(pose + k * weakest, bearings_rad)
        rise = float(aside @ np.linalg.solve(aside_covariance, aside)) - chi2
        nonlinearity = max(nonlinearity, abs(rise / k**2 - 1.0))
    if not nonlinearity < _FIRST_ORDER:
        spread = problem.spread(pose, bearings_rad, jacobian @ weakest)
        if spread is None:
            return ()
        honest = spread + first_order - np.outer(weakest, weakest)
    redundant = information - information @ jacobian @ first_order @ jacobian.T @ information
    return (
        LandmarkFix(
            pose=pose,
            covariance=honest,
            log_weight=-0.5 * (chi2 + float(log_det)),
            solver="resection_fix",
            chi2=chi2,
            chi2_each=_left_out(redundant, information, error, chi2),
            nonlinearity=nonlinearity,
        ),
    )


class _Problem:
    """The bearings of one map's landmarks as a function of the robot's pose."""

    def __init__(self, positions: FloatArray, noise: FloatArray, survey: FloatArray, mount: FloatArray) -> None:
        self._positions, self._noise, self._survey, self._mount = positions, noise, survey, mount
        self._triples = np.array(list(islice(combinations(range(len(positions)), 3), _MAX_TRIPLES)))

    def at(self, pose: FloatArray, bearings: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Error (n,) = seen - expected, its expected value's Jacobian (n, 3) by the pose in field axes, its covariance.

        bearing = direction to the landmark - heading of the sensor.
        """
        sensor = compose(pose, self._mount)
        to = self._positions - sensor[:2]
        d = np.maximum(np.hypot(to[:, 0], to[:, 1]), 1e-12)
        across = np.stack([-to[:, 1], to[:, 0]], axis=-1) / d[:, None] ** 2  # by the landmark's position
        arm = sensor[:2] - pose[:2]
        jacobian = np.column_stack([-across, -1.0 - across @ np.array([-arm[1], arm[0]])])
        by_map = np.zeros((len(d), 2 * len(d)))
        rows = np.arange(len(d))
        by_map[rows, 2 * rows], by_map[rows, 2 * rows + 1] = across[:, 0], across[:, 1]
        error = wrap(bearings - np.arctan2(to[:, 1], to[:, 0]) + sensor[2])
        return error, jacobian, self._noise + propagate(by_map, self._survey)

    def fit(self, bearings: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Pose (3,) and first-order covariance (3, 3); None without a start, convergence or a determined direction."""
        sensors, solved = three_point_resection(self._positions[self._triples], bearings[self._triples])
        if not solved.any():
            return None
        to = self._positions - sensors[solved, None, :2]
        errors = wrap(bearings - np.arctan2(to[..., 1], to[..., 0]) + sensors[solved, None, 2])
        best = np.argmin(np.sum(errors**2 / np.diagonal(self._noise), axis=-1))
        pose = compose(sensors[solved][best], inverse(self._mount))
        for _ in range(_MAX_ITERATIONS):
            error, jacobian, covariance = self.at(pose, bearings)
            weighted = np.linalg.solve(covariance, np.column_stack([jacobian, error]))
            scale = np.sqrt(np.diagonal(jacobian.T @ weighted[:, :3]))
            if scale.min() < 1e-12:
                return None  # so far away that the bearings do not tell where
            normal = jacobian.T @ weighted[:, :3] / np.outer(scale, scale)
            if np.linalg.eigvalsh(normal)[0] < 1e-12:
                return None
            p = np.linalg.inv(normal) / np.outer(scale, scale)
            step = p @ (jacobian.T @ weighted[:, 3])
            if step @ (jacobian.T @ weighted[:, 3]) < _CONVERGED:
                pose = pose + step
                pose[2] = wrap(pose[2])
                return pose, 0.5 * (p + p.T)
            chi2 = float(error @ weighted[:, 3])
            while self._chi2(pose + step, bearings) > chi2 * 1.01 + 1e-9:
                step = 0.5 * step
                if np.abs(step).max() < 1e-12:
                    return None
            pose = pose + step
        return None

    def weakest(self, pose: FloatArray, p: FloatArray) -> FloatArray:
        """(3,): one sigma along the least certain direction, a radian weighed as the landmarks' mean distance."""
        distance = np.linalg.norm(self._positions - pose[:2], axis=1).mean()
        scale = np.array([1.0, 1.0, distance])
        values, vectors = np.linalg.eigh(p * np.outer(scale, scale))
        return np.asarray(np.sqrt(values[2]) * vectors[:, 2] / scale)

    def spread(self, pose: FloatArray, bearings: FloatArray, weakest_seen: FloatArray) -> FloatArray | None:
        """Second moment (3, 3) about the pose of the solutions as the bearings vary along one sigma (n,) of theirs.

        None where the noise reaches bearings without a solution: no finite covariance would be honest.
        """
        total = np.zeros((3, 3))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            fitted = self.fit(bearings + node * weakest_seen)
            if fitted is None:
                return None
            off = fitted[0] - pose
            off[2] = wrap(off[2])
            total += weight * np.outer(off, off)
        return total

    def _chi2(self, pose: FloatArray, bearings: FloatArray) -> float:
        error, _, covariance = self.at(pose, bearings)
        return float(error @ np.linalg.solve(covariance, error))


def three_point_resection(positions: FloatArray, bearings_rad: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Poses (..., 3) that see three points (..., 3, 2) at bearings (..., 3), and (...) where there is one.

    Two points are seen under the angle a between them from a circle, sin(a) d1.d2 = cos(a) d1 x d2 with d the vectors
    to them. Pairs (1, 2) and (2, 3) give two circles that meet in the second point and in the observer, who is found on
    the line through both meets. No solution where the circles are one and the same, or one of the points would have to
    be behind the direction in which it is seen.
    """
    second = positions[..., 1, :]
    a, c = positions[..., 0, :] - second, positions[..., 2, :] - second
    angle_12, angle_23 = bearings_rad[..., 1] - bearings_rad[..., 0], bearings_rad[..., 2] - bearings_rad[..., 1]
    s12, c12, s23, c23 = np.sin(angle_12), np.cos(angle_12), np.sin(angle_23), np.cos(angle_23)
    # circles through the second point as origin: s12 |q|^2 = u.q and s23 |q|^2 = v.q
    u = s12[..., None] * a - c12[..., None] * _left(a)
    v = s23[..., None] * c + c23[..., None] * _left(c)
    axis = s23[..., None] * u - s12[..., None] * v
    along = _left(axis)
    length = np.linalg.norm(along, axis=-1)
    size = np.linalg.norm(u, axis=-1) * np.abs(s23) + np.linalg.norm(v, axis=-1) * np.abs(s12)
    solved = length > 1e-9 * size
    share = s12 * np.sum(u * along, axis=-1) + s23 * np.sum(v * along, axis=-1)
    denominator = (s12**2 + s23**2) * length**2
    solved &= denominator > 1e-30 * np.maximum(size, 1.0) ** 2
    denominator = np.where(solved, denominator, 1.0)
    at = second + (share / denominator)[..., None] * along
    to = positions - at[..., None, :]
    headings = np.arctan2(to[..., 1], to[..., 0]) - bearings_rad
    east, north = np.cos(headings).sum(axis=-1), np.sin(headings).sum(axis=-1)
    # each heading is right or turned by half a turn: three that agree add up to 3, two against one to 1
    solved &= (np.hypot(east, north) > 2.0) & (np.linalg.norm(to, axis=-1) > 0.0).all(axis=-1)
    return np.concatenate([at, np.arctan2(north, east)[..., None]], axis=-1), solved


def _left(vectors: FloatArray) -> FloatArray:
    """(..., 2) turned by a quarter counter-clockwise."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _left_out(redundant: FloatArray, information: FloatArray, error: FloatArray, chi2: float) -> FloatArray:
    """(n,) what chi2 loses without each bearing; all of it where the others do not determine the pose."""
    own = np.diagonal(redundant)
    enough = own > 1e-9 * np.diagonal(information)
    return np.where(enough, (information @ error) ** 2 / np.where(enough, own, 1.0), chi2)
