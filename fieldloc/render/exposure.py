"""From light on the sensor to the numbers of a picture: motion, vignetting, exposure, noise, gamma."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.render.grid import Float32Array
from fieldloc.render.scene import Sensor

UInt8Array = NDArray[np.uint8]
_SHORTEST_PX = 0.05  # of motion that blurs anything


def expose(light: Float32Array, sensor: Sensor, random: np.random.Generator) -> UInt8Array:
    """A picture (h, w, 3) of the light (h, w, 3) that falls on each pixel, 255 being white."""
    seen = _moved(light, sensor.motion_px)
    height, width = seen.shape[:2]
    rows, columns = np.arange(height, dtype=np.float32), np.arange(width, dtype=np.float32)
    gain = np.full(height, sensor.exposure, dtype=np.float32)
    if sensor.rolling > 0.0:
        gain *= 1.0 + sensor.rolling * np.sin(2.0 * np.pi * rows / sensor.rolling_rows + sensor.rolling_phase_rad)
    if sensor.exposure != 1.0 or sensor.rolling > 0.0:
        seen = seen * gain[:, None, None]
    if sensor.vignetting > 0.0:
        across, down = (columns - 0.5 * (width - 1)) / width, (rows - 0.5 * (height - 1)) / height
        square = 2.0 * (across**2 + down[:, None] ** 2)  # 1 in the corners
        seen = seen * (1.0 - np.float32(sensor.vignetting) * square**2).astype(np.float32)[..., None]
    if sensor.read_noise > 0.0 or sensor.shot_noise > 0.0:
        variance = np.float32(sensor.read_noise**2) + np.float32(sensor.shot_noise**2 / 255.0) * np.maximum(seen, 0.0)
        seen = seen + np.sqrt(variance, dtype=np.float32) * random.standard_normal(seen.shape, dtype=np.float32)
    if sensor.gamma != 1.0:
        seen = 255.0 * np.power(np.clip(seen / 255.0, 0.0, 1.0), np.float32(1.0 / sensor.gamma))
    return np.clip(np.rint(seen), 0.0, 255.0).astype(np.uint8)


def _moved(light: Float32Array, motion_px: tuple[float, float]) -> Float32Array:
    """Smeared evenly along the motion, half of it to either side."""
    length = float(np.hypot(*motion_px))
    if length < _SHORTEST_PX:
        return light
    count = max(2, int(np.ceil(2.0 * length)))
    shares = (np.arange(count) + 0.5) / count - 0.5
    taps: dict[tuple[int, int], float] = {}
    for share in shares:
        u, v = share * motion_px[0], share * motion_px[1]
        i, j = int(np.floor(u)), int(np.floor(v))
        for du, across in ((0, 1.0 - (u - i)), (1, u - i)):
            for dv, down in ((0, 1.0 - (v - j)), (1, v - j)):
                taps[i + du, j + dv] = taps.get((i + du, j + dv), 0.0) + across * down / count
    reach = max(max(abs(u), abs(v)) for u, v in taps)
    padded = np.pad(light, [(reach, reach), (reach, reach), (0, 0)], mode="edge")
    height, width = light.shape[:2]
    out = np.zeros_like(light)
    for (u, v), tap in taps.items():
        out += np.float32(tap) * padded[reach - v : reach - v + height, reach - u : reach - u + width]
    return out
