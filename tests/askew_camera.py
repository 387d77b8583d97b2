"""A robot whose camera sits askew, and reports its images as if it knew of nothing."""

from dataclasses import replace

import numpy as np
from image_scene import MOUNT, see

from fieldloc import pose as se2
from fieldloc.field import load_field
from fieldloc.measurements import ImageFeatures
from fieldloc.mount_correction import MountCorrection
from fieldloc.pose import FloatArray

FIELD = load_field("kidsize")
SIGMAS = np.array([0.02, 0.03, 0.03, 0.02])
WOBBLE = np.array([0.004, 0.008, 0.006, 0.0])
KNOWN = np.diag([0.02, 0.02, 0.01]) ** 2


def walk(
    rng: np.random.Generator, error: FloatArray, count: int, sigma_px: float = 0.7, posts_only: bool = False
) -> tuple[list[ImageFeatures], FloatArray]:
    """Images of a camera that is off by `error` all the time and by WOBBLE from image to image, two seconds apart, as
    a robot reports them that knows of neither; poses as they are known."""
    images, poses = [], []
    while len(images) < count:
        pose = np.array([*rng.uniform([-3.5, -2.5], [3.5, 2.5]), rng.uniform(-np.pi, np.pi)])
        off = MountCorrection(*(error + WOBBLE * rng.standard_normal(4)).tolist())
        real = off.applied(replace(MOUNT, covariance=np.zeros((4, 4))))
        seen = see(FIELD, pose, 2_000_000_000 * len(images), rng, sigma_px, real)
        seen = replace(seen, mount=MOUNT, lines=() if posts_only else seen.lines)
        if seen.lines or seen.posts:
            images.append(seen)
            poses.append(se2.retract(pose, np.sqrt(np.diag(KNOWN)) * rng.standard_normal(3)))
    return images, np.array(poses)
