"""Where a robot moved unseen by more than its odometry knows of: it fell and got up, was pushed, slipped.

What puts it farther away is found as being carried (estimators.stretches). Less than that leaves one track, which is
held to the odometry, and takes what is seen next for wrong or the odometry for drifting. So the log is solved once more
with the odometry doubted wherever nothing was seen for a while, and what of that was sooner a slip stays doubted.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimators import chain_engine
from estimators.breaks import SURELY, each_way, jump
from estimators.chain import Recorded
from estimators.chosen import Chosen
from estimators.config import Config
from estimators.joint import Settled, settle
from estimators.silence import FALLEN
from estimators.stretches import Story
from fieldloc.covariance import log_peaks
from fieldloc.pose import FloatArray

_UNSEEN_S = 1.0

Gap = tuple[int, int]


def with_slips(
    recorded: Recorded, story: Story, answer: Settled, config: Config, chosen: Chosen
) -> tuple[Recorded, Settled]:
    """answer: how the story was settled. Both as they were where no slip is found; else with the odometry doubted in
    gaps by as far as the robot slipped."""
    gaps = _unseen(recorded, answer)
    if not gaps:
        return recorded, answer
    doubted = _doubted(recorded, dict.fromkeys(gaps, FALLEN))
    chain = replace(answer.chain, motions=doubted.carried(answer.breaks), guess=answer.solution.poses)
    trial = replace(answer, chain=chain, solution=chain_engine.solve(chain, config, answer.solution))
    slips = {gap: by for gap in gaps if (by := _slipped(recorded, trial, gap, config)) is not None}
    if not slips:
        return recorded, answer
    poses = trial.solution.poses
    story = replace(story, choices=answer.choices, margins=answer.margins, poses=poses)
    recorded = _doubted(recorded, slips)
    return recorded, settle(recorded, story, config, trial, chosen)


def _unseen(recorded: Recorded, answer: Settled) -> list[Gap]:
    """Nodes of neighbouring sights that are a while apart, without a break between them."""
    out = []
    for before, after in pairwise(recorded.sights(answer.choices)):
        long = recorded.stamps_ns[after] - recorded.stamps_ns[before] > _UNSEEN_S * 1e9
        if long and not any(before < node <= after for node in answer.breaks):
            out.append((before, after))
    return out


def _doubted(recorded: Recorded, gaps: dict[Gap, FloatArray]) -> Recorded:
    """With so much more covariance (3, 3) in each gap: a third of it at once, as a robot that falls loses sight by it,
    a third as it gets up and sees again, the rest in between."""
    motions = list(recorded.motions)
    for (before, after), covariance in gaps.items():
        elapsed = np.diff(np.array(recorded.stamps_ns[before : after + 1]))
        shares = elapsed / elapsed.sum() / 3.0
        shares[0] += 1.0 / 3.0
        shares[-1] += 1.0 / 3.0
        for k, share in enumerate(shares.tolist(), before):
            motions[k] = replace(motions[k], covariance=motions[k].covariance + share * covariance)
    return replace(recorded, motions=tuple(motions))


def _slipped(recorded: Recorded, trial: Settled, gap: Gap, config: Config) -> FloatArray | None:
    """Covariance (3, 3) of how far, None where the odometry is the likelier one to be right.

    trial: solved without much regard for it, so that what is known of both ends comes of what was seen there.
    """
    apart, odometry = jump(recorded, trial, *gap)
    before, after = trial.solution.covariances[list(gap)]
    known = odometry + before + after  # turned a little against each other
    unseen_min = (recorded.stamps_ns[gap[1]] - recorded.stamps_ns[gap[0]]) / 60e9
    covariances = np.array([known, known + FALLEN])
    squared = np.sum(apart * np.linalg.solve(covariances, np.broadcast_to(apart, (2, 3))[..., None])[..., 0], axis=1)
    straight, slip = log_peaks(covariances) - 0.5 * squared
    if slip + np.log(config.mixture.kidnaps_per_min * unseen_min) - SURELY < straight:
        return None
    return np.asarray(each_way(apart[None])[0])
