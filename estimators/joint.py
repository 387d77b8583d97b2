"""All poses of a log together with the choice for each mixture: solved and chosen in turns until neither changes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators import chain_engine
from estimators.chain import Chain, Recorded
from estimators.compass_knots import at_nodes, knot_s
from estimators.config import Config
from estimators.engines import solver
from estimators.solution import MOTION_FLOOR, Solution, global_means, global_sigmas
from estimators.stretches import Story
from fieldloc import pose as se2
from fieldloc.covariance import log_peaks
from fieldloc.factors import Factor, is_by_sight
from fieldloc.mixture import IntArray, MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.solution_mixture import GATES

_ROUNDS = 4
_SURE = 12.0  # a choice that is so much (log) better than the next is not looked at again while its pose stays
_MOVED = 0.25  # squared Mahalanobis distance of a pose that has moved
_POINT = 1e-9 * np.eye(3)
_ROUGHLY = np.diag([0.1, 0.1, 0.05]) ** 2
_BELIEVED = 0.3  # share of a compass reading's information below which it is taken for disturbed
_TIE = 1e-6
NO_KERNEL = 1e6  # scale, in sigmas, of a robust kernel that does nothing


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """choices: (t,) solutions, -1 for none, each the best in the light of all others; breaks: as in Story.

    margins: (t,) by how much (log) each choice is better than the next best."""

    choices: IntArray
    breaks: tuple[int, ...]
    chain: Chain
    solution: Solution
    margins: FloatArray


def settle(recorded: Recorded, story: Story, config: Config, near: Solution | None = None) -> Settled:
    """near: a solution whose poses are the story's. By the chain engine, as this is done for many stories and often."""
    return _Settling(recorded, story, config).settled(story, near)


def without_kernel(config: Config) -> Config:
    return replace(config, graph=replace(config.graph, cauchy=NO_KERNEL))


def finished(settled: Settled, config: Config) -> Settled:
    """Solved by the engine that the settings name."""
    if config.graph.engine == "chain":
        return settled
    chain = replace(settled.chain, guess=settled.solution.poses)
    return replace(settled, chain=chain, solution=solver(config)(chain, config, settled.solution))


class _Settling:
    def __init__(self, recorded: Recorded, story: Story, config: Config) -> None:
        self._recorded, self._config = recorded, config
        self._choices, self._margins = story.choices.copy(), story.margins.copy()
        self._factors: dict[tuple[int, int], tuple[Factor, ...]] = {}
        # of the compass, the tracks say nothing but how much to believe of it
        self._compass = [i for i, (_, mixture) in enumerate(recorded.mixtures) if mixture.by_compass]
        self._looked_at = story.poses.copy()

    def settled(self, story: Story, near: Solution | None) -> Settled:
        poses, compass = story.poses, self._compass if near is None else []
        self._choose(compass, poses, poses, np.broadcast_to(_ROUGHLY, (len(poses), 3, 3)), *self._offsets(None))
        for first in (True, *(_ROUNDS - 1) * (False,)):
            chain = self._recorded.chain(self._choices, story.breaks, poses, self.chosen)
            if near is None and self._config.graph.cauchy < NO_KERNEL:
                # while eyes and odometry are taken to be perfect, what fits badly may be right
                near = chain_engine.solve(chain, without_kernel(self._config))
                chain = replace(chain, guess=near.poses)
            near = chain_engine.solve(chain, self._config, near)
            poses = near.poses
            out = Settled(self._choices.copy(), story.breaks, chain, near, self._margins.copy())
            seen_from = chain.seen_from(near.poses, near.calibration, near.sensor)
            doubtful = self._doubtful(near, seen_from, first)
            changed = self._choose(doubtful, poses, seen_from, near.covariances, *self._offsets(near))
            if not changed or not self._recorded.anchored(self._choices, story.breaks):
                break
        return out

    def chosen(self, index: int, choice: int) -> tuple[Factor, ...]:
        """The factors of a mixture's solution."""
        if (index, choice) not in self._factors:
            self._factors[index, choice] = self._recorded.mixtures[index][1].chosen(choice)
        return self._factors[index, choice]

    def _offsets(self, solution: Solution | None) -> tuple[FloatArray, FloatArray]:
        known = (np.zeros(0),) * 2 if solution is None else (solution.compass_rad, solution.compass_variance_rad2)
        return at_nodes(self._recorded.stamps_ns, *known, self._config.compass)

    def _doubtful(self, solution: Solution, seen_from: FloatArray, first: bool) -> list[int]:
        """Mixtures to look at again: unsure ones if their poses have moved since, those that fit badly."""
        out = []
        moved = se2.local(self._looked_at, solution.poses)
        distance = np.sum(moved * np.linalg.solve(solution.covariances, moved[..., None])[..., 0], axis=-1)
        for index, (node, mixture) in enumerate(self._recorded.mixtures):
            choice = int(self._choices[index])
            unsure = self._margins[index] < _SURE or choice < 0 or mixture.by_compass
            if (unsure and (first or distance[node] > _MOVED)) or (
                choice >= 0 and self._misfit(index, choice, (seen_from if mixture.by_sight else solution.poses)[node])
            ):
                out.append(index)
        return out

    def _misfit(self, index: int, choice: int, pose: FloatArray) -> bool:
        for factor in self.chosen(index, choice):
            error = factor.error(pose)
            if error @ np.linalg.solve(factor.covariance, error) > GATES[len(error)]:
                return True
        return False

    def _choose(
        self,
        which: list[int],
        poses: FloatArray,
        seen_from: FloatArray,
        covariances: FloatArray,
        offsets: FloatArray,
        variances: FloatArray,
    ) -> bool:
        """The best solution of each of these mixtures, in the light of all others; whether one changed.

        Where the eyes were is taken to be known as well as where the robot is: their calibration is a whole log's.
        """
        changed = False
        for index in which:
            node, mixture = self._recorded.mixtures[index]
            before = int(self._choices[index])
            self._looked_at[node] = poses[node]
            pose, covariance = (seen_from if mixture.by_sight else poses)[node], covariances[node]
            if mixture.by_compass:
                pose = pose + [0.0, 0.0, offsets[node]]
                covariance = covariance + np.diag([0.0, 0.0, variances[node]])
            elif before >= 0:
                pose, covariance = cavity(self.chosen(index, before), pose, covariance, self._config.graph.cauchy)
            after, self._margins[index] = self._best(index, pose, covariance, before)
            self._choices[index] = after
            changed |= after != before
        return changed

    def _best(self, index: int, pose: FloatArray, covariance: FloatArray, before: int) -> tuple[int, float]:
        """The likeliest solution for a robot at a Gaussian, -1 for none; by how much (log) it beats the next."""
        mixture = self._recorded.mixtures[index][1]
        near = mixture.expand(pose[None], covariance[None])
        ids = np.concatenate([[-1], near.ids])
        worth = np.concatenate([[mixture.log_outlier], near.evidence])
        best = int(np.argmax(worth + _TIE * (ids == before)))
        choice = int(ids[best])
        if mixture.by_compass and choice >= 0:
            # it may say by how little it is to be believed, rather than that it is to be left out
            whole = sum(float(f.jacobian(pose)[0, 2] ** 2 / f.covariance[0, 0]) for f in self.chosen(index, choice))
            if near.information[best - 1, 2, 2] < _BELIEVED * whole:
                choice = -1
        rest = np.delete(worth, best)
        return choice, float(worth[best] - rest.max()) if len(rest) else np.inf


def cavity(
    factors: Sequence[Factor], pose: FloatArray, covariance: FloatArray, cauchy: float
) -> tuple[FloatArray, FloatArray]:
    """The pose (3,) and covariance (3, 3), robot frame, without what the factors have said to them under a kernel."""
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    for factor in factors:
        jacobian, error = factor.jacobian(pose), factor.error(pose)
        weighted = np.linalg.solve(factor.covariance, np.column_stack([jacobian, error]))
        weight = 1.0 / (1.0 + float(error @ weighted[:, 3]) / cauchy**2)
        information += weight * (jacobian.T @ weighted[:, :3])
        gradient -= weight * (jacobian.T @ weighted[:, 3])
    # of each direction at least a hundredth is left, as nothing is linear
    root = np.linalg.cholesky(covariance)
    share, axes = np.linalg.eigh(root.T @ information @ root)
    without = root @ axes
    wider = (without / np.maximum(1.0 - share, 0.01)) @ without.T
    return se2.retract(pose, -wider @ gradient), wider


def log_evidence(recorded: Recorded, settled: Settled, config: Config, log_kidnap: float) -> float:
    """Logarithm of p(all observations, choices, breaks), up to what all ways to read the log have in common.

    Laplace's approximation about the solution, which must be without a robust kernel: joint density at the peak, times
    the volume under it. log_kidnap: log of the rate (1/s) of being carried times the density of places (1/(m^2 rad)) to
    be carried to. The density of the first pose is left to the caller.
    """
    solution, poses = settled.solution, settled.solution.poses
    offsets, _ = at_nodes(recorded.stamps_ns, solution.compass_rad, solution.compass_variance_rad2, config.compass)
    offset = offsets[:, None] * [0.0, 0.0, 1.0]
    seen_from = settled.chain.seen_from(poses, solution.calibration, solution.sensor)
    total = sum(
        _log_term(
            mixture, int(choice), (seen_from if mixture.by_sight else poses)[node] + offset[node] * mixture.by_compass
        )
        for (node, mixture), choice in zip(recorded.mixtures, settled.choices, strict=True)
    )
    for node, factor in recorded.factors:
        error = factor.error((seen_from if is_by_sight(factor) else poses)[node])
        total -= 0.5 * float(error @ np.linalg.solve(factor.covariance, error))
    motions = settled.chain.motions
    if motions:
        kept = np.ones(len(motions), dtype=bool)
        for node in settled.breaks:
            kept[node - 1] = False
            before, after = recorded.between(settled.choices, node)
            total += log_kidnap + float(np.log((recorded.stamps_ns[after] - recorded.stamps_ns[before]) * 1e-9))
        moved = np.array([m.before_from_after for m in motions])
        by_calibration = np.array([m.by_calibration for m in motions]) @ np.array(solution.calibration)
        covariances = (np.array([m.covariance for m in motions]) + MOTION_FLOOR)[kept]
        error = se2.local(se2.retract(moved, by_calibration), se2.between(poses[:-1], poses[1:]))[kept]
        total -= 0.5 * float(np.sum(error * np.linalg.solve(covariances, error[..., None])[..., 0]))
        total += float(np.sum(log_peaks(covariances)))
    sigmas = global_sigmas(config)
    free = sigmas > 0.0
    common = np.array([*solution.calibration, *solution.sensor]) - global_means(config)
    total += _log_normal(common[free], sigmas[free])
    knots = solution.compass_rad
    if len(knots):
        keep, variance = config.compass.wander(knot_s(config.compass))
        total += _log_normal(knots[:1], np.array([config.compass.offset_sigma_rad]))
        total += _log_normal(knots[1:] - keep * knots[:-1], np.full(len(knots) - 1, variance**0.5))
    dimensions = 3 * len(poses) + int(free.sum()) + len(knots)
    return total + 0.5 * dimensions * float(np.log(2 * np.pi)) - 0.5 * solution.log_determinant


def _log_term(mixture: MixtureFactor, choice: int, pose: FloatArray) -> float:
    """log p(observation, choice | pose)."""
    if mixture.by_compass:  # disturbances are in the middle of it
        return float(mixture.log_likelihood(pose[None])[0])
    if choice >= 0:
        near = mixture.expand(pose[None], _POINT[None])
        row = np.flatnonzero(near.ids == choice)
        if len(row):
            return float(near.constant[row[0]])
    return mixture.log_outlier


def _log_normal(values: FloatArray, sigmas: FloatArray) -> float:
    return float(-0.5 * np.sum((values / sigmas) ** 2 + np.log(2 * np.pi * sigmas**2)))
