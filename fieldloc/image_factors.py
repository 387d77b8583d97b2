"""The posts and lines of one image to a factor.

Whatever an image shows shares the errors of its camera's height, pan, tilt and roll. So one image gives one factor: of
what its posts say and what its lines say, the more certain.
"""

from collections.abc import Sequence

import numpy as np

from fieldloc.association import Belief, seen_in_robot
from fieldloc.camera import Camera
from fieldloc.choice import choose_constraint, choose_fix
from fieldloc.factors import LandmarkFactor, LineFactor, PoseFactor
from fieldloc.field import FieldMap
from fieldloc.fixes.base import Fix
from fieldloc.fixes.line_poses import constraints_from_lines, poses_from_lines
from fieldloc.fixes.lines import lines_on_the_ground
from fieldloc.fixes.post_feet import PostSights, fix_two_posts_of_image, sight_posts
from fieldloc.identification import identify
from fieldloc.measurements import ImageFeatures, LandmarkScan

_UNSURE_DISTANCE = 0.3  # relative: beyond it a single post's distance is no Gaussian any more


def image_factors(
    features: ImageFeatures, camera: Camera, field: FieldMap, belief: Belief | None
) -> tuple[PoseFactor | LineFactor | LandmarkFactor, ...]:
    """At most one factor; none where the image leaves a doubt which of its solutions is right."""
    ground = lines_on_the_ground(camera, features.mount, features.lines)
    sights = sight_posts(camera, features.mount, features.posts, _radius_m(field))
    scan = _as_scan(features, sights)
    indices = identify(scan, field, belief) if sights.seen else []
    by_posts = _two_posts(features, camera, field, belief, sights, indices)
    by_lines = ground and choose_fix(features.stamp_ns, poses_from_lines(ground, field), belief)
    if fixes := [fix for fix in (by_posts, by_lines) if fix]:
        surest = min(fixes, key=lambda fix: float(np.linalg.det(fix.covariance)))
        return (PoseFactor.from_fix(features.stamp_ns, surest),)
    if belief is None:
        return ()
    line = ground and choose_constraint(features.stamp_ns, constraints_from_lines(ground, field), belief)
    one = line or _one_post(field, scan, indices)
    return (one,) if one else ()


def _two_posts(
    features: ImageFeatures,
    camera: Camera,
    field: FieldMap,
    belief: Belief | None,
    sights: PostSights,
    indices: Sequence[int | None],
) -> Fix | None:
    """From the posts that are known, `indices` being the map's of those in sight."""
    known = [row for row, index in enumerate(indices) if index is not None]
    if len(known) < 2:
        return None
    # the two farthest apart in bearing say most
    bearing = sights.bearing_inverse_range[:, 0]
    pair = sorted(known, key=lambda row: bearing[row])[:: len(known) - 1]
    on_map = [index for row in pair if (index := indices[row]) is not None]
    first, second = (features.posts[sights.seen[row]] for row in pair)
    fixes = fix_two_posts_of_image(
        camera,
        features.mount,
        (first, second),
        field.positions[on_map],
        _radius_m(field),
        field.positions_covariance[on_map],
    )
    return choose_fix(features.stamp_ns, fixes, belief)


def _one_post(field: FieldMap, scan: LandmarkScan, indices: Sequence[int | None]) -> LandmarkFactor | None:
    seen, covariance = seen_in_robot(scan)
    relative = np.sqrt(scan.covariance[:, 0, 0]) / scan.range_bearing[:, 0]
    sure = [row for row, index in enumerate(indices) if index is not None and relative[row] < _UNSURE_DISTANCE]
    if not sure:
        return None
    row = min(sure, key=lambda row: float(relative[row]))
    index = indices[row]
    assert index is not None
    return LandmarkFactor(scan.stamp_ns, field.positions[index], seen[row], covariance[row])


def _as_scan(features: ImageFeatures, sights: PostSights) -> LandmarkScan:
    """The posts as a scanner would see them; that their errors are shared is lost, so it serves to identify only."""
    n = len(sights.seen)
    blocks = sights.range_bearing_covariance.reshape(n, 2, n, 2)[range(n), :, range(n), :]
    labels = tuple(features.posts[index].label for index in sights.seen)
    below_camera = np.array([features.mount.x_m, features.mount.y_m, 0.0])
    return LandmarkScan(features.stamp_ns, labels, sights.range_bearing, blocks, below_camera)


def _radius_m(field: FieldMap) -> float | None:
    """Of the posts, where all have the same, known one."""
    diameters = {mark.diameter_m for mark in field.landmarks}
    diameter_m = diameters.pop() if len(diameters) == 1 else 0.0
    return 0.5 * diameter_m if diameter_m > 0.0 else None
