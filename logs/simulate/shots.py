"""When the camera of a game takes pictures, from where in truth, and from where as the robot believes.

All that a picture depends on before anything is seen in it: a renderer starts from here too.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS, Course
from logs.simulate.head import HeadMotion, head_motion
from logs.simulate.mounts import Mounts, head_mounts
from logs.simulate.vision_settings import MountSettings, TimingSettings, VisionSettings

_MOST_JITTER = 0.4  # in periods: stamps stay in order
_FADE_SAMPLES = 30  # over which the sway begins and ends with the walking
_NO_COVARIANCE = np.zeros((4, 4))


class Shot(NamedTuple):
    """One picture: its stamp, and where robot (3,) and camera truly were when it was taken."""

    stamp_ns: int
    pose: FloatArray
    mount: CameraMount


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """The n pictures of a game in the order of their stamps.

    taken_ns, stamps_ns, log_times_ns: (n,). poses: (n, 3) field_from_robot when taken. real, believed: the camera's
    mounts. turning_radps: (n,) how fast the view turned. others: (n, k, 2) the other robots, NaN where there is none.
    """

    taken_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    log_times_ns: NDArray[np.int64]
    poses: FloatArray
    real: Mounts
    believed: Mounts
    turning_radps: FloatArray
    others: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def shot(self, index: int) -> Shot:
        """One of them; the true mount has no covariance (zeros)."""
        return Shot(int(self.stamps_ns[index]), self.poses[index], self.real.mount(index, _NO_COVARIANCE))


def take_shots(course: Course, settings: VisionSettings, mount_error: FloatArray, random: np.random.Generator) -> Shots:
    """mount_error: (4,) of height, pan, tilt and roll by which the real camera is off all game long.

    The robot reads its joints and its attitude when the stamp says that the picture was taken, not when it was.
    """
    head = head_motion(course, settings.head, random)
    taken_ns, stamps_ns, log_times_ns = _times(course, settings.timing, random)
    trunk, lift = _sway(course, settings.mount)
    real_trunk = _at(taken_ns, course, trunk)
    real = head_mounts(settings.head, _at(taken_ns, course, head.links_rad), real_trunk, _at(taken_ns, course, lift))
    noise = random.standard_normal((2, len(taken_ns), 2))
    joints = _at(stamps_ns, course, head.sensors_rad) + settings.head.joint_noise_rad * noise[0]
    attitude = settings.mount.imu_share * _at(stamps_ns, course, trunk) + settings.mount.imu_noise_rad * noise[1]
    believed = head_mounts(settings.head, joints, attitude, np.zeros(len(taken_ns)))
    sample = course.index_at(taken_ns)
    turning = _turning(course, head, trunk)[sample]
    return Shots(
        taken_ns,
        stamps_ns,
        log_times_ns,
        course.poses_at(taken_ns),
        real.off_by(mount_error),
        believed,
        turning,
        course.others[sample],
    )


def _times(
    course: Course, timing: TimingSettings, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """When pictures are taken, stamped and logged, those left out that are dropped or of no use."""
    first, last = int(course.stamps_ns[0]), int(course.stamps_ns[-1])
    period_s = 1.0 / timing.images_hz
    length_s = (last - first) * 1e-9
    count = int(length_s * timing.images_hz) + 1
    seconds = (np.arange(count) + random.uniform()) * period_s
    jitter = timing.stamp_jitter_s * random.standard_normal(count)
    jitter = np.clip(jitter, -_MOST_JITTER * period_s, _MOST_JITTER * period_s)
    latency = timing.latency_s + timing.latency_jitter_s * random.uniform(size=count)
    kept = (random.uniform(size=count) >= timing.drop_chance) & (seconds <= length_s)
    for _ in range(random.poisson(timing.outages_per_minute * length_s / 60.0)):
        begin = random.uniform(0.0, length_s)
        kept &= (seconds < begin) | (seconds > begin + random.exponential(timing.outage_s))
    taken_ns = first + np.rint(1e9 * seconds).astype(np.int64)
    stamps_ns = taken_ns + np.rint(1e9 * (timing.stamp_delay_s + jitter)).astype(np.int64)
    # one detector looks at one image after the other
    log_times_ns = np.maximum.accumulate(stamps_ns + np.rint(1e9 * latency).astype(np.int64))
    sample = course.index_at(taken_ns)
    kept &= course.seeing[sample] & course.seeing[np.minimum(sample + 1, len(course.seeing) - 1)]
    return taken_ns[kept], stamps_ns[kept], log_times_ns[kept]


def _sway(course: Course, mount: MountSettings) -> tuple[FloatArray, FloatArray]:
    """The trunk's roll and pitch (n, 2) and its lift (n,) at the course's samples."""
    before = np.concatenate([np.zeros(_FADE_SAMPLES), np.cumsum(course.walking)])
    share = (before[_FADE_SAMPLES:] - before[:-_FADE_SAMPLES]) / _FADE_SAMPLES
    phase = course.gait_phase_rad
    roll = mount.sway_roll_rad * np.sin(phase)
    pitch = mount.sway_pitch_rad * np.sin(2.0 * phase)
    lift = mount.sway_height_m * np.cos(2.0 * phase)
    return share[:, None] * np.column_stack([roll, pitch]), share * lift


def _turning(course: Course, head: HeadMotion, trunk: FloatArray) -> FloatArray:
    """(n,) rad/s: of head, trunk and body together, as the middle of the picture sees it."""
    pan, tilt = head.links_radps.T
    roll, pitch = (np.diff(trunk, axis=0, append=trunk[-1:]) / (SAMPLE_NS * 1e-9)).T
    sideways = (pan + course.velocities[:, 2]) * np.cos(head.links_rad[:, 1])
    return np.asarray(np.sqrt(sideways**2 + (tilt + pitch) ** 2 + roll**2))


def _at(stamps_ns: NDArray[np.int64], course: Course, values: FloatArray) -> FloatArray:
    """Values (n,) or (n, c) of the course's samples at other times (m,), linear in between."""
    first = course.stamps_ns[0]
    seconds, samples = (stamps_ns - first) * 1e-9, (course.stamps_ns - first) * 1e-9
    if values.ndim == 1:
        return np.asarray(np.interp(seconds, samples, values))
    return np.column_stack([np.interp(seconds, samples, column) for column in values.T])
