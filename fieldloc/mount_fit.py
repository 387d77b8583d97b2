"""What is wrong all the time with where a camera sits and how it sees: its height, tilt and roll and its focal length,
from images and the poses they were taken from.

A head that is a degree askew turns all lines and feet of all images alike; gait and joints add to it what differs from
image to image. Both are told apart by their scatter:

    error of the mount in image i = constant + wobble_i,   wobble_i ~ N(0, diag(wobble^2))

The constant, and the wobble's sigmas by expectation maximization, come from the ends of lines and the posts' feet, each
against the thing on the map that it can be from there alone. A constant pan is a turn of all bearings, which no image
tells from a turn of the robot: it is the business of who knows how the robot moves (estimators.sensor). A focal length
does not change from image to image.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures
from fieldloc.mount_correction import PARTS, MountCorrection
from fieldloc.mount_rows import Rows, View, Weighed, rows_of
from fieldloc.pose import FloatArray
from fieldloc.repetition import inflation

_ROUNDS = 6
_SETTLED = 0.1  # of a sigma
_WOBBLES = np.array([1.0, 1.0, 1.0, 0.0])
_EXACT = 1e-9  # standard deviation of what is taken as known
_SIZE = len(PARTS)
_DOUBT = 9.0  # of variances: images' poses come from these very images, and lean the way that the camera is off
PRIOR_IMAGES = 4.0  # how many images the prior of the wobble is worth


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """In the order of mount_correction.PARTS: error (4,), what is to be added to what the log says; covariance (4, 4)
    of that; wobble (4,) standard deviations image by image. sigmas: (4,) of the error beforehand. images: how many had
    something to say.
    """

    error: FloatArray
    covariance: FloatArray
    wobble: FloatArray
    sigmas: FloatArray
    images: int


def fit_mount(
    images: Sequence[ImageFeatures],
    poses: FloatArray,
    covariances: FloatArray,
    camera: Camera,
    field: FieldMap,
    sigmas: FloatArray,
    correlation_s: float = 1.0,
) -> MountFit:
    """images with the poses (n, 3) they were taken from and covariances (n, 3, 3) of those, robot frame.

    sigmas: (4,) of the constant error beforehand, which is also where the wobble begins. correlation_s: over what time
    images err alike together with the poses that come of them, which lean for longer than images do. Where nothing is
    told, the error is 0 with those sigmas.
    """
    news, sigmas = _news(images, correlation_s), np.maximum(sigmas, _EXACT)
    error, wobble = np.zeros(_SIZE), 0.5 * sigmas * _WOBBLES
    covariance, used = np.diag(sigmas**2), 0
    # of each image; it is looked at where it was: over its own error and pose, nothing is straight enough
    off, moved = np.zeros((len(images), _SIZE)), np.zeros((len(images), 3))
    for count in range(_ROUNDS):
        spread = covariance + np.diag(wobble**2)
        told = []
        for i, (image, known) in enumerate(zip(images, _DOUBT * covariances, strict=True)):
            so_far = MountCorrection(*(error + off[i]).tolist())
            pose, mount = se2.retract(poses[i], moved[i]), so_far.applied(image.mount)
            rows = rows_of(View(image, mount, spread, pose, known, so_far.camera(camera), field))
            if len(rows.residual):
                back = rows.by_mount @ off[i] + rows.by_pose @ moved[i]
                told.append((replace(rows, residual=rows.residual + back), known, float(news[i]), i))
        used = len(told)
        if not used:
            break
        before = error
        error, covariance, wobble = _estimated(told, error, sigmas, wobble, off, moved)
        if count and (np.abs(error - before) < _SETTLED * np.sqrt(np.diagonal(covariance))).all():
            break
    return MountFit(error, covariance, wobble, sigmas, used)


def _news(images: Sequence[ImageFeatures], correlation_s: float) -> FloatArray:
    """(n,) share of each image that the one before has not said."""
    stamps_s = np.array([image.stamp_ns for image in images]) * 1e-9
    gaps = np.diff(stamps_s, prepend=-np.inf)
    gaps[gaps < 0.0] = np.inf  # another log begins
    return np.asarray(1.0 / inflation(gaps, correlation_s))


def _estimated(
    told: list[tuple[Rows, FloatArray, float, int]],
    at: FloatArray,
    sigmas: FloatArray,
    wobble: FloatArray,
    off: FloatArray,
    moved: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The constant, its covariance and the wobble after one round; `at`: the constant that the rows are about. What is
    found of each image's own error and pose is written to its row of `off` and `moved`."""
    information: FloatArray = np.diag(1.0 / sigmas**2)
    vector: FloatArray = -at / sigmas**2
    whitened = []
    for rows, known, share, i in told:
        weighed = Weighed.of(rows, known, wobble, share)
        more = weighed.says(rows)
        information, vector = information + more[0], vector + more[1]
        whitened.append((rows, weighed, known, i))
    covariance = np.linalg.inv(information)
    step = covariance @ vector
    squares = PRIOR_IMAGES * (0.5 * sigmas * _WOBBLES) ** 2
    count = float(PRIOR_IMAGES)
    for rows, weighed, known, i in whitened:
        left = weighed.left(step)
        off[i], variance = weighed.wobbled(rows, wobble, left)
        moved[i] = known @ (rows.by_pose.T @ left)
        squares = squares + weighed.weight * (off[i] ** 2 + variance)
        count += weighed.weight
    return at + step, np.asarray(covariance), np.asarray(np.sqrt(squares / count))
