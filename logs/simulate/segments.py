"""The straight things on a field that a camera may take for its lines: they themselves, arcs of circles, the carpet's
border."""

from dataclasses import dataclass

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.simulate.vision_settings import LineSettings

_ARCS = 8  # of a circle: each is 12 % of its radius away from the chord's middle at most, a few pixels


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """ends: (n, s, 2, 2) on the ground in the field frame, for each of n images. chances: (s,) by which each is rarer
    than a line."""

    ends: FloatArray
    chances: FloatArray


def segments_of(field: FieldMap, settings: LineSettings, count: int, random: np.random.Generator) -> Segments:
    """For `count` images. A circle is cut into its arcs elsewhere in each image."""
    straight, chances = field.lines, [np.ones(len(field.lines))]
    if settings.border_chance > 0.0:
        straight = np.concatenate([straight, _border(field, settings.border_m)])
        chances.append(np.full(4, settings.border_chance))
    parts = [np.broadcast_to(straight, (count, *straight.shape))]
    if settings.chord_chance > 0.0 and len(field.circles):
        parts.append(_chords(field.circles, random.uniform(size=(count, len(field.circles)))))
        chances.append(np.full(parts[1].shape[1], settings.chord_chance))
    return Segments(np.concatenate(parts, axis=1), np.concatenate(chances))


def _border(field: FieldMap, outside_m: float) -> FloatArray:
    """(4, 2, 2)."""
    xmin, ymin, xmax, ymax = np.array(field.bounds) + outside_m * np.array([-1.0, -1.0, 1.0, 1.0])
    corners = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _chords(circles: FloatArray, shift: FloatArray) -> FloatArray:
    """(n, 8 k, 2, 2) of circles (k, 3) cut at angles shifted by shares (n, k) of an arc."""
    angles = 2.0 * np.pi / _ARCS * (shift[..., None] + np.arange(_ARCS + 1))
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = circles[:, None, :2] + circles[:, None, 2:] * around
    chords = np.stack([points[:, :, :-1], points[:, :, 1:]], axis=-2)
    return chords.reshape(len(shift), -1, 2, 2)
