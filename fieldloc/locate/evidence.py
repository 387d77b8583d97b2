"""How likely a pose is beside what fits: what should be seen from there, and is not."""

import numpy as np

from fieldloc.lens import Mask
from fieldloc.locate.errors import Cameras
from fieldloc.locate.matching import Matches
from fieldloc.locate.settings import LocateSettings
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.pose import FloatArray

_SAMPLES = 13
_MARGIN_PX = 10.0
_LONG_PX = (40.0, 120.0)  # from where on a visible line is expected to be found, and where it surely is
_WIDE_PX = (1.5, 4.0)
_POST_PX = (4.0, 10.0)
_SHARE = (0.25, 0.6)  # of a circle


def log_missed(cameras: Cameras, sight: Sight, shape: Shape, matches: Matches, settings: LocateSettings) -> FloatArray:
    """(k,) log probability that all of the map's things in sight that match nothing were overlooked."""
    out = np.zeros(len(cameras.states))
    if len(shape.starts):
        share = np.linspace(0.0, 1.0, _SAMPLES)[:, None] * shape.lengths[:, None, None]
        points = shape.starts[:, None] + share * shape.directions[:, None]
        pixels, scale, visible = _projected(cameras, sight, points)
        steps = np.hypot(*np.moveaxis(np.diff(pixels, axis=2), -1, 0))
        both = visible[:, :, 1:] & visible[:, :, :-1]
        length = np.where(both, steps, 0.0).sum(axis=2)
        # px per metre across a line seen from the side: range is foreshortened by height / range
        width = np.max(np.where(visible, scale, 0.0), axis=2) * shape.line_width_m
        sure = _ramp(length, _LONG_PX) * _ramp(width, _WIDE_PX)
        found = (matches.lines[:, :, None] == np.arange(len(shape.starts))).any(axis=1)
        out = out + np.log1p(-settings.seen_line * np.where(found, 0.0, sure)).sum(axis=1)
    if len(shape.posts):
        _, scale, visible = _projected(cameras, sight, shape.posts[:, None])
        far = np.linalg.norm(shape.posts - cameras.centre[:, None, :2], axis=-1)
        sure = np.where(
            visible[..., 0], _ramp(2.0 * shape.radii * sight.focal_px / np.maximum(far, 0.1), _POST_PX), 0.0
        )
        found = (matches.posts[:, :, None] == np.arange(len(shape.posts))).any(axis=1)
        out = out + np.log1p(-settings.seen_post * np.where(found, 0.0, sure)).sum(axis=1)
    if len(shape.circles):
        angle = np.linspace(0.0, 2.0 * np.pi, _SAMPLES, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points = shape.circles[:, None, :2] + shape.circles[:, None, 2:] * rim
        _, scale, visible = _projected(cameras, sight, points)
        width = np.median(np.where(visible, scale, 0.0), axis=2) * shape.line_width_m
        sure = _ramp(visible.mean(axis=2), _SHARE) * _ramp(width, _WIDE_PX)
        found = matches.circle[:, None] == np.arange(len(shape.circles))
        out = out + np.log1p(-settings.seen_circle * np.where(found, 0.0, sure)).sum(axis=1)
    return np.asarray(out)


def _projected(cameras: Cameras, sight: Sight, points: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    """Of ground points (m, s, 2): pixels (k, m, s, 2), pixels per metre in depth (k, m, s), well in the picture."""
    count = len(cameras.states)
    flat = np.concatenate([points.reshape(-1, 2), np.zeros((points.size // 2, 1))], axis=1)
    away = flat - cameras.centre[:, None]
    pixels, _ = sight.camera.project(away @ cameras.rotation)
    camera = sight.camera
    u, v = pixels[..., 0], pixels[..., 1]
    visible = (u > _MARGIN_PX) & (u < camera.width_px - _MARGIN_PX)
    visible &= (v > _MARGIN_PX) & (v < camera.height_px - _MARGIN_PX)
    far2 = np.maximum(np.sum(away * away, axis=-1), 0.01)
    scale = sight.focal_px * cameras.centre[:, None, 2] / far2
    shape = (count, *points.shape[:-1])
    return np.nan_to_num(pixels).reshape(*shape, 2), scale.reshape(shape), visible.reshape(shape)


def _ramp(value: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """0 below the first, 1 above the second, straight between."""
    return np.clip((value - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
