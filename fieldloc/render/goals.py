"""Goal posts and crossbars as shapes."""

import numpy as np

from fieldloc.field import FieldMap, Landmark
from fieldloc.pose import FloatArray
from fieldloc.render.scene import Colour, Goals
from fieldloc.render.solid import Bar, Box, Pillar

_USUAL_DIAMETER_M = 0.1
_BRIGHTEST = 0.92  # share of a colour at its brightest that is left, so that light may add to it

Post = Pillar | Box


def diameter_m(mark: Landmark) -> float:
    """The usual one where the map does not know it."""
    return mark.diameter_m or _USUAL_DIAMETER_M


def post_colour(field_map: FieldMap, row: int = 0, light: float = _BRIGHTEST) -> Colour:
    """One of those that the map names, as it looks in so much of the brightest light."""
    red, green, blue = field_map.colours.posts[row]
    return light * blue, light * green, light * red


def post_of(field_map: FieldMap, index: int, goals: Goals) -> Post:
    """A landmark as it stands on the ground."""
    mark = field_map.landmarks[index]
    kind = Box if field_map.post_section == "square" else Pillar
    return kind(mark.position, 0.5 * diameter_m(mark), 0.0, mark.height_m or goals.height_m)


def crossbars(field_map: FieldMap, goals: Goals) -> list[Bar]:
    """As thick as their posts; from axis to axis."""
    out: list[Bar] = []
    for labels in field_map.crossbars:
        indices = [field_map.index_of(label) for label in labels]
        posts = [post_of(field_map, index, goals) for index in indices if index is not None]
        radius = posts[0].radius_m
        start, end = (_below_top(post, radius) for post in posts)
        out.append(Bar(start, end, radius))
    return out


def _below_top(post: Post, radius_m: float) -> FloatArray:
    return np.append(post.centre, post.high_m - radius_m)
