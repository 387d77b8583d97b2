"""The truth about a rendered picture as JSON: what stands beside each one that `fieldloc render` writes."""

import json
from collections.abc import Sequence

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.random_views import View
from fieldloc.render.truth import Truth

Json = dict[str, object]


def truth_json(view: View, field_name: str, truth: Truth, seed: Sequence[int]) -> str:
    """One JSON object on one line; seed: of the generator that the view was drawn with.

    Pixel centres are at integers; edges are [upper, lower] ends; null is what is not visible.
    """
    camera, mount = view.camera, view.mount
    x_m, y_m, heading_rad = view.pose.tolist()
    document: Json = {
        "field": field_name,
        "seed": list(seed),
        "pose": {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad},
        "mount": {
            name: float(getattr(mount, name)) for name in ("x_m", "y_m", "height_m", "pan_rad", "tilt_rad", "roll_rad")
        },
        "camera": {
            "model": camera.model,
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "fx_px": camera.fx_px,
            "fy_px": camera.fy_px,
            "cx_px": camera.cx_px,
            "cy_px": camera.cy_px,
            "distortion": list(camera.distortion),
        },
        "lines": [
            {"line": line.line, "ends_px": line.ends_px.tolist(), "ends_m": line.ends_m.tolist()}
            for line in truth.lines
        ],
        "circles": [{"circle": one.circle, "points_px": np.round(one.points_px, 4).tolist()} for one in truth.circles],
        "posts": [
            {
                "label": post.label,
                "left_px": _list(post.left_px),
                "right_px": _list(post.right_px),
                "foot_px": _list(post.foot_px),
                "top_px": _list(post.top_px),
            }
            for post in truth.posts
        ],
        "crossbars": [
            {"labels": list(bar.labels), "upper_px": _list(bar.upper_px), "lower_px": _list(bar.lower_px)}
            for bar in truth.bars
        ],
        "crossings": [
            {"lines": list(one.lines), "kind": one.kind, "point_px": one.point_px.tolist()} for one in truth.crossings
        ],
        "marks": [{"mark": mark.mark, "centre_px": mark.centre_px.tolist()} for mark in truth.marks],
        "robots_m": [[robot.x_m, robot.y_m] for robot in view.scene.robots],
        "people_m": [[person.x_m, person.y_m] for person in view.scene.people],
        "balls_m": [[ball.x_m, ball.y_m] for ball in view.scene.balls],
        "hidden_share": float(truth.hidden.mean()),
    }
    return json.dumps(document)


def _list(array: FloatArray | None) -> object:
    return None if array is None else array.tolist()
