"""Simulated games of robots whose camera sits askew, and what their logs say of how."""

from dataclasses import replace

import numpy as np

from estimators.config import Config, Graph
from fieldloc.field import load_field
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, Measurement, Odometry
from fieldloc.mount_correction import PARTS, MountCorrection
from logs.calibrating import calibrate_recordings
from logs.recording import Recording
from logs.simulate import load_scenario
from logs.simulate.game import play
from logs.simulate.settings import FallSettings, KidnappingSettings, PenaltySettings
from logs.simulate.topics import messages

_KINDS: tuple[type[Measurement], ...] = (Odometry, InitialPose, Compass, ImageFeatures)


def found_mount(duration_s: float, seed: int, log_focal: float | None = None) -> list[tuple[str, float, float, float]]:
    """Name, error, standard deviation, that of before, for each of PARTS: of a game in which nobody falls.

    The constant errors are as large as the log claims, and change with the gait beside it. log_focal: by how much the
    logarithm of the focal length is larger than the log says; drawn from the prior unless told.
    """
    config = replace(Config(), graph=Graph(engine="chain"))
    if log_focal is None:
        log_focal = config.mount.log_focal_sigma * float(np.random.default_rng(seed).standard_normal())
    quiet = {"falls": FallSettings(), "kidnappings": KidnappingSettings(), "penalties": PenaltySettings()}
    scenario = replace(load_scenario("kidsize-game"), duration_s=duration_s, **quiet)  # type: ignore[arg-type]  # one each
    claimed = scenario.vision.mount
    mount = replace(
        claimed,
        error_height_m=claimed.claimed_height_m,
        error_tilt_rad=claimed.claimed_tilt_rad,
        error_roll_rad=claimed.claimed_roll_rad,
    )
    field = load_field(scenario.field)
    game = play(replace(scenario, vision=replace(scenario.vision, mount=mount)), field, seed)
    measurements: list[Measurement] = [
        message.record
        for message in messages(game)
        if isinstance(message.record, Odometry | InitialPose | Compass | ImageFeatures)
    ]
    measurements.sort(key=lambda measurement: (measurement.stamp_ns, _KINDS.index(type(measurement))))
    camera = MountCorrection(log_focal=-log_focal).camera(scenario.vision.camera)
    robot = calibrate_recordings([Recording(f"seed {seed}", field, camera, tuple(measurements))], config)
    by_name = {quantity.name: quantity for quantity in robot.mount}
    true = {part: float(game.camera.truth.get(f"mount_error_{part}", log_focal)) for part in PARTS}
    return [
        (f"camera {name}", found.value - true[name], found.sigma, found.prior_sigma)
        for name, found in ((part, by_name[part]) for part in PARTS)
    ]
