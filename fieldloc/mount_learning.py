"""What is wrong all the time with where a camera sits, learned image by image while a robot goes about.

The same model and the same numbers of each image as `fieldloc.mount_fit` has for whole logs: a constant error, and a
wobble from image to image whose sigmas come by expectation maximization, here with one step an image. What was learned
fades over minutes: a fall can bend a neck.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount, ImageFeatures
from fieldloc.mount_correction import PARTS, ROWS, MountCorrection
from fieldloc.mount_fit import PRIOR_IMAGES
from fieldloc.mount_rows import Rows, View, Weighed, rows_of
from fieldloc.pose import FloatArray
from fieldloc.repetition import inflation

_DOUBT = 4.0  # the pose comes of this very image, too: it is known worse than it claims
_FADES_S = 120.0
_LOOK_WITHIN = 0.5  # of what is claimed, beside what is known: for what has changed since
_LEAST_S = 0.3  # between images that are looked at: nearer ones say much the same, and looking costs as much as solving


class LearnedMount:
    """One for a camera. correlation_s: over what time images err alike."""

    def __init__(self, camera: Camera, field: FieldMap, correlation_s: float) -> None:
        self._camera, self._field, self._correlation_s = camera, field, correlation_s
        self._so_far: _SoFar | None = None
        self._last_ns = 0

    def applied(self, mount: CameraMount) -> CameraMount:
        """The mount as it is known to be by now."""
        if self._so_far is None or not self._so_far.count:
            return mount
        return _correction(self._so_far.error, self._so_far.left).applied(mount)

    def learn(self, image: ImageFeatures, pose: FloatArray, covariance: FloatArray) -> None:
        """image: with its mount as the log says. pose: (3,) that it was taken from, covariance (3, 3) in the robot
        frame; to be called for a robot that is surely there."""
        if self._so_far is None:
            sigmas = np.sqrt(np.diagonal(image.mount.covariance)[list(ROWS)])
            if not (sigmas > 0.0).all():
                return
            so_far, news = _SoFar.nothing(sigmas), 1.0
        else:
            if 0 <= image.stamp_ns - self._last_ns < _LEAST_S * 1e9:
                return
            elapsed_s = max(image.stamp_ns - self._last_ns, 0) * 1e-9
            so_far = self._so_far.faded(math.exp(-elapsed_s / _FADES_S))
            news = float(1.0 / inflation(np.array(elapsed_s), self._correlation_s))
        mount, known = _correction(so_far.error, np.zeros(3)).applied(image.mount), _DOUBT * covariance
        where = np.zeros((len(PARTS), len(PARTS)))
        where[:3, :3] = so_far.covariance + np.diag((_LOOK_WITHIN * so_far.sigmas) ** 2)
        self._so_far, self._last_ns = so_far, image.stamp_ns
        try:
            rows = rows_of(View(image, mount, where, pose, known, self._camera, self._field))
            after = so_far.after(rows, known, news) if len(rows.residual) else so_far
        except np.linalg.LinAlgError:  # pixels that are claimed to be exact
            return
        if after.is_finite:
            self._so_far = after


def _correction(error: FloatArray, sigmas: FloatArray) -> MountCorrection:
    """By (3,) of height, tilt and roll; the focal length is as it was thought to be."""
    return MountCorrection(*[*error.tolist(), 0.0, *sigmas.tolist()])


@dataclass(frozen=True, slots=True, eq=False)
class _SoFar:
    """What is known of height, tilt and roll. sigmas: (3,) claimed. information (3, 3) and vector (3,)
    of the constant error. squares: (3,) of the wobble, summed, of `count` images' worth."""

    sigmas: FloatArray
    information: FloatArray
    vector: FloatArray
    squares: FloatArray
    count: float

    @staticmethod
    def nothing(sigmas: FloatArray) -> "_SoFar":
        return _SoFar(sigmas, np.diag(1.0 / sigmas**2), np.zeros(3), np.zeros(3), 0.0)

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the constant error."""
        return np.asarray(np.linalg.inv(self.information), dtype=np.float64)

    @property
    def error(self) -> FloatArray:
        """(3,) the constant one."""
        return np.asarray(np.linalg.solve(self.information, self.vector), dtype=np.float64)

    @property
    def wobble(self) -> FloatArray:
        """(3,) standard deviations image by image."""
        prior = PRIOR_IMAGES * (0.5 * self.sigmas) ** 2
        return np.sqrt((prior + self.squares) / (PRIOR_IMAGES + self.count))

    @property
    def left(self) -> FloatArray:
        """(3,) standard deviations of an image's error beside what is known of it; no more than is claimed."""
        return np.minimum(np.sqrt(np.diagonal(self.covariance) + self.wobble**2), self.sigmas)

    @property
    def is_finite(self) -> bool:
        return all(np.isfinite(each).all() for each in (self.information, self.vector, self.squares, self.count))

    def faded(self, share: float) -> "_SoFar":
        """With that share of what was learned."""
        prior = np.diag((1.0 - share) / self.sigmas**2)
        return _SoFar(
            self.sigmas,
            share * self.information + prior,
            share * self.vector,
            share * self.squares,
            share * self.count,
        )

    def after(self, rows: Rows, known: FloatArray, news: float) -> "_SoFar":
        """With another image, taken from a pose of covariance `known` (3, 3), that counts as so much of one."""
        error, wobble = self.error, self.wobble
        rows = replace(rows, by_mount=rows.by_mount[:, : len(error)])
        weighed = Weighed.of(rows, known, wobble, news)
        information, vector = weighed.says(rows)
        vector = vector + information @ error
        step = np.linalg.solve(self.information + information, self.vector + vector) - error
        mean, variance = weighed.wobbled(rows, wobble, weighed.left(step))
        return _SoFar(
            self.sigmas,
            self.information + information,
            self.vector + vector,
            self.squares + weighed.weight * (mean**2 + variance),
            self.count + weighed.weight,
        )
