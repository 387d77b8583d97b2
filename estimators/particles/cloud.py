"""The particles themselves, and their moments by cluster."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.particles.clusters import group
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_WIDE_M, _WIDE_RAD = 0.6, 0.4
_TIGHT = 0.15  # metres, radians
_TAIL = 16.0  # four sigmas
_ROOTS = 8


@dataclass(slots=True, eq=False)
class Cloud:
    """poses: (n, 3). offsets_rad: (n,) the compass' offset. weights: (n,). labels: (n,) cluster, from zero.

    sides: (n, c) of a particle, how likely the robot is at its pose (column 0) and at its copies under the map's
    symmetries: the side is marginalised, so that no particle is spent on it and no cloud can die out on one side.
    """

    poses: FloatArray
    offsets_rad: FloatArray
    weights: FloatArray
    sides: FloatArray
    labels: IntArray

    def __len__(self) -> int:
        return len(self.poses)

    def take(self, rows: IntArray, weights: FloatArray) -> "Cloud":
        return Cloud(self.poses[rows], self.offsets_rad[rows], weights, self.sides[rows], self.labels[rows])

    def joined(self, other: "Cloud") -> "Cloud":
        """Of both, clusters counted through."""
        return Cloud(
            np.concatenate([self.poses, other.poses]),
            np.concatenate([self.offsets_rad, other.offsets_rad]),
            np.concatenate([self.weights, other.weights]),
            np.concatenate([self.sides, other.sides]),
            np.concatenate([self.labels, other.labels + 1 + self.labels.max(initial=-1)]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """By cluster: masses (k,), means (k, 4) of pose and offset, covariances (k, 4, 4) in robot axes of the mean."""

    masses: FloatArray
    means: FloatArray
    covariances: FloatArray

    @property
    def best(self) -> int:
        return int(np.argmax(self.masses))

    @property
    def pooled(self) -> FloatArray:
        """(3, 3) covariance of a pose about the mean of its own cluster."""
        if len(self.masses) == 1:
            return self.covariances[0, :3, :3]
        return np.asarray(np.tensordot(self.masses / self.masses.sum(), self.covariances[:, :3, :3], axes=1))


def moments(cloud: Cloud, labels: IntArray, clusters: int) -> Moments:
    """With the cloud's own labels or finer ones. Every cluster needs weight."""
    heading = cloud.poses[:, 2]
    columns = np.column_stack([cloud.poses[:, :2], np.cos(heading), np.sin(heading), cloud.offsets_rad])
    if clusters == 1:
        masses = np.array([cloud.weights.sum()])
        sums = (cloud.weights @ columns)[None] / masses[0]
    else:
        masses = np.bincount(labels, cloud.weights, clusters)
        sums = np.stack([np.bincount(labels, cloud.weights * column, clusters) for column in columns.T], axis=-1)
        sums /= np.maximum(masses, 1e-300)[:, None]
    means = np.stack([sums[:, 0], sums[:, 1], np.arctan2(sums[:, 3], sums[:, 2]), sums[:, 4]], axis=-1)
    around = places(cloud, labels, means)
    if clusters == 1:
        covariances = ((around * cloud.weights[:, None]).T @ around / masses[0])[None]
    else:
        covariances = np.empty((clusters, 4, 4))
        for i in range(4):
            for j in range(i + 1):
                column = np.bincount(labels, cloud.weights * around[:, i] * around[:, j], clusters)
                covariances[:, i, j] = covariances[:, j, i] = column / np.maximum(masses, 1e-300)
    return Moments(masses, means, covariances)


def places(cloud: Cloud, labels: IntArray, means: FloatArray) -> FloatArray:
    """(n, 4) of pose and offset about the mean of the own cluster, in robot axes of the mean."""
    mean = means[0] if len(means) == 1 else means[labels]
    c, s = np.cos(mean[..., 2]), np.sin(mean[..., 2])
    x, y = cloud.poses[:, 0] - mean[..., 0], cloud.poses[:, 1] - mean[..., 1]
    turn = se2.wrap(cloud.poses[:, 2] - mean[..., 2])
    return np.column_stack([c * x + s * y, c * y - s * x, turn, cloud.offsets_rad - mean[..., 3]])


def put(cloud: Cloud, labels: IntArray, means: FloatArray, around: FloatArray) -> None:
    """The inverse of `places`: where particles go that are to be there in their clusters."""
    mean = means[0] if len(means) == 1 else means[labels]
    c, s = np.cos(mean[..., 2]), np.sin(mean[..., 2])
    x, y = around[:, 0], around[:, 1]
    heading = se2.wrap(mean[..., 2] + around[:, 2])
    cloud.poses = np.column_stack([mean[..., 0] + c * x - s * y, mean[..., 1] + s * x + c * y, heading])
    cloud.offsets_rad = mean[..., 3] + around[:, 3]


def regroup(cloud: Cloud) -> tuple[IntArray, IntArray, int]:
    """Labels (n,) of the clusters as they are now; and labels (n,) of parts of them that are small enough to be taken
    for Gaussians, and their number: where a cluster is large or bent, its cells."""
    labels, cell = group(cloud.poses, cloud.weights)
    clusters = int(labels.max(initial=0)) + 1
    whole = moments(cloud, labels, clusters)
    if clusters > 1 and (to := _stragglers(whole)) is not None:
        _, to = np.unique(to, return_inverse=True)
        labels, clusters = to.reshape(-1).astype(np.intp)[labels], int(to.max()) + 1
        whole = moments(cloud, labels, clusters)
    wide = large(whole)
    if not wide.any():
        return labels, labels, clusters
    parts = np.where(wide[labels], clusters + cell, labels)
    found, inverse = np.unique(parts, return_inverse=True)
    return labels, inverse.reshape(-1).astype(np.intp), len(found)


def parts_of(cloud: Cloud, of: Moments) -> tuple[IntArray, Moments]:
    """Labels (n,) of parts that can be taken for Gaussians, and their moments."""
    if len(of.masses) == 1 and not large(of)[0]:
        return cloud.labels, of
    _, parts, number = regroup(cloud)
    return parts, moments(cloud, parts, number)


def tight(of: Moments) -> bool:
    """Whether the first cluster is so narrow that nothing in it could be told apart."""
    return bool((np.diagonal(of.covariances[0])[:3] < _TIGHT**2).all())


def large(of: Moments) -> NDArray[np.bool_]:
    """(k,) which clusters are too wide to be taken for Gaussians."""
    sigma = np.sqrt(np.maximum(np.diagonal(of.covariances, axis1=1, axis2=2), 0.0))
    return np.asarray((sigma[:, :2] > _WIDE_M).any(axis=1) | (sigma[:, 2] > _WIDE_RAD))


def _stragglers(of: Moments) -> IntArray | None:
    """(k,) to which cluster each belongs: itself, or a heavier one whose tail it is. None where all stand alone."""
    clusters = len(of.masses)
    to = np.arange(clusters)
    for root in np.argsort(-of.masses, kind="stable")[:_ROOTS]:
        if to[root] == root:
            apart = se2.between(of.means[root, :3], of.means[:, :3])
            distance = squared_mahalanobis(apart, of.covariances[root, :3, :3] + 1e-9 * np.eye(3))
            to[(distance < _TAIL) & (to == np.arange(clusters)) & (of.masses <= of.masses[root])] = root
    return to if (to != np.arange(clusters)).any() else None
