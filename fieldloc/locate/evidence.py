"""How likely a pose is beside what fits: what should be seen from there, and is not."""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.lens import Mask
from fieldloc.locate.cameras import Cameras
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
_NOWHERE_PX = -1e6


def log_missed(cameras: Cameras, sight: Sight, shape: Shape, matches: Matches, settings: LocateSettings) -> FloatArray:
    """(k,) log probability that all of the map's things in sight that match nothing were overlooked, and as much of its
    lines as is in sight beside what was found of them: a corner and a crossing differ in that."""
    out = np.zeros(len(cameras.states))
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None] * shape.lengths[:, None, None]
    angle = np.linspace(0.0, 2.0 * np.pi, _SAMPLES, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lines = shape.starts[:, None] + share * shape.directions[:, None]
    circles = shape.circles[:, None, :2] + shape.circles[:, None, 2:] * rim
    counts = np.cumsum([lines.size // 2, circles.size // 2])
    points = np.concatenate([lines.reshape(-1, 2), circles.reshape(-1, 2), shape.posts])
    all_pixels, all_scale, all_visible = _projected(cameras, sight, points)
    pixels, scale = np.split(all_pixels, counts, axis=1), np.split(all_scale, counts, axis=1)
    visible = np.split(all_visible, counts, axis=1)
    if len(shape.starts):
        size = (len(out), len(shape.starts), _SAMPLES)
        seen, wide = visible[0].reshape(size), scale[0].reshape(size)
        steps = np.diff(pixels[0].reshape(*size, 2), axis=2)
        steps = np.sqrt(steps[..., 0] ** 2 + steps[..., 1] ** 2)
        length = np.where(seen[:, :, 1:] & seen[:, :, :-1], steps, 0.0).sum(axis=2)
        width = np.max(np.where(seen, wide, 0.0), axis=2) * shape.line_width_m
        found = sight.line_lengths @ (matches.lines[:, :, None] == np.arange(len(shape.starts)))
        sure = _ramp(length - found, _LONG_PX) * _ramp(width, _WIDE_PX)
        out = out + np.log1p(-settings.seen_line * sure).sum(axis=1)
    if len(shape.circles):
        size = (len(out), len(shape.circles), _SAMPLES)
        seen, wide = visible[1].reshape(size), scale[1].reshape(size)
        width = np.sort(np.where(seen, wide, 0.0), axis=2)[..., _SAMPLES // 2] * shape.line_width_m
        sure = _ramp(seen.mean(axis=2), _SHARE) * _ramp(width, _WIDE_PX)
        found = matches.circle[:, None] == np.arange(len(shape.circles))
        out = out + np.log1p(-settings.seen_circle * np.where(found, 0.0, sure)).sum(axis=1)
    if len(shape.posts):
        far = np.linalg.norm(shape.posts - cameras.centre[:, None, :2], axis=-1)
        wide = 2.0 * shape.radii * sight.focal_px / np.maximum(far, 0.1)
        sure = np.where(visible[2], _ramp(wide, _POST_PX), 0.0)
        found = (matches.posts[:, :, None] == np.arange(len(shape.posts))).any(axis=1)
        out = out + np.log1p(-settings.seen_post * np.where(found, 0.0, sure)).sum(axis=1)
    return np.asarray(out)


def _projected(cameras: Cameras, sight: Sight, points: FloatArray) -> tuple[FloatArray, FloatArray, Mask]:
    """Of ground points (n, 2): pixels (k, n, 2), pixels per metre in depth (k, n), whether well in the picture."""
    away = np.empty((len(cameras.states), len(points), 3))
    away[..., :2] = points - cameras.centre[:, None, :2]
    away[..., 2] = -cameras.centre[:, 2:]
    camera = sight.camera
    pixels = _pixels(camera, away @ cameras.rotation)
    u, v = pixels[..., 0], pixels[..., 1]
    visible = (u > _MARGIN_PX) & (u < camera.width_px - _MARGIN_PX)
    visible &= (v > _MARGIN_PX) & (v < camera.height_px - _MARGIN_PX)
    far2 = np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2 + away[..., 2] ** 2, 0.01)
    return pixels, sight.focal_px * cameras.centre[:, 2:] / far2, visible


def _pixels(camera: Camera, rays: FloatArray) -> FloatArray:
    """Of rays (..., 3); far beside the picture where there are none."""
    if camera.model == "pinhole" and not any(camera.distortion):
        ahead = rays[..., 2] > 1e-6
        scale = np.array([camera.fx_px, camera.fy_px]) / np.where(ahead, rays[..., 2], 1.0)[..., None]
        pixels = rays[..., :2] * scale + np.array([camera.cx_px, camera.cy_px])
        return np.where(ahead[..., None], pixels, _NOWHERE_PX)
    return np.nan_to_num(camera.project(rays)[0], nan=_NOWHERE_PX)


def _ramp(value: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """0 below the first, 1 above the second, straight between."""
    return np.clip((value - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)
