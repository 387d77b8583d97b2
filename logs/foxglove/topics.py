"""Where fieldloc's Foxglove messages go, and the frames they speak of. Does not import foxglove.

| topic | schema | what |
|---|---|---|
| /fieldloc/field | foxglove.SceneUpdate | lines, circles, landmarks of the map, once |
| /fieldloc/pose | foxglove.PoseInFrame | each estimate |
| /fieldloc/state | foxglove.Odometry | each estimate with its covariance, in numbers that a plot can show |
| /fieldloc/transforms | foxglove.FrameTransforms | field -> odom -> robot at each estimate |
| /fieldloc/uncertainty | foxglove.SceneUpdate | 3-sigma ellipse and fan of the heading, at most 10 a second |
| /fieldloc/trajectory | foxglove.PosesInFrame | all of the way, thinned |
| /fieldloc/sights | foxglove.SceneUpdate | what was seen, from the estimated pose, at most 10 a second |
| /fieldloc/annotations | foxglove.ImageAnnotations | posts and lines in the image they were seen in |
| /fieldloc/hypotheses | foxglove.PosesInFrame | poses that all could be, the likeliest first |
| /fieldloc/weights | foxglove.SceneUpdate | the same as arrows, the likelier the less transparent |
| /fieldloc/events | foxglove.Log | what befell the hypotheses, in words |
"""

from typing import NamedTuple

PREFIX = "/fieldloc/"
FIELD = "/fieldloc/field"
POSE = "/fieldloc/pose"
STATE = "/fieldloc/state"
TRANSFORMS = "/fieldloc/transforms"
UNCERTAINTY = "/fieldloc/uncertainty"
TRAJECTORY = "/fieldloc/trajectory"
SIGHTS = "/fieldloc/sights"
ANNOTATIONS = "/fieldloc/annotations"
HYPOTHESES = "/fieldloc/hypotheses"
WEIGHTS = "/fieldloc/weights"
EVENTS = "/fieldloc/events"

STAMPS_NS = range(2**32 * 1_000_000_000)
"""The stamps that Foxglove's messages hold."""


class Frames(NamedTuple):
    """Names of the frames. A viewer takes a frame of the same name in other messages for the same one."""

    field: str = "field"
    odom: str = "odom"
    robot: str = "robot"


BESIDE_OTHERS = Frames("field", "fieldloc/odom", "fieldloc/robot")
"""For a file in which someone else's transforms may name an `odom` or a `robot` with another parent."""
