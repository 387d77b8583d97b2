"""The pose that one assignment of a scan determines, with the errors that its landmarks share.

A turn that all bearings share turns the robot and nothing else; by how much all ranges are too long is an unknown of
the fix itself.
"""

from dataclasses import replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.fixes.landmarks import LandmarkFix, landmark_fix, landmark_misfit
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_model import ScanModel


def scan_fixes(
    model: ScanModel, matches: IntArray, robot_from_sensor: FloatArray, wider: FloatArray | None
) -> tuple[LandmarkFix, ...]:
    """As `landmark_fix`, of the observations (n,) that have a landmark, -1 for those that have none.

    wider: (n, 2) by how much to widen what is each one's own and, if it is not None, what they share with it.
    """
    found = landmark_fix(*_known(model, matches, robot_from_sensor, wider))
    if model.shared is None:
        return found
    turn_rad = (model.shared if wider is None else model.shared_widened)[0, 1]
    by_turn = turn_rad * np.array([robot_from_sensor[1], -robot_from_sensor[0], 1.0])
    return tuple(_turned(fix, se2.rotation3(fix.pose[2]) @ by_turn) for fix in found)


def scan_misfit(model: ScanModel, matches: IntArray, robot_from_sensor: FloatArray, pose: FloatArray) -> float:
    """chi2 as of `scan_fixes`, not widened, of a robot at the pose (3,)."""
    return landmark_misfit(pose, *_known(model, matches, robot_from_sensor, None))


def _known(
    model: ScanModel, matches: IntArray, robot_from_sensor: FloatArray, wider: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None, FloatArray, FloatArray | None]:
    """What `landmark_fix` takes."""
    rows = np.flatnonzero(matches >= 0)
    which, own = matches[rows], model.covariance[rows]
    if wider is not None:
        root = np.sqrt(wider[rows])
        own = own * root[:, :, None] * root[:, None, :]
    shared_range_m = None
    if model.shared is not None:
        shared_range_m = (model.shared if wider is None else model.shared_widened)[rows, 0]
    survey = None if model.survey is None else model.survey[which]
    if survey is not None and wider is not None:
        survey = survey * wider[rows, :1, None]
    return model.positions[which], model.range_bearing[rows], own, survey, robot_from_sensor, shared_range_m


def _turned(fix: LandmarkFix, by_turn: FloatArray) -> LandmarkFix:
    return replace(fix, covariance=fix.covariance + by_turn[:, None] * by_turn)
