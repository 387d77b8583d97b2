import json
import re

import foxglove.layouts as fl
import foxglove.messages
import pytest

from logs.foxglove import layout_path, topics
from logs.schema import BY_ROLE, TOPICS

LAYOUT = json.loads(layout_path().read_text(encoding="utf-8"))
PANELS = LAYOUT["configById"]
SCHEMAS = {
    topics.FIELD: "SceneUpdate",
    topics.POSE: "PoseInFrame",
    topics.STATE: "Odometry",
    topics.TRANSFORMS: "FrameTransforms",
    topics.UNCERTAINTY: "SceneUpdate",
    topics.TRAJECTORY: "PosesInFrame",
    topics.SIGHTS: "SceneUpdate",
    topics.ANNOTATIONS: "ImageAnnotations",
    topics.HYPOTHESES: "PosesInFrame",
    topics.WEIGHTS: "SceneUpdate",
    topics.EVENTS: "Log",
}
"""What tests/test_foxglove_results.py and tests/test_estimates.py see written."""
SETTINGS = {
    "SceneUpdate": fl.BaseRendererSceneUpdateTopicSettings,
    "PoseInFrame": fl.BaseRendererPoseTopicSettings,
    "PosesInFrame": fl.BaseRendererPosesTopicSettings,
    "Odometry": fl.BaseRendererPoseTopicSettings,
}
OLD_NAMES = {"axisScale": "axisSize"}  # Lichtblick's name of what Foxglove renamed


def panels(kind):
    return [config for name, config in PANELS.items() if name.startswith(f"{kind}!")]


def known(config, kind, *, extra=()):
    """Whether the SDK's typed layouts have each key of the panel's settings."""
    return {OLD_NAMES.get(key, key) for key in config} <= {*kind()._to_dict(), "foxglovePanelTitle", *extra}


def leaves(tree):
    return [tree] if isinstance(tree, str) else [*leaves(tree["first"]), *leaves(tree["second"])]


def test_the_layout_has_what_an_import_needs():
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


def test_each_panel_is_placed_once():
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)


def test_there_is_a_panel_of_each_kind():
    kinds = [name.partition("!")[0] for name in PANELS]
    assert sorted(kinds) == ["3D", "Image", "Plot", "Plot", "Plot", "RawMessages"]


def test_every_topic_that_is_shown_is_one_that_is_written():
    shown = [topic for panel in panels("3D") for topic in panel["topics"]]
    shown += [topic for panel in panels("Image") for topic in panel["imageMode"]["annotations"]]
    shown += [panel["topicPath"] for panel in panels("RawMessages")]
    shown += [path["value"].partition(".")[0] for panel in panels("Plot") for path in panel["paths"]]
    assert set(shown) <= {*SCHEMAS, TOPICS["estimate"], TOPICS["hypotheses"]}


def test_every_scene_pose_and_way_is_in_the_3d_panel():
    (panel,) = panels("3D")
    assert set(panel["topics"]) == {topic for topic, schema in SCHEMAS.items() if schema in SETTINGS}


@pytest.mark.parametrize("path", [path["value"] for panel in panels("Plot") for path in panel["paths"]])
def test_every_path_that_is_plotted_leads_to_a_number(path):
    topic, field, index, _ = re.fullmatch(r"(/[a-z/]+)\.([a-z_]+)(?:\[(\d+)\])?(\.@sqrt)?", path).groups()
    if (role := topic[1:]) in BY_ROLE:
        assert index is None  # viewers cannot look into lists of lists, as a covariance is one
        assert BY_ROLE[role].json_schema["properties"][field]["type"] == "number"
    else:
        message = getattr(foxglove.messages, SCHEMAS[topic])
        message(**{field: [0.0] * 36})
        assert int(index) in (0, 7, 35)  # the variances of x, y and the turn about z


def test_the_3d_panel_looks_down_on_the_field():
    (panel,) = panels("3D")
    assert panel["followTf"] == topics.Frames().field == topics.BESIDE_OTHERS.field
    camera = panel["cameraState"]
    assert (camera["perspective"], camera["phi"], camera["thetaOffset"]) == (False, 0, 0)


def test_no_setting_is_misspelled():
    (scene,), (image,), (raw,) = panels("3D"), panels("Image"), panels("RawMessages")
    assert known(scene, fl.ThreeDeeConfig, extra=["imageMode"])
    assert known(scene["cameraState"], fl.ThreeDeeCameraState)
    assert known(scene["scene"]["transforms"], fl.BaseRendererTransforms)
    assert all(known(one, SETTINGS[SCHEMAS[topic]]) for topic, one in scene["topics"].items())
    assert known(image, fl.ImageConfig, extra=["cameraState", "followMode"])
    assert known(image["imageMode"], fl.ImageModeConfig)
    assert known(raw, fl.RawMessagesConfig)
    for plot in panels("Plot"):
        assert known(plot, fl.PlotConfig)
        assert all(known(path, fl.PlotSeries) for path in plot["paths"])


def test_the_topics_are_none_of_the_recorders():
    assert not set(SCHEMAS) & set(TOPICS.values())
    assert all(topic.startswith(topics.PREFIX) for topic in SCHEMAS)
