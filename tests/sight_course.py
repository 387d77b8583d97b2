"""Courses for a simulated camera: a robot that stands or turns on the spot, alone or among others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import ImageFeatures
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS, Course
from logs.simulate.sight import SimulatedCamera
from logs.simulate.vision_settings import HeadSettings, VisionSettings, ideal_vision

START_NS = 1_700_000_000_000_000_000
SWEEP = HeadSettings(ball_every_s=0.0, joint_noise_rad=0.0, backlash_rad=0.0)
LEVEL = replace(SWEEP, sweep_pan_rad=0.0, far_tilt_rad=0.0, near_tilt_rad=0.0)
DOWN = replace(LEVEL, far_tilt_rad=0.3, near_tilt_rad=0.3)
POST_ONLY = FieldMap(
    "post", np.zeros((0, 2, 2)), np.zeros((0, 3)), (Landmark("post", np.zeros(2), 0.1, np.eye(2) * 0),)
)
LINE_ONLY = FieldMap("line", np.array([[[0.0, -3.0], [0.0, 3.0]]]), np.zeros((0, 3)), ())


def standing(
    pose: FloatArray | Sequence[float],
    seconds: float = 10.0,
    *,
    turn_radps: float = 0.0,
    steps_hz: float = 0.0,
    others: Sequence[Sequence[float]] = (),
) -> Course:
    """At a pose, turning on the spot, stepping so often a second (0: not at all); other robots stand where told."""
    count = round(seconds * 100) + 1
    since_s = np.arange(count) * SAMPLE_NS * 1e-9
    poses = np.tile(np.asarray(pose, dtype=np.float64), (count, 1))
    poses[:, 2] = se2.wrap(poses[:, 2] + turn_radps * since_s)
    return Course(
        stamps_ns=START_NS + SAMPLE_NS * np.arange(count),
        poses=poses,
        velocities=np.tile([0.0, 0.0, turn_radps], (count, 1)),
        gait_phase_rad=np.pi * steps_hz * since_s,
        walking=np.full(count, steps_hz > 0.0),
        upright=np.ones(count, dtype=np.bool_),
        seeing=np.ones(count, dtype=np.bool_),
        others=np.tile(np.asarray(others, dtype=np.float64).reshape(1, -1, 2), (count, 1, 1)),
    )


def ideal(head: HeadSettings = DOWN) -> VisionSettings:
    """No errors, and a head that moves as told."""
    return ideal_vision(replace(VisionSettings(), head=head))


def see(course: Course, field: FieldMap, settings: VisionSettings, seed: int = 1) -> list[ImageFeatures]:
    """The images of a camera drawn with the seed."""
    return [image for _, image in SimulatedCamera(settings, np.random.default_rng(seed)).images(course, field)]
