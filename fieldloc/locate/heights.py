"""How high the camera may be, and how far what stands is, from the sizes of things seen."""

import numpy as np

from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.locate.states import cross, rotations
from fieldloc.pose import FloatArray

_SCALES = (1.0, 0.8, 1.25, 1.55, 0.65)  # of a height that only widths tell, which glare and blur change
_OFF = 1.7  # standard deviations: a height between these is within one of the next
_COARSE = 0.025  # of a height: a prior that leaves less open is one height
_LIKELY = (0.3, 0.5, 0.8, 1.3)  # where nothing tells


def heights(sight: Sight, shape: Shape, prior: CameraPrior, angles: FloatArray) -> list[float]:
    """Heights at which sizes seen are those of the map; the prior's own where that is sharp."""
    mean, sigma = float(prior.mean[0]), float(prior.sigmas[0])
    known = [mean] if prior.knows_height else []
    turned = rotations(np.array([[0.0, 0.0, angles[0], 1.0, angles[1], angles[2]]]))[0]
    circle = circle_on_ground(sight, turned)
    if circle is not None and len(shape.circles):
        known.append(float(shape.circles[0, 2]) / float(circle[2]))
    elif not known:
        rough = _rough_height(sight, shape, turned)
        known = [rough * scale for scale in _SCALES] if rough else list(_LIKELY)
    if prior.knows_height and sigma > _COARSE * mean:
        known += [mean - _OFF * sigma, mean + _OFF * sigma]
    low, high = mean - 4.0 * sigma, mean + 4.0 * sigma
    out: list[float] = []
    for height in known:
        if max(low, 0.1) <= height <= high and all(abs(height - other) > 0.03 * height for other in out):
            out.append(height)
    return out


def _rough_height(sight: Sight, shape: Shape, turned: FloatArray) -> float | None:
    """From lines' widths and posts' widths beside their feet."""
    found = []
    rays, across = sight.line_rays @ turned.T, sight.line_across @ turned.T
    for line in range(len(rays)):
        for end in (0, 1):
            width, down = sight.widths[line, end], -rays[line, end, 2]
            if not np.isfinite(width) or down < 0.05 or width < 2.5:
                continue
            # a pixel across is so much of the ground, in heights: the part of it that is across the line's direction
            direction = cross(cross(rays[line, 0], rays[line, 1]), np.array([0.0, 0.0, 1.0]))[:2]
            length = float(np.hypot(*direction))
            moved = across[line, end, :2] / down + rays[line, end, :2] * across[line, end, 2] / down**2
            step = abs(direction[0] * moved[1] - direction[1] * moved[0]) / max(length, 1e-9)
            found.append(shape.line_width_m / max(width * step, 1e-9))
    feet = sight.feet.rays @ turned.T
    ranges = post_ranges(sight, shape)
    for post in np.flatnonzero(sight.feet.known):
        if feet[post, 2] < -0.02 and np.isfinite(ranges[post]):
            found.append(-feet[post, 2] / float(np.hypot(*feet[post, :2])) * ranges[post])
    return float(np.median(found)) if found else None


def post_ranges(sight: Sight, shape: Shape) -> FloatArray:
    """(p,) level distance from the width: the angle between the edges' planes, both upright."""
    if not len(shape.radii):
        return np.full(len(sight.post_rows), np.nan)
    left = cross(sight.post_rays[:, 0], sight.post_rays[:, 1])
    right = cross(sight.post_rays[:, 2], sight.post_rays[:, 3])
    sine = np.linalg.norm(cross(left, right), axis=-1)
    sine = sine / np.maximum(np.linalg.norm(left, axis=-1) * np.linalg.norm(right, axis=-1), 1e-12)
    # parallel edges, as noise leaves them, are told apart by their middles
    middles = sight.post_rays.reshape(-1, 2, 2, 3).mean(axis=2)
    middles = middles / np.linalg.norm(middles, axis=-1, keepdims=True)
    wide = np.linalg.norm(middles[:, 0] - middles[:, 1], axis=-1)
    width = np.where((sine > 0.5 * wide) & (sine < 2.0 * wide), sine, wide)
    return np.asarray(float(np.mean(shape.radii)) / np.maximum(np.sin(0.5 * width), 1e-6))


def circle_on_ground(sight: Sight, turned: FloatArray) -> FloatArray | None:
    """Middle and radius (3,) of the circle on the ground, in heights."""
    if not len(sight.circle_rays):
        return None
    rays = sight.circle_rays @ turned.T
    rays = rays[rays[:, 2] < -0.02]
    if len(rays) < 5:
        return None
    x, y = (rays[:, :2] / -rays[:, 2:]).T
    weight = rays[:, 2] ** 2  # far points are blurred along the line of sight
    design = np.column_stack([x, y, np.ones_like(x)]) * weight[:, None]
    solved, _, rank, _ = np.linalg.lstsq(design, (x * x + y * y) * weight, rcond=None)
    radius2 = solved[2] + 0.25 * (solved[0] ** 2 + solved[1] ** 2)
    if rank < 3 or radius2 <= 0.0:
        return None
    return np.array([0.5 * solved[0], 0.5 * solved[1], np.sqrt(radius2)])
