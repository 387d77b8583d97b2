"""The map: lines, circles and landmarks in the field frame, by name or from a TOML file (docs/field-maps.md).

                y
    +-----------^-----------+         origin at the field's centre,
    |           |           |         x towards the opponent's goal, y to the left,
own |           o-----------> x       headings counter-clockwise from x,
    |           |           |         metres and radians
    +-----------+-----------+ opponent's goal
"""

from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from fieldloc.colours import FieldColours, colour_name, read_colours
from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray
from fieldloc.soccer import read_soccer
from fieldloc.symmetry import symmetries
from fieldloc.toml_table import TomlTable

Section = Literal["round", "square"]

PRESETS = ("kidsize-2014", "kidsize", "adultsize", "spl")


_NO_MARKS = np.zeros((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """A vertical cylinder.

    position: (2,) of its axis, metres in the field frame. diameter_m, height_m: 0 where it is not known.
    covariance: (2, 2) of the surveyed position in field axes; zeros where it is taken as exact.
    """

    label: str
    position: FloatArray
    diameter_m: float
    covariance: FloatArray
    height_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FieldMap:
    """What can be seen on a field; compared by identity.

    lines: (n, 2, 2) end points of the lines' middles, metres. circles: (k, 3) x, y, radius of the line's middle.
    marks: (m, 2) the middles of the penalty marks and of the centre's: crosses of mark_size_m, as wide as lines.
    crossbars: labels of each two landmarks that a horizontal bar joins, as thick as they are; its upper edge is as high
    as they are. colours, post_section: of the landmarks; a square one is diameter_m wide, its sides along x and y.
    Raises ValueError for wrong shapes, values that are not finite, lines without length, landmarks of equal label and
    crossbars without two landmarks that have a height.
    """

    name: str
    lines: FloatArray
    circles: FloatArray
    landmarks: tuple[Landmark, ...]
    line_width_m: float = 0.05
    marks: FloatArray = field(default_factory=_NO_MARKS.copy)
    mark_size_m: float = 0.1
    crossbars: tuple[tuple[str, str], ...] = ()
    colours: FieldColours = field(default_factory=FieldColours)
    post_section: Section = "round"
    symmetries: FloatArray = field(init=False, repr=False)
    """(s, 3) poses other than the identity that map the map onto itself (landmarks all look alike): the half turn on a
    soccer field, none on a map without symmetry."""
    labels: tuple[str, ...] = field(init=False, repr=False)
    positions: FloatArray = field(init=False, repr=False)
    """(n, 2) of the landmarks."""
    positions_covariance: FloatArray = field(init=False, repr=False)
    """(n, 2, 2) of the landmarks, field axes."""
    _index: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        lines = _checked(self.lines, (2, 2), "lines")
        circles = _checked(self.circles, (3,), "circles")
        marks = _checked(self.marks, (2,), "marks")
        positions = _checked(np.array([mark.position for mark in self.landmarks]), (2,), "positions")
        covariance = _checked(np.array([mark.covariance for mark in self.landmarks]), (2, 2), "covariances")
        diameters = np.array([mark.diameter_m for mark in self.landmarks]).reshape(-1, 1)
        labels = tuple(mark.label for mark in self.landmarks)
        if len(set(labels)) < len(labels):
            raise ValueError(f"landmarks of equal label: {sorted({x for x in labels if labels.count(x) > 1})}")
        if np.any(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1) == 0.0):
            raise ValueError("a line has no length")
        if self.post_section not in get_args(Section):
            raise ValueError(f"post_section is {self.post_section!r}, must be one of: {', '.join(get_args(Section))}")
        high = {mark.label for mark in self.landmarks if mark.height_m > 0.0}
        for ends in self.crossbars:
            if len(set(ends) & high) != 2:
                raise ValueError(f"the crossbar {ends!r} does not join two landmarks that have a height")
        spots = np.hstack([marks, np.full((len(marks), 1), -1.0)])  # no diameter: a mark turns onto a mark only
        sigmas_m = np.sqrt(np.linalg.eigvalsh(covariance)[:, -1:].ravel().clip(min=0.0))
        derived = {
            "lines": lines,
            "circles": circles,
            "marks": marks,
            "positions": positions,
            "positions_covariance": covariance,
            "symmetries": symmetries(
                lines,
                circles,
                np.vstack([np.hstack([positions, diameters]), spots]),
                np.append(sigmas_m, np.zeros(len(spots))),
            ),
        }
        for key, array in derived.items():
            array.flags.writeable = False  # shared by everyone who localizes on this map
            object.__setattr__(self, key, array)
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "_index", {label: i for i, label in enumerate(labels)})

    def index_of(self, label: str) -> int | None:
        """Where the landmark stands in `landmarks`, `positions` and `labels`; None if it is not on the map."""
        return self._index.get(label)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) around everything, metres."""
        centres, radii = self.circles[:, :2], self.circles[:, 2:]
        points = np.concatenate(
            [self.lines.reshape(-1, 2), centres - radii, centres + radii, self.marks, self.positions]
        )
        if not len(points):
            return (0.0, 0.0, 0.0, 0.0)
        (xmin, ymin), (xmax, ymax) = points.min(axis=0), points.max(axis=0)
        return (float(xmin), float(ymin), float(xmax), float(ymax))


def load_field(name_or_path: str) -> FieldMap:
    """The preset of that name, or the map in that TOML file; FieldlocError says what is wrong with it."""
    if name_or_path in PRESETS:
        text = (resources.files("fieldloc") / "fields" / f"{name_or_path}.toml").read_text(encoding="utf-8")
        return parse_field(text, name_or_path)
    path = Path(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        names = ", ".join(PRESETS)
        raise FieldlocError(f"{path}: no such field map; give one of {names}, or the path of a TOML file") from None
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise FieldlocError(f"{path}: cannot be read as a field map: {error}") from None
    return parse_field(text, str(path))


def parse_field(text: str, source: str) -> FieldMap:
    """The map that TOML text describes; messages name `source`."""
    table = TomlTable.parse(text, source)
    name = table.string("name") if table.has("name") else Path(source).stem
    line_width = table.number("line_width_m", 0.05, positive=True)
    lines, circles, marks, landmarks = np.zeros((0, 2, 2)), np.zeros((0, 3)), _NO_MARKS, []
    bars: list[tuple[str, str]] = []
    if table.has("soccer"):
        soccer = read_soccer(table.table("soccer"))
        lines, circles, marks, height = soccer.lines(), soccer.circles(), soccer.marks(), soccer.post_height_m
        landmarks = [
            Landmark(label, position, soccer.post_diameter_m, np.zeros((2, 2)), height)
            for label, position in soccer.posts().items()
        ]
        if height:
            bars = [(f"post_{side}_left", f"post_{side}_right") for side in ("opponent", "own")]
    if table.has("lines"):
        own = table.array("lines", (-1, 2, 2), "pairs of end points [[x0, y0], [x1, y1]] in metres")
        for i, (start, end) in enumerate(own):
            if np.array_equal(start, end):
                table.fail(f"lines[{i}]", "starts where it ends")
        lines = np.concatenate([lines, own])
    if table.has("circles"):
        own = table.array("circles", (-1, 3), "triples [x, y, radius] in metres")
        for i, radius in enumerate(own[:, 2]):
            if radius <= 0.0:
                table.fail(f"circles[{i}]", f"needs a radius above 0, got {radius}")
        circles = np.concatenate([circles, own])
    if table.has("marks"):
        marks = np.concatenate([marks, table.array("marks", (-1, 2), "pairs [x, y] in metres")])
    for entry in table.tables("landmarks"):
        mark = _landmark(entry)
        if any(mark.label == other.label for other in landmarks):
            entry.fail("label", f"'{mark.label}' is already on the map")
        landmarks.append(mark)
    bars += _crossbars(table, {mark.label for mark in landmarks if mark.height_m > 0.0})
    section: Section = "round"
    if table.has("post_section"):
        match table.string("post_section"):
            case "round" | "square" as section:
                pass
            case other:
                table.fail("post_section", f"needs 'round' or 'square', got {other!r}")
    colours, mark_size_m = read_colours(table, "post_colour"), table.number("mark_size_m", 0.1, positive=True)
    table.finish()
    if not len(lines) and not len(circles) and not landmarks:
        raise FieldlocError(f"{source}: an empty map; give [soccer], lines, circles or [[landmarks]]")
    return FieldMap(
        name, lines, circles, tuple(landmarks), line_width, marks, mark_size_m, tuple(bars), colours, section
    )


def field_to_toml(field_map: FieldMap) -> str:
    """TOML text that `parse_field` turns into the same map, digit by digit."""
    parts = [f'name = "{_escaped(field_map.name)}"', f"line_width_m = {field_map.line_width_m!r}"]
    parts += [f"mark_size_m = {field_map.mark_size_m!r}", f'post_section = "{field_map.post_section}"']
    names = (f'"{colour_name(colour)}"' for colour in field_map.colours.posts)
    parts.append(f"post_colour = [{', '.join(names)}]")
    if field_map.crossbars:
        ends = (f'["{_escaped(a)}", "{_escaped(b)}"]' for a, b in field_map.crossbars)
        parts.append(f"crossbars = [{', '.join(ends)}]")
    for key in ("lines", "circles", "marks"):
        rows = getattr(field_map, key).tolist()
        if rows:
            parts += [f"{key} = [", *(f"    {row}," for row in rows), "]"]
    for mark in field_map.landmarks:
        parts += ["", "[[landmarks]]", f'label = "{_escaped(mark.label)}"', f"position_m = {mark.position.tolist()}"]
        parts += [f"diameter_m = {float(mark.diameter_m)!r}", f"height_m = {float(mark.height_m)!r}"]
        parts += [f"covariance_m2 = {mark.covariance.tolist()}"]
    return "\n".join(parts) + "\n"


def _landmark(table: TomlTable) -> Landmark:
    label = table.string("label")
    position = table.array("position_m", (2,), "[x, y] in metres")
    diameter, height = table.number("diameter_m", 0.0), table.number("height_m", 0.0)
    sigma = table.number("sigma_m", 0.0)
    covariance = sigma**2 * np.eye(2)
    if table.has("covariance_m2"):
        if table.has("sigma_m"):
            table.fail("covariance_m2", "give either this or sigma_m")
        covariance = table.array("covariance_m2", (2, 2), "[[xx, xy], [xy, yy]] in square metres")
        if covariance[0, 1] != covariance[1, 0] or np.linalg.eigvalsh(covariance)[0] < 0.0:
            table.fail("covariance_m2", "needs a symmetric matrix without negative eigenvalues")
    table.finish()
    return Landmark(label, position, diameter, covariance, height)


def _crossbars(table: TomlTable, high: set[str]) -> list[tuple[str, str]]:
    """The pairs under the key; `high` are the landmarks that have a height."""
    needs = "pairs of the labels of landmarks that have a height"
    pairs = []
    for pair in table.rows("crossbars", needs):
        if len(set(pair)) != 2 or not set(pair) <= high:
            table.fail("crossbars", f"needs {needs}, got {list(pair)!r}")
        pairs.append((pair[0], pair[1]))
    return pairs


def _checked(array: FloatArray, row: tuple[int, ...], what: str) -> FloatArray:
    """A copy of shape (n, *row)."""
    out = np.array(array, dtype=np.float64)
    if out.size == 0:
        return np.zeros((0, *row))
    if out.shape[1:] != row:
        raise ValueError(f"{what} has shape {out.shape}, needs (n, {', '.join(map(str, row))})")
    if not np.all(np.isfinite(out)):
        raise ValueError(f"{what} holds a value that is not finite")
    return out


def _escaped(text: str) -> str:
    """Inside the quotes of a TOML basic string."""
    plain = text.replace("\\", "\\\\").replace('"', '\\"')
    return "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in plain)
