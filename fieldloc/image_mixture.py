"""The posts and lines of an image as a mixture: all poses from which it can have been taken."""

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_solutions import log_clutter
from fieldloc.fixes.lines import lines_on_the_ground
from fieldloc.image_anchors import Anchors, joined, nothing
from fieldloc.image_lines import line_anchors
from fieldloc.image_posts import PostsSeen, posts_seen
from fieldloc.image_readings import one_turn, read
from fieldloc.measurements import ImageFeatures
from fieldloc.mixture import IntArray, MixtureFactor
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import FactorStack, LandmarkStack, LineStack, PoseStack
from fieldloc.visibility import in_clear_sight

_NEGLIGIBLE = float(np.log(1e-4))  # against the outlier, where a solution is likeliest
_UNSURE_DISTANCE = 0.3  # relative: beyond it a single post's distance is no Gaussian any more
_LOG_2PI = float(np.log(2.0 * np.pi))


def image_mixture(
    features: ImageFeatures, camera: Camera, field: FieldMap, detection: Detection, wider: float
) -> MixtureFactor | None:
    """wider: by how much variances are to be widened, as the image shows much the same as the last one."""
    values, vectors = np.linalg.eigh(features.mount.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    posts = posts_seen(features.posts, camera, features.mount, root, field)
    lines = lines_on_the_ground(camera, features.mount, features.lines)
    if lines is None and not len(posts):
        return None
    symmetries = field.symmetries if not posts.labelled else np.zeros((0, 3))
    turn_rad = 2 * np.pi / (1 + len(symmetries))
    parts, of_lines = [], 0.0
    if lines is not None:
        of_lines = log_clutter(lines)
        found = line_anchors(lines, field, detection, root)
        parts.append(found.take(one_turn(found.poses[:, 2], turn_rad)))
    lone = nothing(of_lines + (len(lines.families) * np.log(detection.clutter) if lines is not None else 0.0))
    anchors = joined([*parts, lone])
    some_right = np.log1p(-detection.nothing_right)
    clutter = np.log(detection.clutter) + posts.log_clutter
    log_outlier = float(np.log(detection.nothing_right) + of_lines + posts.log_clutter.sum())

    solved = read(anchors, posts, field, turn_rad)
    matched = solved.readings.matched >= 0
    seen_right = np.log1p(-detection.clutter) + np.log(detection.post)
    log_weights = solved.log_integrals + some_right + np.where(matched, seen_right, clutter).sum(axis=1)
    near = log_weights + _log_peak(solved.covariances) > log_outlier + _NEGLIGIBLE
    solved, log_weights = solved.take(near), log_weights[near]
    poses = solved.readings.poses
    if len(poses) and field.landmarks:
        missed = in_clear_sight(poses, camera, features.mount, field, detection)
        row, post = np.nonzero(solved.readings.matched >= 0)
        missed[row, solved.readings.matched[row, post]] = 0.0
        log_weights = log_weights + np.log1p(-detection.post * missed).sum(axis=1)
    stacks: list[tuple[FactorStack, FloatArray]] = [(PoseStack(poses, solved.covariances), log_weights)]

    free = np.flatnonzero(~anchors.whole[:-1])
    if len(free):
        stacks.append((_line_stack(anchors, free), anchors.log_weights[free] + some_right + clutter.sum()))
    if len(posts):
        rings, ring_weights = _rings(posts, field)
        others = clutter.sum() - clutter
        row = np.nonzero(posts.allowed)[0]
        sure = _sure(posts)[row]
        weights = ring_weights[row] + others[row] + seen_right + some_right + lone.log_weights[0]
        rows = np.flatnonzero(sure & (weights + _log_peak(rings.covariances) > log_outlier + _NEGLIGIBLE))
        stacks.append((rings.take(rows), weights[rows]))
    area_m2 = float(np.exp(anywhere(field).log_volume)) / (2 * np.pi)
    turned = [(_turned(stack, symmetries), weights) for stack, weights in stacks]
    tempered = [
        (
            _wider(stack, wider),
            _tempered(stack.covariances, np.tile(weights, len(stack.covariances) // max(len(weights), 1)), wider),
        )
        for stack, weights in turned
        if len(weights)
    ]
    return SolutionMixture(
        features.stamp_ns, tuple(tempered), log_outlier / wider, symmetric=not posts.labelled, area_m2=area_m2
    )


def _tempered(covariances: FloatArray, log_weights: FloatArray, wider: float) -> FloatArray:
    """Weights of the wider stack that make its density the one of the narrower to the power of 1 / wider."""
    peak = _log_peak(covariances)
    return np.asarray((log_weights + peak) / wider - (peak - 0.5 * covariances.shape[-1] * np.log(wider)))


def _wider(stack: FactorStack, wider: float) -> FactorStack:
    match stack:
        case PoseStack():
            return PoseStack(stack.poses, wider * stack.covariances)
        case LineStack():
            columns = (stack.heading_rad, stack.normal_rad, stack.offset_m, stack.along_m)
            return LineStack(*columns, wider * stack.covariances)
        case LandmarkStack():
            return LandmarkStack(stack.landmarks, stack.seen, wider * stack.covariances)
    raise TypeError(f"no stack of an image: {stack}")


def _turned(stack: FactorStack, symmetries: FloatArray) -> FactorStack:
    """With copies under the map's symmetries, which are exact as nothing is worked out twice."""
    count = 1 + len(symmetries)
    match stack:
        case PoseStack():
            copies = [stack.poses, *(se2.compose(turn, stack.poses) for turn in symmetries)]
            return PoseStack(np.concatenate(copies), np.tile(stack.covariances, (count, 1, 1)))
        case LineStack():
            turns = np.concatenate([np.zeros((1, 3)), symmetries])
            normal = stack.normal_rad + turns[:, 2:]
            c, s = np.cos(normal), np.sin(normal)
            x, y = turns[:, :1], turns[:, 1:2]
            along = stack.along_m + (-s * x + c * y)[..., None]
            return LineStack(
                se2.wrap(stack.heading_rad + turns[:, 2:]).ravel(),
                se2.wrap(normal).ravel(),
                (stack.offset_m + c * x + s * y).ravel(),
                along.reshape(-1, 2),
                np.tile(stack.covariances, (count, 1, 1)),
            )
    return stack  # landmarks have their copies on the map


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


def _sure(posts: PostsSeen) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    bearing_inverse = posts.fused
    return np.asarray(np.sqrt(posts.fused_covariance[:, 1, 1]) < _UNSURE_DISTANCE * bearing_inverse[:, 1])


def _rings(posts: PostsSeen, field: FieldMap) -> tuple[LandmarkStack, FloatArray]:
    """Each post as each landmark it can be; log densities (p,) of what was seen beside that normal density."""
    row, mark = np.nonzero(posts.allowed)
    bearing, inverse = posts.fused[:, 0], np.maximum(posts.fused[:, 1], 1e-3)
    c, s = np.cos(bearing), np.sin(bearing)
    distance = 1.0 / inverse
    seen = posts.below_camera + distance[:, None] * np.stack([c, s], axis=-1)
    slope = np.empty((len(posts), 2, 2))
    slope[:, 0, 0], slope[:, 0, 1] = -s * distance, -c * distance**2
    slope[:, 1, 0], slope[:, 1, 1] = c * distance, -s * distance**2
    covariances = slope @ posts.fused_covariance @ np.swapaxes(slope, -1, -2)
    weights = posts.log_fused + 3.0 * np.log(distance)
    return LandmarkStack(field.positions[mark], seen[row], covariances[row]), weights


def _log_peak(covariances: FloatArray) -> FloatArray:
    """Log density at zero of normal errors (k, m, m)."""
    return np.asarray(-0.5 * np.linalg.slogdet(2 * np.pi * covariances)[1])
