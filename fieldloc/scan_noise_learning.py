"""What a sensor's scans themselves tell of their noise: residual maximum likelihood, scan by scan (Patterson & Thompson
1971), by Fisher scoring.

The errors of a scan whose landmarks are known have the covariance

    S = own_range V1 + own_bearing V2 + shared_range V3 + other + J P J'

with the stated variances in V. The slope of the log-likelihood by the logarithm of a share is
share / 2 (e' S^-1 V S^-1 e - tr S^-1 V), its information share^2 / 2 tr(S^-1 V S^-1 V): what cannot be seen keeps the
value that it had before. The pose is taken to be anywhere (P), so only what differs within a scan counts: errors that
stay alike are in what an estimator believes already, and an innovation would show them too small.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.scan_noise import NoisePrior, ScanNoise, shared_directions

_NOTHING = 1e-3  # a share that is as good as none
# neighbours on the map have errors alike beyond what the whole scan shares: who errs by less than a fifth of what is
# stated is not believed
_LEAST = 0.05
_LOWEST = np.log([_LEAST, _LEAST, _NOTHING])
_HIGHEST = np.log(9.0)
_LONGEST = 0.5  # step in a logarithm
_KEPT = 2000.0  # information in a logarithm: about as many errors are remembered, older ones forgotten
_FAR_OFF = 4.0  # standard deviations of chi-square beyond its mean, where an error counts no more than one there
_ANYWHERE = np.array([10.0, 10.0, 1.0]) ** 2  # m^2, m^2, rad^2


class ScanErrors(NamedTuple):
    """error: (n, 2) of range and bearing of landmarks that are known; jacobian (n, 2, 3) by the sensor's pose. stated
    (n, 2, 2) covariances of the error; other (2n, 2n) that of other reasons: the map, an unknown distortion."""

    error: FloatArray
    jacobian: FloatArray
    stated: FloatArray
    other: FloatArray


class NoiseLearner:
    """Of one sensor. count: scans that it has learned from."""

    def __init__(self, prior: NoisePrior) -> None:
        self.count = 0
        self._prior = prior
        self._log_shares = np.log(np.maximum([prior.own, prior.own, prior.shared], _NOTHING))
        self._sigmas = np.array([prior.own_log_sigma, prior.own_log_sigma, prior.shared_log_sigma])
        self._learned = np.zeros((3, 3))

    @property
    def noise(self) -> ScanNoise:
        """As thought now."""
        own_range, own_bearing, shared = self._shares.tolist()
        turned = max(1.0 - own_bearing, self._prior.shared)
        return ScanNoise(own_range, own_bearing, shared if shared > 1.01 * _NOTHING else 0.0, turned)

    @property
    def _shares(self) -> FloatArray:
        """(3,) own_range, own_bearing, shared_range. Few scans tell what they share, so it is thought to be what own
        errors leave of the variance that was thought of before, until they do."""
        out = np.exp(self._log_shares)
        out[2] *= self._left(out[0]) / max(self._prior.shared, _NOTHING)
        return np.asarray(out)

    def _left(self, own_range: float) -> float:
        least = max(self._prior.shared, _NOTHING)
        return max(least, least + self._prior.own - own_range) if self._sigmas[2] > 0.0 else least

    @property
    def log_sigmas(self) -> FloatArray:
        """(3,) standard deviations of the logarithms of own_range, own_bearing, shared_range."""
        root = self._sigmas
        return np.asarray(root * np.sqrt(np.diagonal(np.linalg.inv(np.eye(3) + root[:, None] * self._learned * root))))

    def learn(self, met: ScanErrors, news: float, unknown: FloatArray | None = None) -> FloatArray:
        """news: by how much it counts, less if it is much the same as before. unknown: (2n, 2n) covariance of what is
        learned of the errors elsewhere.

        (2n, 2n) inverse of the errors' covariance as thought before and from anywhere, without what is unknown of them;
        what is far off for all that counts less.
        """
        parts, shares = _parts(met.stated), self._shares
        whole = self._whole(met, parts, shares)
        precision = np.linalg.inv(whole if unknown is None else whole + unknown)
        weighted = precision @ met.error.ravel()
        trust = _trust(met.error, precision)
        by_part = precision @ parts
        slope = 0.5 * shares * (trust * (weighted @ parts @ weighted) - np.trace(by_part, axis1=-2, axis2=-1))
        # tr(A B) is the sum over A and B' element by element
        information = 0.5 * np.outer(shares, shares) * (_flat(by_part) @ _flat(by_part.swapaxes(-1, -2)).T)
        kept = min(1.0, _KEPT / max(float(np.trace(self._learned)), _KEPT))
        self._learned = kept * self._learned + news * information
        # the prior is what it starts from and how far it goes at first
        root = self._sigmas
        step = root * np.linalg.solve(np.eye(3) + root[:, None] * self._learned * root, root * (news * slope))
        step *= _LONGEST / max(float(np.abs(step).max()), _LONGEST)
        self._log_shares = np.where(root > 0.0, np.clip(self._log_shares + step, _LOWEST, _HIGHEST), self._log_shares)
        self.count += 1
        return np.asarray(trust * (precision if unknown is None else np.linalg.inv(whole)))

    def _whole(self, met: ScanErrors, parts: FloatArray, shares: FloatArray) -> FloatArray:
        """(2n, 2n)."""
        flat = met.jacobian.reshape(met.error.size, 3)
        return np.asarray((shares @ _flat(parts)).reshape(met.other.shape) + met.other + (flat * _ANYWHERE) @ flat.T)


def _flat(matrices: FloatArray) -> FloatArray:
    """(k, m) of (k, ...)."""
    return matrices.reshape(len(matrices), -1)


def _trust(error: FloatArray, precision: NDArray[np.floating]) -> float:
    """One that is far off for all that is known is hardly of that landmark."""
    free = error.size - 3
    edge = float(free + _FAR_OFF * (2.0 * free) ** 0.5)
    return min(1.0, edge / max(float(error.ravel() @ precision @ error.ravel()), 1e-300))


def _parts(stated: FloatArray) -> FloatArray:
    """(3, 2n, 2n)."""
    rows = 2 * np.arange(len(stated))
    out = np.zeros((3, 2 * len(stated), 2 * len(stated)))
    out[0, rows, rows] = stated[:, 0, 0]
    out[1, rows + 1, rows + 1] = stated[:, 1, 1]
    longer = shared_directions(stated)[:, 0]
    out[2, ::2, ::2] = np.outer(longer, longer)
    return out
