"""All poses of a log together with the choice for each mixture: solved and chosen in turns until neither changes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators import chain_engine
from estimators.chain import Chain, Recorded
from estimators.chosen import Chosen
from estimators.compass_knots import at_nodes, knot_s
from estimators.config import Config
from estimators.copies import Moved
from estimators.engines import solver
from estimators.linearised import squared_errors
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
_SAME = 1e-4  # m, rad: poses that an observation is as likely from, up to some thousandth
NO_KERNEL = 1e6  # scale, in sigmas, of a robust kernel that does nothing


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """choices: (t,) solutions, -1 for none, each the best in the light of all others; breaks: as in Story.

    margins: (t,) by how much (log) each choice is better than the next best; looked_at: (t, 3) the poses that this was
    found at, as the mixtures are about them."""

    choices: IntArray
    breaks: tuple[int, ...]
    chain: Chain
    solution: Solution
    margins: FloatArray
    looked_at: FloatArray


def settle(
    recorded: Recorded, story: Story, config: Config, near: Settled | None = None, chosen: Chosen | None = None
) -> Settled:
    """near: settled before in much the same way, so that the poses are the story's. By the chain engine, as this is
    done for many stories and often."""
    return _Settling(recorded, story, config, near, Chosen() if chosen is None else chosen).settled()


def without_kernel(config: Config) -> Config:
    return replace(config, graph=replace(config.graph, cauchy=NO_KERNEL))


def finished(settled: Settled, config: Config) -> Settled:
    """Solved by the engine that the settings name."""
    if config.graph.engine == "chain":
        return settled
    chain = replace(settled.chain, guess=settled.solution.poses)
    return replace(settled, chain=chain, solution=solver(config)(chain, config, settled.solution))


class _Settling:
    def __init__(self, recorded: Recorded, story: Story, config: Config, near: Settled | None, chosen: Chosen) -> None:
        self._recorded, self._story, self._config, self._near, self._of = recorded, story, config, near, chosen
        self._choices, self._margins = story.choices.copy(), story.margins.copy()
        mixtures = [mixture for _, mixture in recorded.mixtures]
        self._nodes = np.array([node for node, _ in recorded.mixtures], dtype=np.intp)
        self._by_sight = np.array([mixture.by_sight for mixture in mixtures], dtype=bool)
        # of the compass, the tracks say nothing but how much to believe of it
        self._by_compass = np.array([mixture.by_compass for mixture in mixtures], dtype=bool)
        self._looked_at = story.poses[self._nodes] if near is None else near.looked_at.copy()

    def settled(self) -> Settled:
        story, known, solution = (
            self._story,
            self._near is not None,
            None if self._near is None else self._near.solution,
        )
        poses, compass = story.poses, [] if known else np.flatnonzero(self._by_compass).tolist()
        roughly = np.broadcast_to(_ROUGHLY, (len(self._nodes), 3, 3))
        self._choose(compass, self._about(poses, poses, np.zeros(len(poses))), roughly, self._offsets(None)[1])
        self._of.ask([mixture for _, mixture in self._recorded.mixtures], self._choices.tolist())
        for first in (not known, *(_ROUNDS - 1) * (False,)):
            chain = self._recorded.chain(self._choices, story.breaks, poses, self.chosen)
            if solution is None and self._config.graph.cauchy < NO_KERNEL:
                # while eyes and odometry are taken to be perfect, what fits badly may be right
                solution = chain_engine.solve(chain, without_kernel(self._config))
                chain = replace(chain, guess=solution.poses)
            solution = chain_engine.solve(chain, self._config, solution)
            poses = solution.poses
            out = Settled(
                self._choices.copy(), story.breaks, chain, solution, self._margins.copy(), self._looked_at.copy()
            )
            offsets, variances = self._offsets(solution)
            about = self._about(poses, chain.seen_from(poses, solution.calibration, solution.sensor), offsets)
            doubtful = self._doubtful(chain, about, solution.covariances[self._nodes], first)
            changed = self._choose(doubtful, about, solution.covariances[self._nodes], variances)
            if not changed or not self._recorded.anchored(self._choices, story.breaks):
                break
        return out

    def chosen(self, index: int, choice: int) -> tuple[Factor, ...]:
        """The factors of a mixture's solution."""
        return self._of(self._recorded.mixtures[index][1], choice)

    def _about(self, poses: FloatArray, seen_from: FloatArray, offsets: FloatArray) -> FloatArray:
        """(t, 3) the pose that each mixture is about."""
        out = np.where(self._by_sight[:, None], seen_from[self._nodes], poses[self._nodes])
        out[:, 2] += np.where(self._by_compass, offsets[self._nodes], 0.0)
        return out

    def _offsets(self, solution: Solution | None) -> tuple[FloatArray, FloatArray]:
        known = (np.zeros(0),) * 2 if solution is None else (solution.compass_rad, solution.compass_variance_rad2)
        return at_nodes(self._recorded.stamps_ns, *known, self._config.compass)

    def _doubtful(self, chain: Chain, about: FloatArray, covariances: FloatArray, first: bool) -> list[int]:
        """Mixtures to look at again: unsure ones if their poses have moved since, those that fit badly."""
        moved = se2.local(self._looked_at, about)
        distance = np.sum(moved * np.linalg.solve(covariances, moved[..., None])[..., 0], axis=-1)
        unsure = (self._margins < _SURE) | (self._choices < 0) | self._by_compass
        taken = np.flatnonzero(self._choices >= 0)
        factors = [self.chosen(index, int(self._choices[index])) for index in taken.tolist()]
        owner = np.repeat(taken, [len(each) for each in factors])
        squares, gates = squared_errors([factor for each in factors for factor in each], about[owner], GATES)
        misfit = np.zeros(len(about), dtype=bool)
        misfit[owner[squares > gates]] = True
        return np.flatnonzero((unsure & (first | (distance > _MOVED))) | misfit).tolist()

    def _choose(self, which: list[int], about: FloatArray, covariances: FloatArray, variances: FloatArray) -> bool:
        """The best solution of each of these mixtures, in the light of all others; whether one changed.

        about, covariances: of each mixture's pose. variances: of the compass' offset at the nodes. Where the eyes were
        is taken to be known as well as where the robot is: their calibration is a whole log's.
        """
        changed = False
        for index in which:
            before = int(self._choices[index])
            self._looked_at[index] = about[index]
            pose, covariance = about[index], covariances[index]
            if self._by_compass[index]:
                covariance = covariance + np.diag([0.0, 0.0, variances[self._nodes[index]]])
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
        worth = np.concatenate([near.log_blind(mixture, 1), near.evidence])
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
    return log_evidences([recorded], [settled], config, log_kidnap)[0]


def log_evidences(logs: Sequence[Recorded], ways: Sequence[Settled], config: Config, log_kidnap: float) -> list[float]:
    """Of several ways to read the same log, on whatever copies of the field."""
    abouts = [_about(recorded, settled, config) for recorded, settled in zip(logs, ways, strict=True)]
    out = [
        _log_peak(recorded, settled, config, log_kidnap, seen_from)
        for recorded, settled, (_, seen_from) in zip(logs, ways, abouts, strict=True)
    ]
    for index in np.flatnonzero(_differing(logs, ways, [about for about, _ in abouts])).tolist():
        mixtures = [recorded.mixtures[index][1] for recorded in logs]
        poses = np.array([about[index] for about, _ in abouts])
        choices = [int(settled.choices[index]) for settled in ways]
        out = [total + term for total, term in zip(out, _log_terms(mixtures, choices, poses), strict=True)]
    return out


def _differing(logs: Sequence[Recorded], ways: Sequence[Settled], abouts: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """(t,) which mixtures do not say the same of all the ways; all of them where there is but one."""
    out = np.full(len(ways[0].choices), len(ways) == 1)
    for recorded, settled, about in zip(logs[1:], ways[1:], abouts[1:], strict=True):
        pairs = zip(logs[0].mixtures, recorded.mixtures, strict=True)
        out |= np.array([one is not other for (_, one), (_, other) in pairs], dtype=bool)
        out |= settled.choices != ways[0].choices
        out |= (np.abs(se2.local(abouts[0], about)) > _SAME).any(axis=1)
    return out


def _about(recorded: Recorded, settled: Settled, config: Config) -> tuple[FloatArray, FloatArray]:
    """(t, 3) the pose that each mixture is about; (n, 3) where the eyes were."""
    solution, nodes = settled.solution, np.array([node for node, _ in recorded.mixtures], dtype=np.intp)
    offsets, _ = at_nodes(recorded.stamps_ns, solution.compass_rad, solution.compass_variance_rad2, config.compass)
    seen_from = settled.chain.seen_from(solution.poses, solution.calibration, solution.sensor)
    by_sight = np.array([mixture.by_sight for _, mixture in recorded.mixtures], dtype=bool)
    by_compass = np.array([mixture.by_compass for _, mixture in recorded.mixtures], dtype=bool)
    about = np.where(by_sight[:, None], seen_from[nodes], solution.poses[nodes])
    about[:, 2] += np.where(by_compass, offsets[nodes], 0.0)
    return about, seen_from


def _log_peak(recorded: Recorded, settled: Settled, config: Config, log_kidnap: float, seen_from: FloatArray) -> float:
    """All of a log's evidence but that of its mixtures."""
    solution, poses, total = settled.solution, settled.solution.poses, 0.0
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


def _log_terms(mixtures: Sequence[MixtureFactor], choices: Sequence[int], poses: FloatArray) -> list[float]:
    """log p(observation, choice | pose) for each choice at its pose: of one observation, on its copies of the field."""
    stills = [mixture.still if isinstance(mixture, Moved) else mixture for mixture in mixtures]
    at = np.array(
        [
            se2.compose(se2.inverse(mixture.by), pose) if isinstance(mixture, Moved) else pose
            for mixture, pose in zip(mixtures, poses, strict=True)
        ]
    )
    still = stills[0]
    assert all(other is still for other in stills)
    if still.by_compass:  # disturbances are in the middle of it
        return [float(value) for value in still.log_likelihood(at)]
    out = [still.log_outlier] * len(at)
    if max(choices) >= 0:
        near = still.expand(at, np.broadcast_to(_POINT, (len(at), 3, 3)))
        for row in np.flatnonzero(near.ids == np.array(choices)[near.parent]):
            out[near.parent[row]] = float(near.constant[row])
    return out


def _log_normal(values: FloatArray, sigmas: FloatArray) -> float:
    return float(-0.5 * np.sum((values / sigmas) ** 2 + np.log(2 * np.pi * sigmas**2)))
