"""An odometry that leads: the robot does what it says so much later, as it says what the robot was told to do.

What is seen may be late, too, and only the sum of both shows in a log: how late the eyes are against the odometry. So
that is what is solved for at first. Which part of it is the odometry's, the prior sigmas say (that of two normal
numbers whose sum is known); then the motions are those of the odometry so much earlier, and what is left is the eyes'.
An odometry that states its covariance is a measurement, and not late.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators import chain_engine
from estimators.chain import Chain, Recorded
from estimators.chosen import Chosen
from estimators.config import Config
from estimators.joint import Settled, finished, settle
from estimators.motion import SAID, Increment
from estimators.solution import Solution
from estimators.stretches import Story
from fieldloc import pose as se2
from fieldloc.pose import FloatArray

_LEAST_S = 2e-3  # not worth new motions
_ROUNDS = 4
_MOST_SIGMAS = 3.0  # what is more is no delay


@dataclass(frozen=True, slots=True)
class Lateness:
    """late_s: how late the robot does what the odometry says, beyond what the settings say; sigma_s: of that, when the
    sum with the eyes' delay is known."""

    late_s: float
    sigma_s: float


def may_be_late(recorded: Recorded, config: Config) -> bool:
    """Whether there is odometry that does not state its covariance, and the settings leave open how late it is."""
    known = config.calibration.odometry_delay_sigma_s == 0.0 or config.sensor.delay_sigma_s == 0.0
    return not known and any(motion.parts[:SAID].any() for motion in recorded.motions)


def against_odometry(config: Config) -> Config:
    """Settings whose eyes' delay is that against the odometry."""
    sensor = config.sensor
    if sensor.delay_sigma_s == 0.0:
        return config
    sigma_s = float(np.hypot(sensor.delay_sigma_s, config.calibration.odometry_delay_sigma_s))
    return replace(config, sensor=replace(sensor, delay_sigma_s=sigma_s))


def split(delay_s: float, config: Config) -> Lateness:
    """Of the eyes' delay against the odometry."""
    eyes, robot = config.sensor.delay_sigma_s**2, config.calibration.odometry_delay_sigma_s**2
    if eyes == 0.0 or robot == 0.0:
        return Lateness(0.0, 0.0)
    share, most_s = robot / (eyes + robot), _MOST_SIGMAS * float(np.sqrt(eyes + robot))
    more_s = min(max(delay_s - config.sensor.delay_s, -most_s), most_s)
    return Lateness(share * more_s, float(np.sqrt(share * eyes)))


def found(recorded: Recorded, chain: Chain, breaks: Sequence[int], near: Solution, config: Config) -> Lateness:
    """How late the odometry was, and beside it the eyes.

    near: a solution of the chain under `against_odometry(config)`. The chain's sensor knows a delay as far as the
    robot's velocity stays the same, so it is asked again with motions that are late until nothing changes.
    """
    lateness = split(near.sensor.delay_s, config)
    for _ in range(_ROUNDS):
        moved = later(recorded, lateness.late_s).carried(breaks)
        near = chain_engine.solve(replace(chain, motions=moved, guess=near.poses), config, near)
        before, lateness = lateness, split(lateness.late_s + near.sensor.delay_s, config)
        if abs(lateness.late_s - before.late_s) < _LEAST_S:
            break
    return lateness


def settled_in_time(
    recorded: Recorded, story: Story, answer: Settled, config: Config, chosen: Chosen | None = None
) -> Settled:
    """answer: how it was settled under `against_odometry(config)`. The same with motions as late as they were.

    Only the sum of both delays is known well: the poses may be late by what that leaves open, and so may the eyes.
    """
    solution = answer.solution
    lateness = found(recorded, answer.chain, answer.breaks, solution, config)
    story = replace(story, choices=answer.choices, margins=answer.margins, breaks=answer.breaks, poses=solution.poses)
    out = finished(settle(later(recorded, lateness.late_s), story, config, answer, chosen), config)
    solution = out.solution
    velocities = out.chain.velocities(np.array(solution.calibration))
    open_ = velocities[:, :, None] * velocities[:, None, :] * lateness.sigma_s**2
    common = solution.global_covariance.copy()
    common[-1, -1] += lateness.sigma_s**2
    solution = replace(
        solution,
        covariances=solution.covariances + open_,
        global_covariance=common,
        late_s=config.calibration.odometry_delay_s + lateness.late_s,
    )
    return replace(out, solution=solution)


def later(recorded: Recorded, late_s: float) -> Recorded:
    """The same with what the odometry says happening so much later; before its beginning it says what it says first."""
    if abs(late_s) < _LEAST_S or len(recorded.motions) < 1:
        return recorded
    stamps_s = (np.array(recorded.stamps_ns) - recorded.stamps_ns[0]) * 1e-9
    return replace(recorded, motions=_shifted(recorded.motions, stamps_s, stamps_s - late_s))


def _shifted(motions: Sequence[Increment], stamps_s: FloatArray, at_s: FloatArray) -> tuple[Increment, ...]:
    """From at_s[k] to at_s[k + 1] (n,), each put together from parts of the motions between the stamps (n,)."""
    tangents = se2.log(np.array([motion.before_from_after for motion in motions]))
    covariances = np.array([motion.covariance for motion in motions])
    by_calibration = np.array([motion.by_calibration for motion in motions])
    parts = np.array([motion.parts for motion in motions])
    edges_s = stamps_s.copy()
    edges_s[0], edges_s[-1] = min(stamps_s[0], at_s[0]), max(stamps_s[-1], at_s[-1])
    lasts_s = np.diff(stamps_s)
    piece = np.clip(np.searchsorted(edges_s, at_s[:-1], side="right") - 1, 0, len(motions) - 1)
    now_s, end_s = at_s[:-1].copy(), at_s[1:]
    moved = np.zeros((len(motions), 3))
    out_covariance, out_calibration, out_parts = (np.zeros_like(a) for a in (covariances, by_calibration, parts))
    open_ = np.ones(len(motions), dtype=bool)
    while open_.any():
        k, j = np.flatnonzero(open_), piece[open_]
        until_s = np.minimum(end_s[k], edges_s[j + 1])
        share = np.maximum(until_s - now_s[k], 0.0) / lasts_s[j]
        step = se2.exp(share[:, None] * tangents[j])
        back = se2.adjoint(se2.inverse(step))
        moved[k] = se2.compose(moved[k], step)
        out_covariance[k] = _carried(back, out_covariance[k]) + share[:, None, None] * covariances[j]
        out_calibration[k] = back @ out_calibration[k] + share[:, None, None] * by_calibration[j]
        out_parts[k] = _carried(back[:, None], out_parts[k]) + share[:, None, None, None] * parts[j]
        now_s[k] = until_s
        open_[k] = (until_s < end_s[k]) & (j + 1 < len(motions))
        piece[k] = np.minimum(j + 1, len(motions) - 1)
    return tuple(map(Increment, moved, out_covariance, out_calibration, out_parts))


def _carried(back: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(back @ covariance @ np.swapaxes(back, -1, -2))
