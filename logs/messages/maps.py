"""The field map as JSON."""

import numpy as np

from fieldloc.colours import Colour, FieldColours, colour_name, colour_of
from fieldloc.field import FieldMap, Landmark, Section
from logs.messages.fields import (
    BadField,
    JsonObject,
    array,
    covariance,
    fixed,
    list_of,
    many,
    number,
    numeric,
    object_schema,
    string,
    text,
    text_lists,
    texts,
    with_optional,
)

_LANDMARK_SCHEMA = with_optional(
    object_schema(
        "A vertical cylinder",
        label=string("Its name, unique on the map"),
        x_m=numeric("Of its axis"),
        y_m=numeric("Of its axis"),
        diameter_m=numeric("0 where it is not known"),
        covariance_m2=fixed("Covariance of (x_m, y_m); zeros where the position is taken as exact", 2, 2),
    ),
    height_m=numeric("0 or missing where it is not known"),
)
FIELD_MAP_SCHEMA = with_optional(
    object_schema(
        "The map that the log was recorded on, in the field frame; written once",
        name=string("Of the map"),
        line_width_m=numeric("Width of the white lines"),
        lines_m=list_of(fixed("Ends [[x, y], [x, y]] of a line's middle", 2, 2), "Straight lines"),
        circles_m=list_of(fixed("[x, y, radius] of a circle's middle", 3), "Circles"),
        landmarks=list_of(_LANDMARK_SCHEMA, "Landmarks"),
    ),
    marks_m=list_of(fixed("[x, y] of its middle", 2), "Penalty marks and the centre's; missing: none"),
    mark_size_m=numeric("Of a mark; missing: 0.1"),
    crossbars=list_of(list_of(string("Label of a landmark"), "The two that a bar joins"), "Missing: none"),
    post_colours=list_of(string("A name or #rrggbb"), "That a landmark may have; missing: white"),
    post_section=string("Of the landmarks: round or square; missing: round"),
)


def field_map_to_json(record: FieldMap) -> JsonObject:
    return {
        "name": record.name,
        "line_width_m": float(record.line_width_m),
        "lines_m": record.lines.tolist(),
        "circles_m": record.circles.tolist(),
        "landmarks": [_landmark_to_json(landmark) for landmark in record.landmarks],
        "marks_m": record.marks.tolist(),
        "mark_size_m": float(record.mark_size_m),
        "crossbars": [[*bar] for bar in record.crossbars],
        "post_colours": [colour_name(colour) for colour in record.colours.posts],
        "post_section": record.post_section,
    }


def field_map_from_json(data: JsonObject) -> FieldMap:
    lines, circles = array(data, "lines_m", 2, 2), array(data, "circles_m", 3)
    landmarks = tuple(many(data, "landmarks", _landmark_from_json))
    width_m = number(data, "line_width_m", above=0.0)
    marks = array(data, "marks_m", 2) if "marks_m" in data else np.zeros((0, 2))
    mark_size_m = number(data, "mark_size_m", above=0.0) if "mark_size_m" in data else 0.1
    try:
        return FieldMap(
            text(data, "name"),
            lines,
            circles,
            landmarks,
            width_m,
            marks,
            mark_size_m,
            _bars(data),
            _colours(data),
            _section(data),
        )
    except ValueError as error:  # what only the map as a whole can tell, such as two landmarks of one label
        raise BadField("the map", f"is refused: {error}") from None


def _bars(data: JsonObject) -> tuple[tuple[str, str], ...]:
    out = []
    for k, ends in enumerate(text_lists(data, "crossbars") if "crossbars" in data else ()):
        if len(ends) != 2:
            raise BadField(f"crossbars[{k}]", f"joins two landmarks, got {len(ends)}")
        out.append((ends[0], ends[1]))
    return tuple(out)


def _colours(data: JsonObject) -> FieldColours:
    if "post_colours" not in data:
        return FieldColours()
    colours: list[Colour] = []
    for name in texts(data, "post_colours"):
        if (colour := colour_of(name)) is None:
            raise BadField("post_colours", f"'{name}' is no colour")
        colours.append(colour)
    return FieldColours(tuple(colours))


def _section(data: JsonObject) -> Section:
    if "post_section" not in data:
        return "round"
    match text(data, "post_section"):
        case "round":
            return "round"
        case "square":
            return "square"
        case other:
            raise BadField("post_section", f"is '{other}', must be round or square")


def _landmark_to_json(landmark: Landmark) -> JsonObject:
    x, y = landmark.position.tolist()
    return {
        "label": landmark.label,
        "x_m": x,
        "y_m": y,
        "diameter_m": float(landmark.diameter_m),
        "covariance_m2": landmark.covariance.tolist(),
        "height_m": float(landmark.height_m),
    }


def _landmark_from_json(data: JsonObject) -> Landmark:
    position = np.array([number(data, "x_m"), number(data, "y_m")])
    diameter_m = number(data, "diameter_m")
    height_m = number(data, "height_m") if "height_m" in data else 0.0
    for name, size in (("diameter_m", diameter_m), ("height_m", height_m)):
        if size < 0.0:
            raise BadField(name, f"is {size:g}, must not be negative")
    return Landmark(text(data, "label"), position, diameter_m, covariance(data, "covariance_m2", 2), height_m)
