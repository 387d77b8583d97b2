"""The map, ellipses and rays as points and primitives of a Foxglove scene."""

import numpy as np
from foxglove.messages import (
    Color,
    CylinderPrimitive,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    TextPrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.foxglove.topics import STAMPS_NS

WHITE = Color(r=1.0, g=1.0, b=1.0, a=1.0)
GRASS = Color(r=0.13, g=0.40, b=0.20, a=1.0)
POST = Color(r=0.95, g=0.95, b=0.80, a=1.0)
BLUE = Color(r=0.20, g=0.60, b=1.0, a=1.0)
PALE_BLUE = Color(r=0.20, g=0.60, b=1.0, a=0.6)
YELLOW = Color(r=1.0, g=0.85, b=0.10, a=1.0)
RED = Color(r=1.0, g=0.25, b=0.20, a=1.0)

LAST_STAMP_NS = STAMPS_NS[-1]
"""Foxglove's SDK counts seconds in 32 bits: until 2106 by the usual epoch."""

_CIRCLE_SIDES = 96  # of a centre circle: a chord is off by 0.5 mm at 1.5 m
_ELLIPSE_SIDES = 32  # off by 0.5 % of its half axes
_UNIT = np.linspace(0.0, 2 * np.pi, _ELLIPSE_SIDES, endpoint=False)
_UNIT_CIRCLE = np.stack([np.cos(_UNIT), np.sin(_UNIT)])
_FAN_SIDES = 8
_COARSE_BITS = 10
_ROUNDING = 1e-9  # how negative, relatively, a variance may be that should be zero
_POST_HEIGHT_M = 1.0  # maps are flat: KidSize's goals are 1.2 m high, SPL's 0.8 m
_THIN_M = 0.05  # a landmark whose diameter the map does not tell
_GROUND_MARGIN_M = 1.0
_GROUND_HEIGHT_M = -0.02  # under the lines, or both flicker
_LABEL_SIZE_M = 0.2


def timestamp(stamp_ns: int) -> Timestamp:
    """ValueError for what the SDK cannot hold."""
    if not 0 <= stamp_ns <= LAST_STAMP_NS:
        raise ValueError(f"stamp {stamp_ns} ns is outside of what Foxglove's timestamps hold, 0 to {LAST_STAMP_NS}")
    return Timestamp(*divmod(int(stamp_ns), 1_000_000_000))


def flat_pose(x_m: float, y_m: float, heading_rad: float = 0.0, z_m: float = 0.0) -> Pose:
    return Pose(position=Vector3(x=x_m, y=y_m, z=z_m), orientation=about_z(heading_rad))


def about_z(heading_rad: float) -> Quaternion:
    return Quaternion(z=float(np.sin(heading_rad / 2)), w=float(np.cos(heading_rad / 2)))


def points(positions: FloatArray) -> list[Point3]:
    """Of positions (n, 2) on the ground."""
    return [Point3(x=x, y=y) for x, y in positions.tolist()]


def ground(field: FieldMap) -> TriangleListPrimitive:
    """A lawn a metre larger than everything on the map."""
    xmin, ymin, xmax, ymax = field.bounds
    low, high = np.array([xmin, ymin]) - _GROUND_MARGIN_M, np.array([xmax, ymax]) + _GROUND_MARGIN_M
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return _triangles(corners, np.array([[0, 1, 2, 3]]), GRASS, _GROUND_HEIGHT_M)


def white_lines(field: FieldMap) -> list[TriangleListPrimitive]:
    """Lines and circles in their true width; a line reaches half its width beyond its ends, which closes corners."""
    half_m = 0.5 * field.line_width_m
    out = []
    if len(field.lines):
        along = field.lines[:, 1] - field.lines[:, 0]
        along *= half_m / np.linalg.norm(along, axis=-1, keepdims=True)
        left = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        start, end = field.lines[:, 0] - along, field.lines[:, 1] + along
        corners = np.stack([start - left, end - left, end + left, start + left], axis=1)
        out.append(_triangles(corners.reshape(-1, 2), np.arange(4 * len(corners)).reshape(-1, 4), WHITE))
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE_SIDES, endpoint=False)
    spokes = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    here = np.arange(_CIRCLE_SIDES)
    there = np.roll(here, -1)
    ring = np.stack([here, here + _CIRCLE_SIDES, there + _CIRCLE_SIDES, there], axis=-1)
    for *centre, radius in field.circles.tolist():
        edges = [np.array(centre) + max(radius + side, 0.0) * spokes for side in (-half_m, half_m)]
        out.append(_triangles(np.concatenate(edges), ring, WHITE))
    return out


def posts(field: FieldMap) -> list[CylinderPrimitive]:
    """A cylinder on each landmark."""
    return [
        CylinderPrimitive(
            pose=_upright(mark.position, _POST_HEIGHT_M / 2),
            size=Vector3(x=mark.diameter_m or _THIN_M, y=mark.diameter_m or _THIN_M, z=_POST_HEIGHT_M),
            bottom_scale=1.0,
            top_scale=1.0,
            color=POST,
        )
        for mark in field.landmarks
    ]


def labels(field: FieldMap) -> list[TextPrimitive]:
    """The landmarks' names above them."""
    return [
        TextPrimitive(
            pose=_upright(mark.position, _POST_HEIGHT_M + _LABEL_SIZE_M),
            billboard=True,
            font_size=_LABEL_SIZE_M,
            color=WHITE,
            text=mark.label,
        )
        for mark in field.landmarks
    ]


def ellipses(covariances: FloatArray, sigmas: float = 3.0) -> FloatArray:
    """Outlines (n, 32, 2) of the covariances (n, 2, 2) about the origin; NaN where one is no covariance."""
    unknown = np.flatnonzero(~np.isfinite(covariances.reshape(-1, 4)).all(axis=1))
    finite = covariances.copy()
    finite[unknown] = 0.0
    variances, directions = np.linalg.eigh(finite)
    variances[variances[:, 0] < -_ROUNDING * np.abs(variances[:, 1])] = np.nan
    variances[unknown] = np.nan
    half_axes = sigmas * directions * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    return coarse(np.swapaxes(half_axes @ _UNIT_CIRCLE, 1, 2))


def fans(headings_rad: FloatArray, sigmas_rad: FloatArray, length_m: float, sigmas: float = 3.0) -> FloatArray:
    """Outlines (n, 10, 2) about the origin of where the robot may look, at most a whole circle; NaN if that is NaN."""
    half = np.minimum(sigmas * sigmas_rad, np.pi)
    angle = headings_rad[:, None] + half[:, None] * np.linspace(-1.0, 1.0, _FAN_SIDES + 1)
    arc = length_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return coarse(np.concatenate([np.zeros((len(arc), 1, 2)), arc], axis=1))


def coarse(shapes_m: FloatArray) -> FloatArray:
    """Points (n, k, 2) of n shapes on a grid of a millimetre, or of 1/1024 of a smaller shape: nobody sees it, and
    numbers with few digits take a third of the space in a compressed file."""
    _, exponents = np.frexp(np.abs(shapes_m).max(axis=(1, 2), initial=0.0))
    steps = np.ldexp(1.0, np.clip(exponents, -900, 0) - _COARSE_BITS)[:, None, None]
    return np.asarray(np.round(shapes_m / steps) * steps)


def loop(outline: FloatArray, pose: Pose, colour: Color, thickness_m: float) -> LinePrimitive:
    """A closed line through points (n, 2) of the pose's frame."""
    return _line(LinePrimitiveLineType.LineLoop, outline, pose, colour, thickness_m)


def segments(ends: FloatArray, colour: Color, thickness_m: float, z_m: float = 0.0) -> LinePrimitive:
    """Lines between pairs of points (n, 2, 2), on a grid of a millimetre."""
    pose = flat_pose(0.0, 0.0, z_m=z_m)
    on_grid = np.round(ends.reshape(-1, 2) * 2**_COARSE_BITS) / 2**_COARSE_BITS
    return _line(LinePrimitiveLineType.LineList, on_grid, pose, colour, thickness_m)


def _upright(position: FloatArray, z_m: float) -> Pose:
    x, y = position.tolist()
    return flat_pose(x, y, z_m=z_m)


def _line(
    kind: LinePrimitiveLineType, positions: FloatArray, pose: Pose, colour: Color, thickness_m: float
) -> LinePrimitive:
    return LinePrimitive(type=kind, pose=pose, thickness=thickness_m, points=points(positions), color=colour)


def _triangles(corners: FloatArray, quads: NDArray[np.intp], colour: Color, z_m: float = 0.0) -> TriangleListPrimitive:
    """Two triangles for each of the quads (n, 4), counter-clockwise from above, of corners (m, 2)."""
    indices = quads[:, [0, 1, 2, 0, 2, 3]].ravel().tolist()
    return TriangleListPrimitive(
        pose=flat_pose(0.0, 0.0, z_m=z_m), points=points(corners), color=colour, indices=indices
    )
