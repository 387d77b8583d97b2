"""Short simulated games in memory, with the truth beside them, in which the place has to be found."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from fieldloc.field import FieldMap, load_field
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, Measurement, Odometry
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.regions import Region, anywhere, draw, region
from logs.recording import Recording
from logs.simulate import Scenario, load_scenario
from logs.simulate.course import Course
from logs.simulate.game import BEGIN_NS, play
from logs.simulate.settings import CompassSettings, FallSettings, KidnappingSettings, PenaltySettings, StartSettings
from logs.simulate.topics import messages

_KINDS: tuple[type[Measurement], ...] = (Odometry, InitialPose, Compass, ImageFeatures)
_NOISE_RAD, _BURST_RAD, _BURST_S = np.radians(15.0), np.radians(40.0), 10.0
_KIDNAPPED_AT_S = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class PlayedGame:
    """start: where the robot is told to be. evidence_ns: when it first sees what determines a whole pose, from the
    game's beginning and again after each time that it was carried."""

    seed: int
    recording: Recording
    course: Course
    start: Region
    put_down_ns: tuple[int, ...]
    evidence_ns: tuple[int, ...]


def no_compass(seed: int, duration_s: float) -> PlayedGame:
    """Started anywhere, knowing nothing."""
    return _played(_anywhere(_calm("no-compass", duration_s), seed), seed)


def noisy_compass(seed: int, duration_s: float) -> PlayedGame:
    """Started anywhere, with a compass of 15 degrees that is off by 40 for ten seconds in between."""
    scenario = _calm("kidsize-game", duration_s)
    compass = replace(scenario.compass, sigma_rad=_NOISE_RAD, stated_sigma_rad=_NOISE_RAD)
    random = np.random.default_rng([seed, 1])
    begin_ns = BEGIN_NS + int(1e9 * random.uniform(0.0, max(duration_s - _BURST_S, 0.0)))
    off_rad = random.choice([-1.0, 1.0]) * _BURST_RAD

    def disturbed(measurement: Measurement) -> Measurement:
        if isinstance(measurement, Compass) and 0 <= measurement.stamp_ns - begin_ns < _BURST_S * 1e9:
            return replace(measurement, heading_rad=measurement.heading_rad + off_rad)
        return measurement

    return _played(_anywhere(replace(scenario, compass=compass), seed), seed, disturbed)


def poor_compass(seed: int, duration_s: float) -> PlayedGame:
    """Started anywhere, with a compass that knows hardly more than the half."""
    compass = CompassSettings(rate_hz=1.0, sigma_rad=1.0, stated_sigma_rad=1.0)
    return _played(_anywhere(replace(_calm("kidsize-game", duration_s), compass=compass), seed), seed)


def own_half(seed: int, duration_s: float) -> PlayedGame:
    """Started anywhere in the own half, without a compass, told that it is there."""
    scenario = _calm("no-compass", duration_s)
    where = region("own-half", load_field(scenario.field))
    return _played(_started(scenario, where, seed), seed, start=where)


def kidnapped(seed: int, duration_s: float) -> PlayedGame:
    """Found with a compass, and carried elsewhere once."""
    scenario = _calm("kidnapped", duration_s)
    taken = KidnappingSettings(at_s=(min(_KIDNAPPED_AT_S, 0.5 * duration_s),))
    return _played(_anywhere(replace(scenario, kidnappings=taken), seed), seed)


GAMES: Mapping[str, Callable[[int, float], PlayedGame]] = MappingProxyType(
    {
        "no compass": no_compass,
        "noisy compass": noisy_compass,
        "poor compass": poor_compass,
        "own half": own_half,
        "kidnapped": kidnapped,
    }
)


def _calm(name: str, duration_s: float) -> Scenario:
    """The scenario without falls and without anybody who carries the robot."""
    quiet = {"falls": FallSettings(), "kidnappings": KidnappingSettings(), "penalties": PenaltySettings()}
    return replace(load_scenario(name), duration_s=duration_s, **quiet)  # type: ignore[arg-type]  # one each


def _anywhere(scenario: Scenario, seed: int) -> Scenario:
    return _started(scenario, anywhere(load_field(scenario.field)), seed)


def _started(scenario: Scenario, where: Region, seed: int) -> Scenario:
    """Where nobody tells it: what it is to be as sure of as the region has to happen as often."""
    low, high = np.array(load_field(scenario.field).bounds).reshape(2, 2)
    poses = draw(where, 100, np.random.default_rng([seed, 2]))
    pose = poses[((poses[:, :2] > low) & (poses[:, :2] < high)).all(axis=1)][0]
    return replace(scenario, start=StartSettings(pose=tuple(pose.tolist()), told=False))


def _played(
    scenario: Scenario,
    seed: int,
    change: Callable[[Measurement], Measurement] = lambda measurement: measurement,
    start: Region | None = None,
) -> PlayedGame:
    field = load_field(scenario.field)
    game = play(scenario, field, seed)
    measurements = [
        change(message.record)
        for message in messages(game)
        if isinstance(message.record, Odometry | InitialPose | Compass | ImageFeatures)
    ]
    measurements.sort(key=lambda measurement: (measurement.stamp_ns, _KINDS.index(type(measurement))))
    recording = Recording(f"seed {seed}", field, scenario.vision.camera, tuple(measurements))
    put_down_ns = _put_down(game.course)
    return PlayedGame(
        seed, recording, game.course, start or anywhere(field), put_down_ns, _evidence(recording, field, put_down_ns)
    )


def _put_down(course: Course) -> tuple[int, ...]:
    """Nobody falls here, so what does not see is carried."""
    return tuple(course.stamps_ns[1:][np.diff(course.seeing.astype(int)) > 0].tolist())


def _evidence(recording: Recording, field: FieldMap, put_down_ns: tuple[int, ...]) -> tuple[int, ...]:
    builder = MixtureBuilder(field, recording.camera)
    images = [measurement for measurement in recording.measurements if isinstance(measurement, ImageFeatures)]
    out = []
    for since_ns in (0, *put_down_ns):
        for image in images:
            if image.stamp_ns < since_ns:
                continue
            mixture = builder.build(image)
            if mixture is not None and len(mixture.solutions().poses):
                out.append(image.stamp_ns)
                break
    return tuple(out)


def truth_at(game: PlayedGame, stamp_ns: int) -> FloatArray | None:
    """(3,) the robot's pose; None while it is carried."""
    stamps_ns = np.array([stamp_ns])
    if not game.course.seeing[game.course.index_at(stamps_ns)[0]]:
        return None
    return np.asarray(game.course.poses_at(stamps_ns)[0])
