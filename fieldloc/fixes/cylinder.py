"""How a vertical cylinder looks: the exact bearings of its two edges beside the paper's size f D / C.

The tangents from a point to a circle of radius R at distance C and bearing b leave at b +- asin(R / C). So the mean of
the two edges' bearings is the bearing of the axis, exactly, and half their difference w has sin(w) = R / C, exactly:
sin(w) is the size that is inversely proportional to distance, and the ratio of two posts' sin(w) the exact ratio of
their distances.

The paper's d = f D / C is the image of a flat plate on the optical axis. What a pinhole camera shows is f tan(b + w) -
f tan(b - w) = f sin(2 w) / (cos^2 b - sin^2 w), for a thin far post f D / (C cos^2 b): 33 % too wide 30 degrees off the
axis, so that the ratio of two posts' widths misses the ratio of their distances unless both are equally far off the
axis. On the axis it is f D / sqrt(C^2 - R^2), 0.5 % too wide at ten radii.

Bearings are counter-clockwise from the forward axis, so the left edge has the larger one.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fieldloc.covariance import propagate
from fieldloc.fixes.inputs import exactly, semidefinite, trailing
from fieldloc.fixes.post_fix import PostFix
from fieldloc.fixes.two_posts import fix_two_posts
from fieldloc.pose import FloatArray, wrap

_AXIS_BY_EDGES = np.array([[0.5, 0.5], [0.5, -0.5]])


def edge_bearings(range_bearing: FloatArray, radius_m: FloatArray | float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Bearings (..., 2) of the left and right edge of cylinders at (range to the axis, bearing) (..., 2); mask (...).

    False, and zeros, where the observer is not outside the cylinder or something is not finite.
    """
    distance, bearing = np.moveaxis(trailing(range_bearing, (2,), "range_bearing"), -1, 0)
    half, mask = half_width(distance, radius_m)
    mask = mask & np.isfinite(bearing)
    edges = wrap(np.where(mask, bearing, 0.0)[..., None] + np.where(mask, half, 0.0)[..., None] * np.array([1.0, -1.0]))
    return np.where(mask[..., None], edges, 0.0), mask


def edge_bearings_jacobian(range_bearing: FloatArray, radius_m: FloatArray | float) -> FloatArray:
    """(..., 2, 2): change of (left, right) with (range, bearing); zeros where `edge_bearings` is masked."""
    values = trailing(range_bearing, (2,), "range_bearing")
    _, mask = edge_bearings(values, radius_m)
    slope = half_width_slope(values[..., 0], radius_m)
    rows = np.stack([np.stack([slope, np.ones_like(slope)], -1), np.stack([-slope, np.ones_like(slope)], -1)], -2)
    return np.where(mask[..., None, None], rows, 0.0)


def half_width(range_m: FloatArray, radius_m: FloatArray | float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """asin(R / C) (...) and where there is one: outside of a cylinder that has a radius; zero elsewhere."""
    distance, radius = np.broadcast_arrays(_floats(range_m), _floats(radius_m))
    mask = np.isfinite(distance) & np.isfinite(radius) & (radius > 0) & (distance > radius)
    return np.where(mask, np.arcsin(np.where(mask, radius, 0.0) / np.where(mask, distance, 1.0)), 0.0), mask


def half_width_slope(range_m: FloatArray, radius_m: FloatArray | float) -> FloatArray:
    """dw / dC = -R / (C sqrt(C^2 - R^2)) (...); zero where there is no half-width."""
    distance, radius = np.broadcast_arrays(_floats(range_m), _floats(radius_m))
    _, mask = half_width(distance, radius)
    c, r = np.where(mask, distance, 2.0), np.where(mask, radius, 1.0)
    return np.where(mask, -r / (c * np.sqrt((c - r) * (c + r))), 0.0)


def axis_from_edges(edges_rad: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(bearing of the axis, half-width) (..., 2) from the bearings (..., 2) of the left and right edge; mask (...).

    The Jacobian is [[1/2, 1/2], [1/2, -1/2]] everywhere. No cylinder has its left edge on the right, nor one as wide as
    the horizon; zeros there and for NaN.
    """
    edges = trailing(edges_rad, (2,), "edges_rad")
    finite = np.asarray(np.isfinite(edges).all(-1))
    left, right = np.moveaxis(np.where(finite[..., None], edges, 0.0), -1, 0)
    half = wrap(left - right) / 2
    mask = np.asarray(finite & (half > 0))
    return np.where(mask[..., None], np.stack([wrap(right + half), half], axis=-1), 0.0), mask


def range_bearing_from_edges(
    edges_rad: FloatArray, radius_m: FloatArray | float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """(range to the axis, bearing) (..., 2) of a cylinder of known radius, Jacobian (..., 2, 2) by the edges, mask."""
    axis, mask = axis_from_edges(edges_rad)
    mask = np.asarray(mask & np.isfinite(radius_m) & (_floats(radius_m) > 0))
    bearing, half = axis[..., 0], np.where(mask, axis[..., 1], 1.0)
    distance = np.asarray(np.where(mask, radius_m, 1.0) / np.sin(half))
    by_half = -distance / np.tan(half)
    range_by_edges = by_half[..., None] * _AXIS_BY_EDGES[1]
    jacobian = np.stack([range_by_edges, np.broadcast_to(_AXIS_BY_EDGES[0], range_by_edges.shape)], axis=-2)
    values = np.stack([distance, bearing], axis=-1)
    return np.where(mask[..., None], values, 0.0), np.where(mask[..., None, None], jacobian, 0.0), mask


def two_post_inputs_from_edges(
    edges_rad: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """What `two_posts` takes, from the edges (..., 2 posts, 2) and their covariance (..., 4, 4) of (l1, r1, l2, r2).

    (bearing 1, bearing 2, size 1, size 2) (..., 4) with size = sin(half-width), the covariance (..., 4, 4), mask (...).
    """
    axes, masks = axis_from_edges(trailing(edges_rad, (2, 2), "edges_rad"))
    mask = np.asarray(masks.all(-1))
    inputs = np.concatenate([axes[..., 0], np.sin(axes[..., 1])], axis=-1)
    jacobian = np.zeros((*inputs.shape, 4))
    for post in (0, 1):
        columns = slice(2 * post, 2 * post + 2)
        jacobian[..., post, columns] = _AXIS_BY_EDGES[0]
        jacobian[..., 2 + post, columns] = np.cos(axes[..., post, 1])[..., None] * _AXIS_BY_EDGES[1]
    return np.where(mask[..., None], inputs, 0.0), propagate(jacobian, semidefinite(covariance, 4)), mask


def fix_two_posts_from_edges(
    edges_rad: FloatArray, covariance: FloatArray, posts: FloatArray, posts_covariance: FloatArray | None = None
) -> tuple[PostFix, ...]:
    """The pose from the edges' bearings (2 posts, 2) of two labelled posts of equal diameter, which need not be known.

    covariance: (4, 4) of (left 1, right 1, left 2, right 2), with the correlation that a shared calibration or mount
    error puts there. posts (2, 2), posts_covariance (2, 2, 2) as in `fix_two_posts`.
    """
    edges = exactly(edges_rad, (2, 2), "edges_rad")
    inputs, noise, mask = two_post_inputs_from_edges(edges, exactly(covariance, (4, 4), "covariance"))
    if not mask:
        return ()
    fixes = fix_two_posts(inputs[:2], inputs[2:], noise, posts, posts_covariance)
    return tuple(replace(fix, solver="cylinder.fix_two_posts_from_edges") for fix in fixes)


def paper_size_px(range_m: FloatArray, diameter_m: FloatArray | float, focal_px: float) -> FloatArray:
    """The paper's d = f D / C (...), above eq. 3: exact for no cylinder, close for a thin one on the optical axis."""
    return focal_px * _floats(diameter_m) / _floats(range_m)


def pinhole_edges_px(
    range_bearing: FloatArray, radius_m: FloatArray | float, focal_px: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Columns (..., 2) right of the principal point at which a level pinhole camera shows the left and the right edge.

    Bearings are from the optical axis. Masked, and zero, where an edge is not in front of the camera.
    """
    edges, mask = edge_bearings(range_bearing, radius_m)
    mask = mask & (np.abs(edges) < np.pi / 2).all(-1) & (edges[..., 0] > edges[..., 1])
    return np.where(mask[..., None], -focal_px * np.tan(np.where(mask[..., None], edges, 0.0)), 0.0), mask


def pinhole_width_px(
    range_bearing: FloatArray, radius_m: FloatArray | float, focal_px: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """The exact width (...) in a level pinhole camera, its Jacobian (..., 2) by (range, bearing), and mask (...)."""
    edges_px, mask = pinhole_edges_px(range_bearing, radius_m, focal_px)
    slope = focal_px + edges_px**2 / focal_px  # of f tan(b) at each edge
    by_edges = slope * np.array([1.0, -1.0])
    jacobian = (by_edges[..., None, :] @ edge_bearings_jacobian(range_bearing, radius_m))[..., 0, :]
    width = edges_px[..., 1] - edges_px[..., 0]
    return np.where(mask, width, 0.0), np.where(mask[..., None], jacobian, 0.0), mask


def _floats(values: FloatArray | float) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
