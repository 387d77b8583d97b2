"""The pose that one assignment of a scan determines, with the errors that its landmarks share."""

from dataclasses import replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.fixes.landmarks import LandmarkFix, landmark_fix
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_model import ScanModel
from fieldloc.scan_quadratics import quadratics

_NOTHING = 1e-3  # sigmas of a range that no fix is made anew for


def scan_fixes(
    model: ScanModel, matches: IntArray, robot_from_sensor: FloatArray, wider: FloatArray | None
) -> tuple[LandmarkFix, ...]:
    """As `landmark_fix`, of the observations (n,) that have a landmark, -1 for those that have none.

    wider: (n, 2) by how much to widen what is each one's own and, if it is not None, what they share with it.

    A turn that all bearings share turns the robot and nothing else. Ranges that are all too long by v standard
    deviations move the fix by first order in v: of pose and v the likeliest are found in turns.
    """
    rows = np.flatnonzero(matches >= 0)
    which = matches[rows]
    own = model.covariance[rows]
    if wider is not None:
        root = np.sqrt(wider[rows])
        own = own * root[:, :, None] * root[:, None, :]
    survey = np.zeros((len(rows), 2, 2)) if model.survey is None else model.survey[which]

    def fixes(range_bearing: FloatArray) -> tuple[LandmarkFix, ...]:
        return landmark_fix(model.positions[which], range_bearing, own, survey, robot_from_sensor)

    found = fixes(model.range_bearing[rows])
    if model.shared is None or len(found) != 1:
        return found
    shared = model.shared if wider is None else model.shared_widened
    covariance, chi2 = found[0].covariance, 0.0
    if (shared[rows, 0] > _NOTHING * np.sqrt(own[:, 0, 0])).any():
        moved = _longer(model, matches, se2.compose(found[0].pose, robot_from_sensor), wider)
        found = fixes(model.range_bearing[rows] - shared[rows] * [moved[0], 0.0])
        if len(found) != 1:
            return found
        chi2 = moved[0] ** 2
        along = se2.rotation3(found[0].pose[2]) @ se2.adjoint(robot_from_sensor) @ moved[2:]
        covariance = found[0].covariance + moved[1] * np.outer(along, along)
    turned = se2.rotation3(found[0].pose[2]) @ se2.adjoint(robot_from_sensor)[:, 2] * shared[0, 1]
    return (replace(found[0], covariance=covariance + np.outer(turned, turned), chi2=found[0].chi2 + chi2),)


def _longer(model: ScanModel, matches: IntArray, at: FloatArray, wider: FloatArray | None) -> FloatArray:
    """(5,) by how much ranges are likeliest too long, its variance, and how the sensor's pose, which is the likeliest
    without it, moves with it (3,)."""
    scan = model if wider is not None else replace(model, wider_shared=np.ones(2))
    whole, _ = quadratics(scan.terms(at[None], matches[None], wider))
    information, gradient = whole.information[0, :4, :4], whole.gradient[0, :4]
    along = -np.linalg.solve(information[:3, :3], information[:3, 3])
    variance = 1.0 / (1.0 + information[3, 3] + information[3, :3] @ along)
    return np.array([variance * (gradient[3] + along @ gradient[:3]), variance, *along])
