"""The compass' offset in the graph: a value each second or so, alike from one to the next, in all of its readings."""

import gtsam
import numpy as np

from estimators.chain import Chain
from estimators.compass_knots import knot_s
from estimators.config import Compass
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


class CompassOffsets:
    """Variables of a linear graph by hand, keys from `first_key` on, for the chain's compass readings.

    A reading is heading + offset. The offset is an Ornstein-Uhlenbeck process (estimators.config.Compass).
    """

    def __init__(self, chain: Chain, config: Compass, first_key: int) -> None:
        readings = [(k, f) for k, f in chain.factors if isinstance(f, HeadingFactor) and f.by_compass]
        every_s = knot_s(config)
        self._nodes = [k for k, _ in readings]
        self._heading_rad = np.array([f.heading_rad for _, f in readings])
        self._sigma_rad = np.sqrt([f.covariance[0, 0] for _, f in readings])
        self._prior_sigma_rad = config.offset_sigma_rad
        elapsed_s = (np.array(chain.stamps_ns) - chain.stamps_ns[0]) * 1e-9
        self.knots_of_nodes: IntArray = np.round(elapsed_s / every_s).astype(np.intp)
        self._knots = self.knots_of_nodes[self._nodes].tolist()
        self.count = 0
        if readings and config.offset_sigma_rad > 0.0:
            self.count = int(self.knots_of_nodes[-1]) + 1
        self._keep, variance = config.wander(every_s)
        self._step_weight = 1.0 / np.sqrt(variance) if variance > 0.0 else 0.0
        self._first_key = first_key

    def step(self, solved: gtsam.VectorValues) -> FloatArray:
        """(count,) of a linear solution."""
        return np.array([solved.at(self._first_key + j)[0] for j in range(self.count)])

    def variances(self, tree: gtsam.GaussianBayesTree) -> FloatArray:
        """(count,) marginal."""
        return np.array([tree.marginalCovariance(self._first_key + j)[0, 0] for j in range(self.count)])

    def stand_in(self, graph: gtsam.NonlinearFactorGraph, cauchy: float) -> None:
        """The readings as native factors that leave room for an offset."""
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy)
        for node, heading_rad, sigma_rad in zip(self._nodes, self._heading_rad, self._sigma_rad, strict=True):
            base = gtsam.noiseModel.Isotropic.Sigma(1, float(np.hypot(sigma_rad, self._prior_sigma_rad)))
            noise = gtsam.noiseModel.Robust.Create(kernel, base)
            graph.add(gtsam.PoseRotationPrior2D(node, gtsam.Rot2(float(heading_rad)), noise))

    def error(self, poses: FloatArray, offsets: FloatArray, cauchy: float) -> float:
        if not self._nodes:
            return 0.0
        squares = self._residuals(poses, offsets) ** 2
        out = 0.5 * cauchy**2 * float(np.sum(np.log1p(squares / cauchy**2)))
        if self.count:
            out += 0.5 * float(offsets[0] / self._prior_sigma_rad) ** 2
            out += 0.5 * float(np.sum(((offsets[1:] - self._keep * offsets[:-1]) * self._step_weight) ** 2))
        return out

    def add_to(self, linear: gtsam.GaussianFactorGraph, poses: FloatArray, offsets: FloatArray, cauchy: float) -> None:
        """Readings, first offset and steps between offsets, linearised at the values."""
        if not self._nodes:
            return
        unit = gtsam.noiseModel.Unit.Create(1)
        misfit = self._residuals(poses, offsets)
        robust = 1.0 / np.sqrt(1.0 + misfit**2 / cauchy**2)
        slope, towards = robust / self._sigma_rad, -robust * misfit
        for node, knot, row, value in zip(self._nodes, self._knots, slope, towards, strict=True):
            by_pose, by_offset, rhs = np.array([[0.0, 0.0, row]]), np.array([[row]]), np.array([value])
            if self.count:
                linear.add(gtsam.JacobianFactor(node, by_pose, self._first_key + knot, by_offset, rhs, unit))
            else:
                linear.add(gtsam.JacobianFactor(node, by_pose, rhs, unit))
        if not self.count:
            return
        first, each = np.array([[1.0 / self._prior_sigma_rad]]), np.array([[self._step_weight]])
        linear.add(gtsam.JacobianFactor(self._first_key, first, -offsets[:1] * first[0], unit))
        misfit = (offsets[1:] - self._keep * offsets[:-1]) * self._step_weight
        for key, value in enumerate(misfit, start=self._first_key):
            linear.add(gtsam.JacobianFactor(key, -self._keep * each, key + 1, each, np.array([-value]), unit))

    def _residuals(self, poses: FloatArray, offsets: FloatArray) -> FloatArray:
        """In the readings' sigmas."""
        heading_rad = poses[self._nodes, 2]
        offset = offsets[self._knots] if self.count else 0.0
        return np.asarray(se2.wrap(heading_rad + offset - self._heading_rad) / self._sigma_rad)
