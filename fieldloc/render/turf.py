"""The ground: floor, carpet with its texture, white lines, marks, and light and shadow on them."""

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.render.canvas import Canvas
from fieldloc.render.flat import Quad, Ring, strip
from fieldloc.render.grid import Float32Array, Indices
from fieldloc.render.scene import Scene, Turf
from fieldloc.render.shapes import Shape

_FARTHEST_M = 200.0  # texture ends there
_OCTAVES = ((0.9, 0.45), (0.25, 0.4), (0.07, 0.5), (0.02, 0.6))  # wavelength in metres, share of the roughness
_TILE = 128  # cells of the texture before it repeats


def paint_ground(canvas: Canvas, scene: Scene, field_map: FieldMap) -> None:
    """Over everything below the horizon; what stands is painted later."""
    turf = scene.turf
    canvas.light[:] = canvas.light_of(scene.ceiling)
    below = np.flatnonzero(canvas.eye.rays[:, 2] < 0.0)
    canvas.light[below] = canvas.light_of(turf.floor)
    carpet, share = canvas.shares(Quad(np.column_stack([_corners(field_map, turf.border_m), np.zeros(4)])))
    colour = canvas.light_of(turf.colour) * _carpet(turf, *_seen_ground(canvas, carpet))
    canvas.light[carpet] += share[:, None].astype(np.float32) * (colour - canvas.light[carpet])
    white = np.zeros(len(canvas.rank), dtype=np.float32)
    for shape in painted_shapes(field_map):
        on_line, share = canvas.shares(shape)
        white[on_line] = np.maximum(white[on_line], share)
    lined = np.flatnonzero(white)
    paint = white[lined]
    if turf.wear > 0.0:
        paint = paint * (1.0 - np.float32(turf.wear) * _worn(turf, *_seen_ground(canvas, lined)))
    canvas.light[lined] += paint[:, None] * (canvas.light_of(turf.lines) - canvas.light[lined])
    if turf.glares:
        _lighten(canvas, turf, below)


def painted_shapes(field_map: FieldMap) -> list[Shape]:
    """Lines, circles and marks. A line reaches half its width beyond the map's end points: so corners are square."""
    width = field_map.line_width_m
    out: list[Shape] = []
    for start, end in field_map.lines:
        beyond = 0.5 * width * (end - start) / np.linalg.norm(end - start)
        out.append(strip(start - beyond, end + beyond, width))
    for x, y, radius in field_map.circles:
        out.append(Ring(np.array([x, y]), radius + 0.5 * width, max(radius - 0.5 * width, 0.0)))
    half = 0.5 * field_map.mark_size_m
    for mark in field_map.marks:
        for arm in (np.array([half, 0.0]), np.array([0.0, half])):
            out.append(strip(mark - arm, mark + arm, min(width, field_map.mark_size_m)))
    return out


def _seen_ground(canvas: Canvas, pixels: Indices) -> tuple[Float32Array, Float32Array]:
    """Points (m, 2) of the ground that pixels show, and how long on it a pixel is (m,), metres."""
    eye = canvas.eye
    rays = eye.rays[pixels]
    down = np.maximum(-rays[:, 2], np.float32(eye.centre[2] / _FARTHEST_M))
    reach = np.float32(eye.centre[2]) / down
    points = eye.centre[:2].astype(np.float32) + reach[:, None] * rays[:, :2]
    footprint = np.float32(0.7 * eye.grid.step_rad) * reach / down
    return points.astype(np.float32), footprint.astype(np.float32)


def _corners(field_map: FieldMap, border_m: float) -> FloatArray:
    xmin, ymin, xmax, ymax = field_map.bounds
    low_x, low_y, high_x, high_y = xmin - border_m, ymin - border_m, xmax + border_m, ymax + border_m
    return np.array([[low_x, low_y], [high_x, low_y], [high_x, high_y], [low_x, high_y]])


def _carpet(turf: Turf, points: Float32Array, footprint: Float32Array) -> Float32Array:
    """Gains (m, 3) on the carpet's colour."""
    gain = np.ones(len(points), dtype=np.float32)
    if turf.mown > 0.0:
        c, s = np.cos(turf.mown_along_rad), np.sin(turf.mown_along_rad)
        phase = np.float32(np.pi / turf.mown_m) * (points @ np.array([c, s], dtype=np.float32))
        edge = np.clip(turf.mown_m / (6.0 * footprint + 1e-6), 0.5, 8.0)  # as sharp as pixels show it
        gain += np.float32(turf.mown) * np.tanh(edge * np.sin(phase)) * _fade(footprint, 2.0 * turf.mown_m)
    out = np.repeat(gain[:, None], 3, axis=1)
    if turf.roughness > 0.0:
        random = np.random.default_rng(turf.seed)
        rough = sum(
            (share * _noise(points / length, random) * _fade(footprint, length) for length, share in _OCTAVES),
            start=np.zeros(len(points), dtype=np.float32),
        )
        out *= np.maximum(1.0 + np.float32(turf.roughness) * rough, 0.2)[:, None]
        tint = _noise(points / 1.7, random) * np.float32(0.3 * turf.roughness)  # yellower and bluer places
        out *= 1.0 + tint[:, None] * np.array([-1.0, 0.0, 1.0], dtype=np.float32)
    return out


def _worn(turf: Turf, points: Float32Array, footprint: Float32Array) -> Float32Array:
    """(m,) between 0 and 1: where the paint is gone."""
    random = np.random.default_rng(turf.seed + 1)
    coarse = _noise(points / 0.4, random)
    fine = _noise(points / 0.03, random) * _fade(footprint, 0.03)
    return np.clip(0.35 + 0.35 * coarse + 0.25 * fine, 0.0, 1.0).astype(np.float32)


def _fade(footprint: Float32Array, length_m: float) -> Float32Array:
    """How much of a pattern of that wavelength is left in the mean over a pixel."""
    left: Float32Array = np.exp(-np.square(2.0 * footprint / np.float32(length_m)), dtype=np.float32)
    return left


def _noise(cells: Float32Array, random: np.random.Generator) -> Float32Array:
    """(m,) smooth noise of variance about 1 at points (m, 2) in cells, the same for the same generator."""
    tile = 1.5 * random.standard_normal((_TILE, _TILE), dtype=np.float32)
    floor = np.floor(cells)
    share = cells - floor
    share = share * share * (3.0 - 2.0 * share)
    i, j = floor.astype(np.int32).T & (_TILE - 1)
    k, m = (i + 1) & (_TILE - 1), (j + 1) & (_TILE - 1)
    x, y = share.T
    first = tile[i, j] + x * (tile[k, j] - tile[i, j])
    second = tile[i, m] + x * (tile[k, m] - tile[i, m])
    return np.asarray(first + y * (second - first), dtype=np.float32)


def _lighten(canvas: Canvas, turf: Turf, below: Indices) -> None:
    points, _ = _seen_ground(canvas, below)
    for glare in turf.glares:
        place = np.array([glare.x_m, glare.y_m], dtype=np.float32)
        square = np.sum(np.square(points - place), axis=-1) / np.float32(glare.radius_m**2)
        near = square < 9.0
        canvas.shade(below[near], np.exp(-square[near]).astype(np.float64), glare.gain)
