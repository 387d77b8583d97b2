"""What looks like a line and is none: a patch where two lines meet, something upright, a mark.

A field's line ends at another line, at the picture's border or behind something. So what ends on turf at both ends and
is short is a mark, and what goes on, as wide as it is, to where there is no turf on either side stands upright.
"""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenCircle, SeenLine, SeenPost
from fieldloc.vision.lines import LEAST_WIDTHS, least_length
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.profiles import measure
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.stripes import HIGHEST
from fieldloc.vision.turf import Mask, Turf

_COVERED = 0.7  # share of a piece within wider or longer ones
_CIRCLE_PX = 2.5  # between the circle's points, by half
_MARK_WIDTHS, _MARK_LENGTH = 30.0, 0.15  # longer than so many widths or than this of the picture's width is no mark
_STUB_WIDTHS = 3.5  # what is shorter, and neither at another line nor at the picture's border, is a patch
_LIMB_WIDTHS = 8.0  # what is shorter and ends at something that is no turf is a part of that
_LOWEST_PX = 8.0  # of the horizon above the field's border, surely
_LOWEST_WIDTHS = 8.0  # of a line: so far below the horizon is one of 5 cm before a camera 40 cm high
_TAPER = 0.25  # of the logarithm of a width, beyond perspective and three standard deviations
_KNOTS = 3  # crossings of one cord of a net with others
_CROSSED_PX, _CROSSED = 5.0, 0.2  # beside a width, beyond a crossing; sine of the angle there
_CORDS = 0.5  # difference of the logarithms of two cords' widths
_ALONG = np.linspace(0.05, 0.95, 9)[:, None]  # shares of a piece's length at which it is looked at
_BEYOND = np.linspace(0.1, 1.0, 8)  # shares of the way looked at beyond a line's end
_SIDES = np.array([0.0, 1.0, -1.0])[:, None, None, None]  # of a line: on it, and beside it
_STEEP = 0.6  # of a unit along a line, down the picture: what is flatter is not upright
_TURNED = 0.1  # sine of the angle between two lines that meet
_UPRIGHT = 5  # of them with white going on and turf on neither side: upright


def sort_out(
    lines: tuple[SeenLine, ...],
    circle: SeenCircle | None,
    posts: tuple[SeenPost, ...],
    grey: UInt8Array,
    turf: Turf,
    settings: VisionSettings,
) -> tuple[SeenLine, ...]:
    """The lines that are left."""
    if not lines:
        return lines
    ends = np.array([line.ends_px for line in lines])
    width = np.array([line.width_px for line in lines])
    upright, free, blocked = _beyond(ends, width, grey, turf, settings)
    upright |= _on_posts(ends, posts)
    sigma = np.array([line.width_sigma_px for line in lines])
    good = (
        ~_in_net(ends, width)
        & ~_covered(ends, width)
        & ~_on_circle(ends, width, circle)
        & ~upright
        & _tapers_as_turf(ends, width, sigma, turf, grey.shape[0])
    )
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    short = length < np.minimum(_MARK_WIDTHS * width.mean(axis=1), _MARK_LENGTH * grey.shape[1])
    others, at_circle = _near_others(ends, width, circle)
    at_border = _at_border(ends, width, grey)
    # Two that both go out of the picture are longer than they look.
    leaves = np.asarray(at_border.any(axis=1))
    firm = good & (~short | (leaves & leaves[:, None]))
    joined = (others & firm[:, None]).any(axis=2) | at_circle
    met = (others & good[:, None, None] & ~short[:, None, None]).any(axis=(0, 1))  # another one ends at it
    lonely = ~joined.any(axis=1) & ~met
    mark = short & free.all(axis=1) & lonely
    stub = lonely & (length < _STUB_WIDTHS * width.max(axis=1)) & ~at_border.any(axis=1)
    # A wide line that ends at another, or at the picture's border, ends at something white, too.
    blocked &= ~at_border & ~others[:, :, good].any(axis=2) & ~at_circle
    limb = stub | (length < _LIMB_WIDTHS * width.mean(axis=1)) & blocked.any(axis=1) & lonely
    # What is shorter than lines are may be what is seen of one between another and the picture's border.
    cut = length < np.maximum(least_length(grey.shape, settings), LEAST_WIDTHS * width.mean(axis=1))
    piece = cut & ~(leaves & (joined | at_border).all(axis=1))
    return tuple(line for line, keep in zip(lines, good & ~mark & ~limb & ~piece, strict=True) if keep)


def _on_posts(ends: FloatArray, posts: tuple[SeenPost, ...]) -> Mask:
    """(n,) whose ends are both on one post."""
    on = np.zeros(len(ends), dtype=np.bool_)
    for post in posts:
        left, right = post.left_px, post.right_px
        rows = np.clip(ends[..., 1], left[0, 1], left[1, 1])
        first, last = (np.interp(rows, edge[:, 1], edge[:, 0]) for edge in (left, right))
        aside = 0.3 * np.abs(last - first) + 2.0
        there = (ends[..., 0] > first - aside) & (ends[..., 0] < last + aside)
        there &= (ends[..., 1] > left[0, 1] - aside) & (ends[..., 1] < left[1, 1] + 2.0 * aside)
        on |= there.all(axis=1)
    return on


def _in_net(ends: FloatArray, width: FloatArray) -> Mask:
    """(n,) which pieces cross several others about as wide as they are, as cords of a net do: a field's lines end where
    they meet, and those behind a net are wider than its cords or as thin by chance."""
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    turned = along[:, None, 0] * along[:, 1] - along[:, None, 1] * along[:, 0]
    relative = ends[None, :, 0] - ends[:, None, 0]
    turning = np.where(turned == 0.0, 1.0, turned)
    place = (relative[..., 0] * along[:, 1] - relative[..., 1] * along[:, 0]) / turning * length[:, None]
    wide = width.mean(axis=1)
    beyond = (_CROSSED_PX + wide)[:, None]
    alike = np.abs(np.log(wide[:, None] / wide)) < _CORDS
    alike &= np.abs(turned) > _CROSSED * length[:, None] * length
    inside = (place > beyond) & (place < length[:, None] - beyond)
    cords = np.asarray(np.count_nonzero(inside & inside.T & alike, axis=1) >= _KNOTS)
    if not cords.any():
        return cords
    # a net's own border, too, at which its cords end
    touched = (place > -beyond) & (place < length[:, None] + beyond)
    return np.asarray(cords | (np.count_nonzero((touched & touched.T & alike)[:, cords], axis=1) >= _KNOTS - 1))


def _covered(ends: FloatArray, width: FloatArray) -> Mask:
    """(n,) which pieces are mostly within the white of longer ones."""
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    along = along / length[:, None]
    points = ends[:, :1] + _ALONG * (ends[:, 1:] - ends[:, :1])
    u, v = points[:, :, None, 0] - ends[:, 0, 0], points[:, :, None, 1] - ends[:, 0, 1]
    place = u * along[:, 0] + v * along[:, 1]
    off = np.abs(v * along[:, 0] - u * along[:, 1])
    there = np.minimum(np.maximum(place / length, 0.0), 1.0)
    wide = width[:, 0] + (width[:, 1] - width[:, 0]) * there
    inside = (off < 0.6 * wide + 0.5) & (place > -wide) & (place < length + wide)
    inside &= (length[None, :] > length[:, None])[:, None]
    return np.asarray(inside.any(axis=2).mean(axis=1) >= _COVERED)


def _on_circle(ends: FloatArray, width: FloatArray, circle: SeenCircle | None) -> Mask:
    """(n,) which pieces are mostly within the white of the circle."""
    if circle is None:
        return np.zeros(len(ends), dtype=np.bool_)
    points = ends[:, :1] + _ALONG * (ends[:, 1:] - ends[:, :1])
    away = _to_nearest(points, circle.points_px)
    return np.asarray((away < 0.5 * width.mean(axis=1, keepdims=True) + _CIRCLE_PX).mean(axis=1) >= _COVERED)


def _to_nearest(points: FloatArray, others: FloatArray) -> FloatArray:
    """(n, k) from points (n, k, 2) to the nearest of others (m, 2)."""
    u, v = points[..., None, 0] - others[:, 0], points[..., None, 1] - others[:, 1]
    return np.asarray(np.sqrt((u * u + v * v).min(axis=2)))


def _at_border(ends: FloatArray, width: FloatArray, grey: UInt8Array) -> Mask:
    """(n, 2) which ends are at the picture's border."""
    reach = (width + 4.0)[..., None]
    return np.asarray(((ends < reach) | (ends > np.array(grey.shape[1::-1]) - 1.0 - reach)).any(axis=2))


def _tapers_as_turf(ends: FloatArray, width: FloatArray, sigma: FloatArray, turf: Turf, height: int) -> Mask:
    """(n,) whose widths at either end are as perspective makes those of a stripe on the ground.

    Along a row, a stripe's width grows as the depth below the horizon; across the stripe, at most as its square. The
    horizon is somewhere above the field's border, and so far above a stripe that the camera is not lower than any. What
    stands upright is as wide above as below.
    """
    below = np.maximum(turf.below_px(ends), 0.0)
    wide = np.maximum(width, 0.3)
    grows = np.log(wide[:, 1] / wide[:, 0])
    noise = np.hypot(*(sigma / wide).T)
    deep = below + HIGHEST * height
    least = np.log(deep[:, 1] / deep[:, 0])
    down = ends[:, 1, 1] - ends[:, 0, 1]
    far = np.where(down > 0.0, 0, 1)
    row = np.arange(len(ends))
    # green things behind the field make its border seem higher
    near = np.minimum(below[row, far], _LOWEST_WIDTHS * wide[row, far]) + _LOWEST_PX
    most = 2.0 * np.log1p(np.abs(down) / near)
    along = np.abs(ends[:, 1] - ends[:, 0])
    steep = along[:, 1] > _STEEP * np.hypot(along[:, 0], along[:, 1])
    upright = steep & (grows * np.sign(least) < 0.5 * np.abs(least) - 3.0 * noise)
    slack = _TAPER + 3.0 * noise
    grows = grows * np.where(down > 0.0, 1.0, -1.0)
    return np.asarray((grows < most + slack) & (grows > -slack) & ~upright)


def _beyond(
    ends: FloatArray, width: FloatArray, grey: UInt8Array, turf: Turf, settings: VisionSettings
) -> tuple[Mask, Mask, Mask]:
    """(n,) which go on beyond an end as something upright does; (n, 2) which ends are followed by turf, and which by
    something else that is in the picture.
    """
    along = ends[:, 1] - ends[:, 0]
    along = along / np.hypot(along[:, :1], along[:, 1:])
    outward = np.stack([-along, along], axis=1)
    away = 2.0 + _BEYOND * np.maximum(10.0, 1.5 * width)[:, :, None]
    points = ends[:, :, None] + away[..., None] * outward[:, :, None]
    normals = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)[:, :, None] + np.zeros_like(points)
    wide = np.broadcast_to(width[:, :, None], points.shape[:3])
    profiles = measure(grey, points.reshape(-1, 2), normals.reshape(-1, 2), wide.ravel())
    on = profiles.good & (profiles.step > 0.6 * settings.least_contrast)
    on = (on & (np.abs(profiles.middle_px) < 0.3 * wide.ravel() + 1.0)).reshape(wide.shape)
    u, v = points[..., 0], points[..., 1]
    aside = _SIDES * (0.5 * wide + 3.0)
    is_turf, one_side, other_side = turf.at_uv(u + aside * normals[..., 0], v + aside * normals[..., 1])
    beside = one_side | other_side
    upright = (np.count_nonzero(on & ~beside, axis=2) >= _UPRIGHT).any(axis=1) & (np.abs(along[:, 1]) > _STEEP)
    there = (u >= 0.0) & (u < grey.shape[1]) & (v >= 0.0) & (v < grey.shape[0])
    free = np.count_nonzero(is_turf & ~on, axis=2) >= _UPRIGHT
    blocked = np.count_nonzero(there & ~is_turf & ~on, axis=2) >= _UPRIGHT
    return upright, free, blocked


def _near_others(ends: FloatArray, width: FloatArray, circle: SeenCircle | None) -> tuple[Mask, Mask]:
    """(n, 2, n) which ends are at which line that goes another way; (n, 2) which are at the circle."""
    reach = 1.5 * width.max(axis=1) + 6.0
    along = ends[:, 1] - ends[:, 0]
    square = (along * along).sum(axis=1)
    u, v = ends[:, :, None, 0] - ends[:, 0, 0], ends[:, :, None, 1] - ends[:, 0, 1]
    share = np.minimum(np.maximum((u * along[:, 0] + v * along[:, 1]) / square, 0.0), 1.0)
    u, v = u - share * along[:, 0], v - share * along[:, 1]
    turned = np.abs(along[:, None, 0] * along[:, 1] - along[:, None, 1] * along[:, 0])
    turned = turned > _TURNED * np.sqrt(square[:, None] * square)
    near = (u * u + v * v < (reach * reach)[:, None, None]) & turned[:, None]
    if circle is None:
        return near, np.zeros(width.shape, dtype=np.bool_)
    return near, _to_nearest(ends, circle.points_px) < reach[:, None]
