"""The posts and lines of an image as a mixture: all poses from which it can have been taken.

    p(image | pose) = right * sum over readings of p(lines, which they are | pose, mount)
                                    * product over posts of   false_post * u             if it is none of the map's
                                                              (1 - false_post) * post * N  if it is that landmark
                                    * product over landmarks of 1 - post, where one in clear sight is not seen,
                              integrated over the errors of the mount, which all share
                    + (1 - right) * what lines and posts are if none is the map's

The readings are whole poses (of lines; of lines of one direction and posts; of two posts), lines of one direction
alone, and single posts alone whose distance is known to 30 %: farther ones have no circle that were a Gaussian.

Complete up to: so many false lines as `fieldloc.fixes.line_solutions` takes for granted; at most two lines that are all
false where posts alone are right; gates that what is right fails once in ten thousand times; robots on the map or a
metre around it; and readings nowhere a thousandth as likely as that nothing is right.
"""

import math

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.covariance import log_peaks
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_solutions import log_clutter
from fieldloc.fixes.lines import lines_on_the_ground, square_root
from fieldloc.image_anchors import Anchors, joined, nothing
from fieldloc.image_lines import line_anchors
from fieldloc.image_map import ImageMap, image_map
from fieldloc.image_posts import PostsSeen, posts_seen
from fieldloc.image_readings import read
from fieldloc.measurements import ImageFeatures
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import FactorStack, LandmarkStack, LineStack, PoseStack
from fieldloc.visibility import in_clear_sight

_LOG_NEGLIGIBLE = float(np.log(1e-3))  # against the outlier, where a solution is likeliest
_MOST_FALSE_LINES = 2  # beside posts that are right, where lines can be the map's
_UNSURE_DISTANCE = 0.3  # relative: beyond it a single post's distance is no Gaussian any more


def image_mixture(
    features: ImageFeatures, camera: Camera, field: FieldMap, detection: Detection
) -> SolutionMixture | None:
    """None where nothing of use is seen. Symmetric, so closed under the map's symmetries, unless a post has a name.

    ValueError for a post with a foot_px but no foot_covariance_px2.
    """
    if not np.isfinite(features.mount.covariance).all():
        return None
    image_field = image_map(field)
    root = square_root(np.asarray(features.mount.covariance, dtype=np.float64).tobytes())
    posts = posts_seen(features.posts, camera, features.mount, root, field, detection)
    lines = lines_on_the_ground(camera, features.mount, features.lines)
    if lines is None and not len(posts):
        return None
    of_lines, count = (log_clutter(lines), len(lines.families)) if lines is not None else (0.0, 0)
    of_posts = float(posts.log_clutter.sum())
    log_outlier = math.log(detection.nothing_right) + of_lines + of_posts
    # everything else begins with all posts being none of the map's
    base = math.log1p(-detection.nothing_right) + len(posts) * math.log(detection.false_post) + of_posts
    least = log_outlier + _LOG_NEGLIGIBLE
    symmetries = field.symmetries if not posts.labelled else np.zeros((0, 3))
    turn_rad = 2 * np.pi / (1 + len(symmetries))
    parts = line_anchors(lines, field, detection, root, turn_rad) if lines is not None else []
    hopeless = bool(parts) and count > _MOST_FALSE_LINES
    if not hopeless:
        parts.append(nothing(of_lines + count * math.log(detection.false_line)))
    anchors = joined(parts)
    anchors.log_weights[:] += base

    solved = read(anchors, posts, image_field, turn_rad, least)
    poses, log_weights = solved.readings.poses, solved.log_integrals
    if len(poses) and len(image_field.landmarks):
        missed = in_clear_sight(poses, camera, features.mount, image_field.landmarks, detection)
        row, post = (solved.readings.matched >= 0).nonzero()
        missed[row, solved.readings.matched[row, post]] = 0.0
        log_weights = log_weights + np.log1p(-detection.post * missed).sum(axis=1)
    stacks: list[tuple[FactorStack, FloatArray]] = [(PoseStack(poses, solved.covariances), log_weights)]
    (free,) = (anchors.rank == 2).nonzero()
    if len(free):
        stacks.append((_line_stack(anchors, free), anchors.log_weights[free]))
    if len(posts) and not hopeless:
        rings, weights = _rings(posts, image_field)
        weights = weights + anchors.log_weights[-1]
        kept = np.flatnonzero(weights + log_peaks(rings.covariances) > least)
        stacks.append((rings.take(kept), weights[kept]))
    return SolutionMixture(
        features.stamp_ns,
        tuple(_turned(stack, weights, symmetries) for stack, weights in stacks if len(weights)),
        log_outlier,
        symmetric=not posts.labelled,
        area_m2=image_field.area_m2,
        by_sight=True,
    )


def _turned(stack: FactorStack, log_weights: FloatArray, symmetries: FloatArray) -> tuple[FactorStack, FloatArray]:
    """With copies under the map's symmetries, of equal weights to the last digit, as nothing is worked out twice.
    Landmarks have theirs on the map."""
    count = 1 + len(symmetries)
    match stack:
        case PoseStack():
            poses = [stack.poses, *(se2.compose(turn, stack.poses) for turn in symmetries)]
            copies: FactorStack = PoseStack(np.concatenate(poses), np.concatenate([stack.covariances] * count))
        case LineStack():
            turns = np.concatenate([np.zeros((1, 3)), symmetries])
            normal = stack.normal_rad + turns[:, 2:]
            c, s = np.cos(normal), np.sin(normal)
            x, y = turns[:, :1], turns[:, 1:2]
            copies = LineStack(
                se2.wrap(stack.heading_rad + turns[:, 2:]).ravel(),
                se2.wrap(normal).ravel(),
                (stack.offset_m + c * x + s * y).ravel(),
                (stack.along_m + (c * y - s * x)[..., None]).reshape(-1, 2),
                np.concatenate([stack.covariances] * count),
            )
        case _:
            return stack, log_weights
    return copies, np.concatenate([log_weights] * count)


def _line_stack(anchors: Anchors, rows: IntArray) -> LineStack:
    free = anchors.free[rows]
    normal = np.stack([free[:, 1], -free[:, 0]], axis=-1)
    return LineStack(
        anchors.poses[rows, 2],
        np.arctan2(normal[:, 1], normal[:, 0]),
        np.sum(normal * anchors.poses[rows, :2], axis=-1),
        anchors.along_m[rows],
        anchors.covariances[rows, :2, :2],
    )


def _rings(posts: PostsSeen, field: ImageMap) -> tuple[LandmarkStack, FloatArray]:
    """Posts of a sure enough distance as each landmark they can be, and log weights beside that no line and no other
    post is the map's."""
    bearing, inverse = posts.fused[:, 0], posts.fused[:, 1]
    sure = np.sqrt(posts.fused_covariance[:, 1, 1]) < _UNSURE_DISTANCE * inverse
    row, mark = np.nonzero(posts.allowed & sure[:, None])
    distance = 1.0 / np.where(sure, inverse, 1.0)
    c, s = np.cos(bearing), np.sin(bearing)
    seen = posts.below_camera + distance[:, None] * np.stack([c, s], axis=-1)
    slope = np.empty((len(posts), 2, 2))
    slope[:, 0, 0], slope[:, 0, 1] = -s * distance, -c * distance**2
    slope[:, 1, 0], slope[:, 1, 1] = c * distance, -s * distance**2
    covariances = slope @ posts.fused_covariance @ np.swapaxes(slope, -1, -2)
    # from a density of bearing and inverse distance to one of the place
    log_weights = posts.log_fused + 3.0 * np.log(distance)
    return LandmarkStack(field.landmarks[mark], seen[row], covariances[row]), log_weights[row]
