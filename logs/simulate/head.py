"""How a soccer robot moves its head: sweeps from side to side, far and near in turn, and looks at the ball."""

from dataclasses import dataclass

import numpy as np

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS, Course
from logs.simulate.vision_settings import HeadSettings

_SOFTEN_S = 0.1  # over which each turn of a joint is rounded off; half of it passes before a joint obeys
_BALL_RANGE_M = (0.3, 2.5)
_BALL_BEARING_RAD = 1.2
_BALL_MPS = 0.3  # standard deviation of the ball's velocity along each axis


@dataclass(frozen=True, slots=True, eq=False)
class HeadMotion:
    """Pan and tilt at a course's samples, (n, 2) each: of the links, and what the joint sensors say but for noise.

    links_radps: (n, 2) until the next sample.
    """

    links_rad: FloatArray
    links_radps: FloatArray
    sensors_rad: FloatArray


def head_motion(course: Course, settings: HeadSettings, random: np.random.Generator) -> HeadMotion:
    """Sweeps, interrupted by looks at a ball that rolls over the field, within the joints' limits and speed."""
    target = _sweep(course, settings, float(random.uniform()))
    _look_at_balls(target, course, settings, random)
    limits = np.array([[-settings.max_pan_rad, settings.min_tilt_rad], [settings.max_pan_rad, settings.max_tilt_rad]])
    step_rad = settings.max_joint_radps * SAMPLE_NS * 1e-9
    obeyed = [_soften(_follow(joint, step_rad)) for joint in np.clip(target, *limits).T]
    links = np.stack(obeyed, axis=-1)
    moved = np.diff(links, axis=0, append=links[-1:])
    return HeadMotion(links, moved / (SAMPLE_NS * 1e-9), links + 0.5 * settings.backlash_rad * _last_direction(moved))


def _sweep(course: Course, settings: HeadSettings, start: float) -> FloatArray:
    """Pan and tilt (n, 2) of the sweep; `start`: the share of its period at which the course begins."""
    seconds = (course.stamps_ns - course.stamps_ns[0]) * 1e-9
    if settings.sweep_pan_rad == 0.0:
        return np.tile([0.0, settings.far_tilt_rad], (len(seconds), 1))
    period_s = 4.0 * settings.sweep_pan_rad / settings.sweep_radps
    phase = (seconds / period_s + start) % 1.0
    leftwards = phase < 0.5
    pan = settings.sweep_pan_rad * np.where(leftwards, 4.0 * phase - 1.0, 3.0 - 4.0 * phase)
    return np.column_stack([pan, np.where(leftwards, settings.far_tilt_rad, settings.near_tilt_rad)])


def _look_at_balls(target: FloatArray, course: Course, settings: HeadSettings, random: np.random.Generator) -> None:
    """Put the ball's direction into the target (n, 2) during each look."""
    if settings.ball_every_s == 0.0 or settings.ball_look_s == 0.0:
        return
    height_m = settings.neck_height_m + settings.camera_above_m
    end_ns = course.stamps_ns[0]
    while True:
        start_ns = end_ns + int(random.exponential(settings.ball_every_s) * 1e9)
        if start_ns >= course.stamps_ns[-1]:
            return
        end_ns = start_ns + int(settings.ball_look_s * 1e9)
        look = slice(*np.searchsorted(course.stamps_ns, [start_ns, end_ns]))
        range_m, bearing = random.uniform(*_BALL_RANGE_M), random.uniform(-_BALL_BEARING_RAD, _BALL_BEARING_RAD)
        in_robot = range_m * np.array([np.cos(bearing), np.sin(bearing)])
        velocity = _BALL_MPS * random.standard_normal(2)
        if look.start == look.stop:
            continue
        seconds = (course.stamps_ns[look] - start_ns) * 1e-9
        on_field = se2.apply(course.poses[look.start], in_robot) + seconds[:, None] * velocity
        x, y = se2.apply(se2.inverse(course.poses[look]), on_field).T
        target[look] = np.column_stack([np.arctan2(y, x), np.arctan2(height_m, np.hypot(x, y))])


def _follow(target: FloatArray, step_rad: float) -> FloatArray:
    """(n,) that goes to the target (n,), no faster than step_rad a sample."""
    wanted = target.tolist()
    at = wanted[0]
    out = []
    for angle in wanted:
        gap = angle - at
        at = angle if -step_rad <= gap <= step_rad else at + step_rad if gap > 0 else at - step_rad
        out.append(at)
    return np.array(out)


def _soften(angle: FloatArray) -> FloatArray:
    """The mean (n,) over the last _SOFTEN_S: no faster, but without jerks."""
    width = round(_SOFTEN_S / (SAMPLE_NS * 1e-9))
    total = np.cumsum(np.concatenate([np.full(width, angle[0]), angle]))
    return np.asarray((total[width:] - total[:-width]) / width)


def _last_direction(moved: FloatArray) -> FloatArray:
    """1, -1 or (before anything moved) 0 for each sample (n, 2): where each joint is going or, at rest, came from."""
    moving = np.abs(moved) > 1e-9  # sums of floats leave about 1e-12
    rows = np.where(moving, np.arange(len(moved))[:, None], 0)
    latest = np.maximum.accumulate(rows, axis=0)
    return np.asarray(np.sign(np.take_along_axis(np.where(moving, moved, 0.0), latest, axis=0)))
