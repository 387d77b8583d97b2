"""States with covariance and evidence, over all amounts of the model's noise that their residuals allow.

How far a map is off its field, and a lens off its model, is not known beforehand, but the residuals of one picture show
it: each amount of such noise has its own fit, with its own evidence, and what few residuals cannot tell stays open, in
the covariance.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc import pose as se2
from fieldloc.locate.amounts import AMOUNTS, log_often
from fieldloc.locate.cameras import IntArray
from fieldloc.locate.evidence import log_missed
from fieldloc.locate.matching import Matches, match
from fieldloc.locate.noise import Noise
from fieldloc.locate.refine import linearise, stepped
from fieldloc.locate.task import Task
from fieldloc.locate.windows import Windows, cut
from fieldloc.pose import FloatArray

_HIDDEN = 4.0  # times as much as it shows may a fit hide
_LEAST_NUMBERS = 4  # of a pose, height and attitude known somewhat
_UNKNOWN = np.array([1.5, 1.5, 0.5])  # standard deviations of what is no pose any more
_MARGIN = 25.0  # so much less evidence than the best is none,
_WORTH_CUTTING = 10.0  # and so much less not worth telling exactly
_STEPS = 4  # of pieces
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """states: (k, 6). covariances: (k, 6, 6) of these. log_evidence: (k,) log density of all detected, less that if
    none of it were the map's, integrated over all states; in which is log_missed:
    (k,) for what should be seen and is not. Of those worth telling only."""

    states: FloatArray
    covariances: FloatArray
    matches: Matches
    log_evidence: FloatArray
    log_missed: FloatArray

    def take(self, rows: IntArray) -> "Settled":
        return Settled(
            self.states[rows],
            self.covariances[rows],
            self.matches.take(rows),
            self.log_evidence[rows],
            self.log_missed[rows],
        )

    def and_also(self, other: "Settled") -> "Settled":
        return Settled(
            np.concatenate([self.states, other.states]),
            np.concatenate([self.covariances, other.covariances]),
            self.matches.and_also(other.matches),
            np.concatenate([self.log_evidence, other.log_evidence]),
            np.concatenate([self.log_missed, other.log_missed]),
        )


def settle(task: Task, states: FloatArray, matches: Matches) -> Settled:
    whole = _settled(task, states, matches, Windows.none(len(states)))
    order = np.argsort(-whole.log_evidence, kind="stable")
    order = order[whole.log_evidence[order] > whole.log_evidence.max(initial=-np.inf) - _WORTH_CUTTING]
    pieces, windows, parents = cut(whole.states, whole.covariances, order)
    if len(pieces):
        matches, missed = whole.matches.take(parents), whole.log_missed[parents]
        for _ in range(_STEPS):
            pieces = stepped(pieces, linearise(task.cameras(pieces), task.noise(), matches, task.prior, windows))
        whole = whole.take(np.setdiff1d(np.arange(len(whole.states)), parents)).and_also(
            _settled(task, pieces, matches, windows, missed)
        )
    known = (whole.covariances[:, [0, 1, 2], [0, 1, 2]] < _UNKNOWN**2).all(axis=1)
    log_evidence = np.where(known, whole.log_evidence, -np.inf)
    good = np.flatnonzero(log_evidence > max(float(log_evidence.max(initial=-np.inf)) - _MARGIN, -1e9))
    return whole.take(good)


def _settled(
    task: Task, states: FloatArray, matches: Matches, windows: Windows, missed: FloatArray | None = None
) -> Settled:
    """missed: (k,) if it is known."""
    shape, prior, settings = task.shape, task.prior, task.settings
    count, amounts = len(states), len(AMOUNTS)
    noise = Noise(task.sight, shape, settings, 0.0, AMOUNTS)
    windows = windows.repeat(amounts)
    fitted = np.repeat(states, amounts, axis=0)
    matches = matches.take(np.repeat(np.arange(count), amounts))
    fitted = stepped(fitted, linearise(task.cameras(fitted), noise, matches, prior, windows))
    cameras = task.cameras(fitted)
    matches = match(cameras, noise)
    step = linearise(cameras, noise, matches, prior, windows)
    covariances = np.linalg.inv(step.information)
    log_prior = 0.5 * np.linalg.slogdet(prior.precision)[1] - 1.5 * _LOG_2PI - 0.5 * step.prior + windows.logs(fitted)
    log_volume = 3.0 * _LOG_2PI - 0.5 * np.linalg.slogdet(step.information)[1]
    log_somewhere = -np.log(shape.area_m2 * 2.0 * np.pi)
    logs = matches.gains + log_prior + log_volume + log_somewhere + np.tile(log_often(task.sight), count)
    xy = fitted[:, :2]
    possible = ((xy > shape.box[:2]) & (xy < shape.box[2:])).all(axis=1) & (step.numbers >= _LEAST_NUMBERS)
    logs = np.where(possible, logs, -np.inf).reshape(count, amounts)
    log_evidence = np.logaddexp.reduce(logs, axis=1)
    good = np.isfinite(log_evidence)
    shares = np.exp(logs - np.where(good, log_evidence, 0.0)[:, None])
    rows = np.arange(count) * amounts + np.argmax(logs, axis=1)
    off = fitted.reshape(count, amounts, 6) - fitted[rows][:, None]
    off[..., [2, 5]] = se2.wrap(off[..., [2, 5]])
    second = covariances.reshape(count, amounts, 6, 6) + off[..., None] * off[..., None, :]
    covariance = np.einsum("ks,ksij->kij", shares, second)
    # a lens and a map that fit in all that residuals show are right in what they do not show, too
    systematic = np.minimum(_HIDDEN * np.exp(shares @ np.log(AMOUNTS)), 1.0)
    # an error of the focal length moves the fit
    by_focal = (covariances @ step.by_focal[..., None])[rows] * (settings.focal * systematic)[:, None, None]
    covariance = covariance + by_focal @ np.swapaxes(by_focal, 1, 2)
    # what is near each other on the map is off it together, so no place is known better than the map
    covariance[:, [0, 1], [0, 1]] += ((systematic * settings.map_m) ** 2)[:, None]
    good = np.flatnonzero(good & (log_evidence > log_evidence.max(initial=-np.inf) - _MARGIN))
    rows = rows[good]
    states, matches = fitted[rows], matches.take(rows)
    if missed is None:
        missed = log_missed(task.cameras(states), task.sight, shape, matches, settings)
    else:
        missed = missed[good]
    return Settled(states, covariance[good], matches, log_evidence[good] + missed, missed)
