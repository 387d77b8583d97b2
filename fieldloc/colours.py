"""What colours a field's goal posts have, by name or as #rrggbb."""

import re
from dataclasses import dataclass

from fieldloc.toml_table import TomlTable

Colour = tuple[int, int, int]
"""sRGB, 0 to 255 each, as it looks in white light."""

COLOURS: dict[str, Colour] = {
    "white": (255, 255, 255),
    "yellow": (255, 215, 0),
    "blue": (0, 60, 200),
    "cyan": (0, 190, 220),
    "red": (215, 20, 20),
    "orange": (255, 120, 0),
    "pink": (240, 60, 160),
    "black": (15, 15, 15),
}
_WHITE = COLOURS["white"]
_HEX = re.compile(r"#[0-9a-fA-F]{6}")


@dataclass(frozen=True, slots=True)
class FieldColours:
    """posts: the colours that a post may have, all posts alike. Turf is green and lines are white on every field.

    ValueError without any colour, and for one that is none.
    """

    posts: tuple[Colour, ...] = (_WHITE,)

    def __post_init__(self) -> None:
        if not self.posts:
            raise ValueError("posts have no colour")
        for colour in self.posts:
            if not all(type(part) is int and 0 <= part <= 255 for part in colour):
                raise ValueError(f"posts: {colour!r} is no colour, needs three whole numbers from 0 to 255")


def read_colours(table: TomlTable, key: str) -> FieldColours:
    """The colours under a key, a name or a list of names; white where the key is missing."""
    if not table.has(key):
        return FieldColours()
    needs = f"one or several of {', '.join(COLOURS)} or '#rrggbb'"
    found = []
    for name in table.strings(key, needs):
        if (colour := colour_of(name)) is None:
            table.fail(key, f"needs {needs}, got {name!r}")
        found.append(colour)
    if not found:
        table.fail(key, f"needs {needs}, got none")
    return FieldColours(tuple(found))


def colour_of(name: str) -> Colour | None:
    """The colour of that name or #rrggbb, None for what is neither."""
    if _HEX.fullmatch(name):
        red, green, blue = bytes.fromhex(name[1:])
        return red, green, blue
    return COLOURS.get(name)


def colour_name(colour: Colour) -> str:
    """The name that `colour_of` reads back."""
    return next((name for name, known in COLOURS.items() if known == colour), "#{:02x}{:02x}{:02x}".format(*colour))
