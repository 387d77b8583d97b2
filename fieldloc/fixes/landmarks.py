"""The pose from two or more identified landmarks, each with range and bearing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fieldloc.fixes.alignment import (
    Equations,
    Sight,
    State,
    Symmetric,
    chi2_each,
    inverse,
    minimise,
    misfit,
    rigid_alignment,
)
from fieldloc.fixes.base import Fix
from fieldloc.fixes.swing import along_heading, robot_pose, second_moment, state_of
from fieldloc.pose import FloatArray

MAX_HEADING_SIGMA_RAD = 0.3  # beyond it no ellipse is honest: samples show errors of many of its sigmas
PROBE_SIGMAS = 2.0
FIRST_ORDER = 0.05  # nonlinearity up to which the first-order covariance is within a few percent
_HEADINGS = 12  # tried for other solutions
_NO_MOUNT = (0.0, 0.0, 0.0)
_UNLIKELY = 30.0  # chi2 above the best one's, where a solution is not worth naming


@dataclass(frozen=True, slots=True)
class LandmarkFix(Fix):
    """A fix that says how far to trust it.

    chi2: the weighted squared residuals, chi-square when all is as modelled, with as many degrees of freedom as there
        are numbers observed beyond the pose's three.
    chi2_each: (n,) by how much chi2 would fall if that landmark were left out: the wrongly identified one stands out.
        Chi-square with the degrees of freedom that one landmark brings; all of chi2 where the others alone do not
        determine the pose.
    nonlinearity: how far chi2 two sigmas away in the pose's least certain direction, to the worse side, is from the 4
        that first order says, relative: 0 is a Gaussian. Landmarks close together leave a banana; the covariance then
        covers it, but from about 0.5 on the observations themselves are the better factors for whoever has a prior.
    """

    chi2: float = 0.0
    chi2_each: FloatArray = field(default_factory=lambda: np.zeros(0))
    nonlinearity: float = 0.0


def landmark_fix(
    positions: FloatArray,
    range_bearing: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
    shared_range_m: FloatArray | None = None,
) -> tuple[LandmarkFix, ...]:
    """All poses of the robot that explain the landmarks, likeliest first: one, or none where they do not determine it.

    Two where the landmarks are so close together in bearing that their order is uncertain: one from either side. None
    where the heading stays uncertain by more than 0.3 rad. The covariance is first-order where the likelihood is near a
    Gaussian, and else the second moment of the arc on which the pose swings with its heading.

    positions: (n, 2) of the landmarks on the map, metres, field frame; positions_covariance: (n, 2, 2) of these.
    range_bearing: (n, 2) metres, radians, as the sensor sees them; covariance: (n, 2, 2) of these, per landmark.
    robot_from_sensor: (3,) where the sensor sits; on the robot's origin when not given.
    shared_range_m: (n,) by how much each range is too long where all of them are together, one standard deviation of
    that, beside what `covariance` says of each by itself.
    Empty for fewer than two landmarks, coincident ones, a range that is not positive, a value that is not finite.
    Raises ValueError for shapes that do not fit and a covariance that is not positive definite.
    """
    middle, sights = _sights(positions, range_bearing, covariance, positions_covariance, shared_range_m)
    if len(sights) < 2:
        return ()
    mount = _NO_MOUNT if robot_from_sensor is None else robot_from_sensor.tolist()
    found = minimise(rigid_alignment(sights), sights)
    first = found and _fix(*found, middle, sights, mount)
    if not found or not first:
        return ()
    if first.nonlinearity < FIRST_ORDER:
        return (first,)
    others = [_fix(*other, middle, sights, mount) for other in _other_minima(*found, sights)]
    fixes = sorted([first, *(fix for fix in others if fix)], key=lambda fix: -fix.log_weight)
    return tuple(fix for fix in fixes if fix.chi2 - fixes[0].chi2 < _UNLIKELY)


def landmark_misfit(
    pose: FloatArray,
    positions: FloatArray,
    range_bearing: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
    shared_range_m: FloatArray | None = None,
) -> float:
    """chi2 as in `landmark_fix`, at a pose (3,) of the robot; infinite for landmarks that have none."""
    middle, sights = _sights(positions, range_bearing, covariance, positions_covariance, shared_range_m)
    x, y, heading = pose.tolist()
    mount = _NO_MOUNT if robot_from_sensor is None else robot_from_sensor.tolist()
    return misfit(state_of((x, y, heading), middle, mount), sights) if sights else math.inf


def _fix(
    state: State, at: Equations, middle: complex, sights: Sequence[Sight], mount: Sequence[float]
) -> LandmarkFix | None:
    """None where the heading stays too uncertain."""
    p = inverse(at.a)
    if p is None or not p[5] < MAX_HEADING_SIGMA_RAD**2:
        return None
    pose, covariance = robot_pose(state, p, middle, mount)
    aside = [state_of(along_heading(pose, covariance, k), middle, mount) for k in (-PROBE_SIGMAS, PROBE_SIGMAS)]
    nonlinearity = max(abs((misfit(side, sights) - at.chi2) / PROBE_SIGMAS**2 - 1.0) for side in aside)
    if nonlinearity >= FIRST_ORDER:
        covariance = second_moment(state, p, pose, middle)
    return LandmarkFix(
        pose=np.array(pose),
        covariance=_matrix(covariance),
        log_weight=-0.5 * (at.chi2 + at.log_det) - len(sights) * math.log(math.tau),
        solver="landmark_fix",
        chi2=at.chi2,
        chi2_each=np.array(chi2_each(state, p, at, sights)),
        nonlinearity=nonlinearity,
    )


def _other_minima(state: State, at: Equations, sights: Sequence[Sight]) -> list[tuple[State, Equations]]:
    """Minima of chi2 at other headings, found from the dips on a ring of headings."""
    ring = [(state[0], state[1], state[2] + i * math.tau / _HEADINGS) for i in range(_HEADINGS)]
    chi2 = [at.chi2] + [misfit(turned, sights) for turned in ring[1:]]
    others: list[tuple[State, Equations]] = []
    for i in range(1, _HEADINGS):
        if chi2[i] < chi2[i - 1] and chi2[i] <= chi2[(i + 1) % _HEADINGS]:
            other = minimise(ring[i], sights)
            known = [state[2], *(turned[2] for turned, _ in others)]
            if other and all(abs(math.remainder(other[0][2] - heading, math.tau)) > 1e-3 for heading in known):
                others.append(other)
    return others


def _sights(
    positions: FloatArray,
    range_bearing: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None,
    shared_range_m: FloatArray | None,
) -> tuple[complex, list[Sight]]:
    """Checked input, and the landmarks' middle; no sights where a value is not finite or a range not positive."""
    n = len(positions)
    if positions.shape != (n, 2) or range_bearing.shape != (n, 2) or covariance.shape != (n, 2, 2):
        raise ValueError(
            f"positions {positions.shape}, range_bearing {range_bearing.shape} and covariance {covariance.shape} "
            "need shapes (n, 2), (n, 2) and (n, 2, 2)"
        )
    if positions_covariance is not None and positions_covariance.shape != (n, 2, 2):
        raise ValueError(f"positions_covariance has shape {positions_covariance.shape}, needs ({n}, 2, 2)")
    if shared_range_m is not None and shared_range_m.shape != (n,):
        raise ValueError(f"shared_range_m has shape {shared_range_m.shape}, needs ({n},)")
    on_map = [[[0.0, 0.0], [0.0, 0.0]]] * n if positions_covariance is None else positions_covariance.tolist()
    together = [0.0] * n if shared_range_m is None else shared_range_m.tolist()
    there = positions.tolist()
    middle_x, middle_y = sum(x for x, _ in there) / max(n, 1), sum(y for _, y in there) / max(n, 1)
    sights = []
    total = 0.0
    for (x, y), ((xx, xy), (_, yy)), (r, b), ((rr, rb), (_, bb)), longer in zip(
        there, on_map, range_bearing.tolist(), covariance.tolist(), together, strict=True
    ):
        if not (rr > 0.0 and rr * bb > rb * rb):
            raise ValueError("covariance of a range and bearing is not positive definite")
        total += x + y + xx + xy + yy + r + b + rr + rb + bb + longer
        if r > 0.0:
            sights.append(Sight(x - middle_x, y - middle_y, xx, xy, yy, r, b, rr, rb, bb, longer))
    if len(sights) < n or not math.isfinite(total):
        return 0j, []
    return complex(middle_x, middle_y), sights


def _matrix(a: Symmetric) -> FloatArray:
    """(3, 3)."""
    return np.array([[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]])
