"""The poses that explain a picture as the estimators' mixture."""

import numpy as np

from fieldloc import pose as se2
from fieldloc.covariance import propagate
from fieldloc.field import FieldMap
from fieldloc.locate.hypotheses import Located
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import PoseStack

_LEAST = 1e-12
_LEAST_NONE = 0.01  # one picture is never surer than that


def mixture(
    located: Located, field: FieldMap, stamp_ns: int, mount: CameraMount | None = None
) -> SolutionMixture | None:
    """Of the robot's poses; None where no pose explains the picture.

    mount: where the camera sits on the robot: its x, y and pan, and the variance of the pan, are taken from it; the
    robot is the point below the camera, looking where that looks, if it is not given.
    """
    if not located.hypotheses:
        return None
    poses = np.array([one.pose for one in located.hypotheses])
    covariances = se2.rotate_covariance(np.array([one.covariance for one in located.hypotheses]), -poses[:, 2])
    if mount is not None:
        robot_from_camera = np.array([mount.x_m, mount.y_m, mount.pan_rad])
        covariances = covariances + np.diag([0.0, 0.0, mount.covariance[1, 1]])
        # a tangent at the camera is one at the robot by the adjoint of where the camera is on it
        covariances = propagate(se2.adjoint(robot_from_camera), covariances)
        poses = se2.compose(poses, se2.inverse(robot_from_camera))
    shares = np.maximum(np.array([one.probability for one in located.hypotheses]), _LEAST)
    # log weights are integrals of densities of the picture over all poses (m^2 rad): up to a factor common to all,
    # the share of a hypothesis is its weight times how likely it was to stand just there, which is one over the room
    log_room = anywhere(field).log_volume
    weights: FloatArray = np.log(shares) + log_room
    (x_min, y_min, x_max, y_max) = anywhere(field).boxes[0]
    return SolutionMixture(
        stamp_ns,
        ((PoseStack(poses, covariances), weights),),
        float(np.log(max(located.none, _LEAST_NONE))),
        symmetric=len(field.symmetries) > 0,
        area_m2=float((x_max - x_min) * (y_max - y_min)),
        by_sight=True,
    )
