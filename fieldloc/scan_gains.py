"""How the pose that a scan determines moves with the places of its landmarks: for many scans at once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_mixture import ScanMixture

_NEAREST_M = 1e-6
_RIDGE = 1e-12  # of the information's trace


class Gains(NamedTuple):
    """k sights of landmarks. scans, landmarks: (k,) of which scan, of which of the map's. moves: (k, 3, 2) of the
    robot's tangent, where it was seen from, with the landmark's place, field axes. as_noise: (k,) by how
    much the variances of the place on the map were widened where the scan was read with them, as if they were noise
    that is new each time; 0 where they were left out."""

    scans: IntArray
    landmarks: IntArray
    moves: FloatArray
    as_noise: FloatArray


def gains(mixtures: Sequence[ScanMixture], solutions: Sequence[int], poses: FloatArray) -> Gains:
    """Of scans of one map, each taken for the solution of that id and seen from its pose (s, 3) of the robot, on the
    map's field. Sights are in order."""
    matches = [mixture.matches(solution) for mixture, solution in zip(mixtures, solutions, strict=True)]
    every = np.concatenate(matches)
    scans = np.repeat(np.arange(len(matches)), [len(one) for one in matches])
    seen = np.flatnonzero(every >= 0)
    landmarks, scans = every[seen], scans[seen]
    models = [mixture.model for mixture in mixtures]
    wider = np.stack([model.wider for model in models])[scans, landmarks]
    root = np.sqrt(wider)
    covariance = np.concatenate([model.covariance for model in models])[seen] * root[:, :, None] * root[:, None, :]
    shared = np.concatenate([model.shared_widened for model in models])[seen, 0]
    mounts = np.array([mixture.scan.robot_from_sensor for mixture in mixtures])
    at = se2.compose(poses, mounts)[scans]
    to = models[0].positions[landmarks] - at[:, :2]
    d = np.maximum(np.hypot(to[:, 0], to[:, 1]), _NEAREST_M)
    there = np.arctan2(to[:, 1], to[:, 0])
    by_place = np.stack([np.cos(there), np.sin(there), -np.sin(there) / d, np.cos(there) / d], axis=-1)
    by_place = by_place.reshape(-1, 2, 2)
    by_pose = np.concatenate([-by_place @ se2.rotation(at[:, 2]), np.tile([[0.0], [-1.0]], (len(d), 1, 1))], axis=-1)
    as_noise = wider[:, 0] * np.array([model.survey is not None for model in models])[scans]
    if as_noise.any():
        places = mixtures[0].field_map.positions_covariance[landmarks] * as_noise[:, None, None]
        covariance += by_place @ places @ by_place.swapaxes(-1, -2)
    weighted = np.linalg.inv(covariance) @ np.concatenate([by_pose, by_place], axis=-1)  # (k, 2, 3 + 2)
    information = np.zeros((len(mixtures), 3, 3))
    np.add.at(information, scans, by_pose.swapaxes(-1, -2) @ weighted[..., :3])
    across = by_pose.swapaxes(-1, -2) @ weighted[..., 3:]  # (k, 3, 2)
    # by how much all ranges are too long is an unknown of the scan; how all bearings are turned, the robot's heading
    by_shared = weighted[:, 0] * shared[:, None]
    pulled = np.zeros((len(mixtures), 3))
    np.add.at(pulled, scans, by_shared[:, :3])
    spread = shared**2 * np.linalg.inv(covariance)[:, 0, 0]
    alone = 1.0 + np.bincount(scans, spread, len(mixtures))
    information -= pulled[:, :, None] * pulled[:, None, :] / alone[:, None, None]
    across -= (pulled / alone[:, None])[scans, :, None] * by_shared[:, None, 3:]
    information += _RIDGE * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    moves = se2.adjoint(mounts)[scans] @ -(np.linalg.inv(information)[scans] @ across)
    return Gains(scans, landmarks, moves, as_noise)
