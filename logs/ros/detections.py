"""Goal posts and field lines out of the values of soccer_vision_*_msgs and vision_msgs.

The definitions have changed over the years, and a log says which it was recorded with:
soccer_interfaces: the ends of 2D segments were geometry_msgs/Point (x, y, z) up to 0.2 and are vision_msgs/Point2D
since 1.0; a confidence was a number and is a message around one.
vision_msgs: the centre of a 2D box had x and y itself up to 3 and has them in `position` since 4; a hypothesis had
`id` (an integer in ROS 1's first versions) and `score` and has them in `hypothesis` since 3, there `class_id` since 4.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter

import numpy as np

from fieldloc.pose import FloatArray
from logs.foreign.parts import ImageDetectionsPart, Part, SpaceDetectionsPart
from logs.ros.definitions import BadDefinition
from logs.ros.motion import SECOND, stamp
from logs.ros.plan import Plan

Values = list[object]
_NO_NUMBERS = np.empty(0)
_NO_BOXES, _NO_POSTS = np.empty((0, 4)), np.empty((0, 3))
_NO_LINES_2D, _NO_LINES_3D = np.empty((0, 2, 2)), np.empty((0, 2, 3))
for _nothing in (_NO_NUMBERS, _NO_BOXES, _NO_POSTS, _NO_LINES_2D, _NO_LINES_3D):
    _nothing.flags.writeable = False
_POST = "post"  # "goalpost", "goal_post", "Goal Post", "left_post", ...


def goalposts_2d(plan: Plan) -> Callable[[Values], Part]:
    head, rows, posts = _head(plan), _rows(plan, "posts"), plan.rows["posts"]
    box, confidence = _box(posts, "posts.bb"), _confidence(posts, "posts")

    def build(values: Values) -> Part:
        found = rows(values)
        boxes = _array([box(row) for row in found], (4,))
        return ImageDetectionsPart(*head(values), boxes, _array(map(confidence, found)), _NO_LINES_2D, _NO_NUMBERS)

    return build


def goalposts_3d(plan: Plan) -> Callable[[Values], Part]:
    head, rows, posts = _head(plan), _rows(plan, "posts"), plan.rows["posts"]
    centre, confidence = _numbers(posts, "posts.bb.center.position", "xyz"), _confidence(posts, "posts")

    def build(values: Values) -> Part:
        found = rows(values)
        points = _array([centre(row) for row in found], (3,))
        return SpaceDetectionsPart(*head(values), points, _array(map(confidence, found)), _NO_LINES_3D, _NO_NUMBERS)

    return build


def markings_2d(plan: Plan) -> Callable[[Values], Part]:
    head, rows, segments = _head(plan), _rows(plan, "segments"), plan.rows["segments"]
    start, end = (_numbers(segments, f"segments.{end}", "xy") for end in ("start", "end"))
    confidence = _confidence(segments, "segments")

    def build(values: Values) -> Part:
        found = rows(values)
        lines = _array([(start(row), end(row)) for row in found], (2, 2))
        return ImageDetectionsPart(*head(values), _NO_BOXES, _NO_NUMBERS, lines, _array(map(confidence, found)))

    return build


def markings_3d(plan: Plan) -> Callable[[Values], Part]:
    head, rows, segments = _head(plan), _rows(plan, "segments"), plan.rows["segments"]
    start, end = (_numbers(segments, f"segments.{end}", "xyz") for end in ("start", "end"))
    confidence = _confidence(segments, "segments")

    def build(values: Values) -> Part:
        found = rows(values)
        lines = _array([(start(row), end(row)) for row in found], (2, 3))
        return SpaceDetectionsPart(*head(values), _NO_POSTS, _NO_NUMBERS, lines, _array(map(confidence, found)))

    return build


def detections_2d(plan: Plan) -> Callable[[Values], Part]:
    head, posts = _head(plan), _posts(plan)
    box = _box(plan.rows["detections"], "detections.bbox")

    def build(values: Values) -> Part:
        found = posts(values)
        boxes = _array([box(row) for row, _ in found], (4,))
        scores = _array([score for _, score in found])
        return ImageDetectionsPart(*head(values), boxes, scores, _NO_LINES_2D, _NO_NUMBERS)

    return build


def detections_3d(plan: Plan) -> Callable[[Values], Part]:
    head, posts = _head(plan), _posts(plan)
    centre = _numbers(plan.rows["detections"], "detections.bbox.center.position", "xyz")

    def build(values: Values) -> Part:
        found = posts(values)
        points = _array([centre(row) for row, _ in found], (3,))
        scores = _array([score for _, score in found])
        return SpaceDetectionsPart(*head(values), points, scores, _NO_LINES_3D, _NO_NUMBERS)

    return build


def _head(plan: Plan) -> Callable[[Values], tuple[int, str]]:
    pick = itemgetter(*stamp(plan), plan.place("header.frame_id", "string"))

    def head(values: Values) -> tuple[int, str]:
        seconds, rest, frame = pick(values)
        return seconds * SECOND + rest, frame

    return head


def _rows(plan: Plan, path: str) -> Callable[[Values], list[Values]]:
    get = itemgetter(plan.place(path, "rows"))

    def rows(values: Values) -> list[Values]:
        found: list[Values] = get(values)
        return found

    return rows


def _array(numbers: "Sequence[object] | map[float]", shape: tuple[int, ...] = ()) -> FloatArray:
    return np.array(list(numbers), dtype=np.float64).reshape(-1, *shape)


def _numbers(plan: Plan, path: str, names: Sequence[str]) -> Callable[[Values], Sequence[float]]:
    return plan.numbers([f"{path}.{name}" for name in names])


def _box(plan: Plan, path: str) -> Callable[[Values], Sequence[float]]:
    """Centre u, v, width, height."""
    centre = f"{path}.center.position" if plan.has(f"{path}.center.position") else f"{path}.center"
    return plan.numbers([f"{centre}.x", f"{centre}.y", f"{path}.size_x", f"{path}.size_y"])


def _confidence(plan: Plan, path: str) -> Callable[[Values], float]:
    """-1 says that it is not known."""
    inside = f"{path}.confidence.confidence"
    read = plan.number(inside if inside in plan.slots else f"{path}.confidence")

    def confidence(values: Values) -> float:
        number = read(values)
        return np.nan if number < 0 else number

    return confidence


def _posts(plan: Plan) -> Callable[[Values], list[tuple[Values, float]]]:
    """The detections that are most probably goal posts, by their names, each with its score."""
    detections, inner = _rows(plan, "detections"), plan.rows["detections"]
    if "detections.results" not in inner.rows:
        raise BadDefinition("it has no field detections.results")
    results, hypothesis = _rows(inner, "detections.results"), inner.rows["detections.results"]
    path = "detections.results.hypothesis" if hypothesis.has("detections.results.hypothesis") else "detections.results"
    name = f"{path}.class_id" if f"{path}.class_id" in hypothesis.slots else f"{path}.id"
    score = hypothesis.number(f"{path}.score")
    if name in hypothesis.slots and hypothesis.slots[name].kind == "number":
        return lambda values: []  # a number whose meaning is told elsewhere
    get_name = itemgetter(hypothesis.place(name, "string"))

    def posts(values: Values) -> list[tuple[Values, float]]:
        out = []
        for row in detections(values):
            best = max(results(row), key=score, default=None)
            if best is not None and _POST in get_name(best).lower():
                out.append((row, score(best)))
        return out

    return posts
