"""A map in a log is the map, with what its goals look like."""

import json

import pytest

from fieldloc.field import PRESETS, load_field
from fieldloc.field import field_to_toml as as_toml
from logs.messages.fields import BadField, JsonObject
from logs.messages.maps import field_map_from_json, field_map_to_json


def written(name: str) -> JsonObject:
    out = json.loads(json.dumps(field_map_to_json(load_field(name))))
    assert isinstance(out, dict)
    return out


@pytest.mark.parametrize("name", PRESETS)
def test_a_map_comes_back_whole(name: str) -> None:
    assert as_toml(field_map_from_json(written(name))) == as_toml(load_field(name))


def test_a_map_of_an_older_log_says_nothing_of_its_goals() -> None:
    data = written("kidsize-2014")
    for key in ("marks_m", "mark_size_m", "crossbars", "post_colours", "post_section"):
        del data[key]
    for landmark in data["landmarks"]:
        del landmark["height_m"]
    found = field_map_from_json(data)
    assert (len(found.marks), found.crossbars, found.landmarks[0].height_m) == (0, (), 0.0)
    assert found.colours.posts == ((255, 255, 255),)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("post_colours", ["purplish"], "is no colour"),
        ("post_colours", [3], "needs a string"),
        ("post_section", "oval", "must be round or square"),
        ("crossbars", [["a"]], "joins two landmarks, got 1"),
        ("crossbars", [["a", "b"]], "is refused"),
        ("marks_m", [[1.0]], "marks_m"),
        ("mark_size_m", 0.0, "above 0"),
    ],
)
def test_what_is_no_goal_is_refused(key: str, value: object, said: str) -> None:
    data = written("kidsize")
    data[key] = value
    with pytest.raises(BadField, match=said):
        field_map_from_json(data)
