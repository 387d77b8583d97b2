"""What a team's own detector has found: JSON lines, one picture each, read into `Detections`.

    {"image": "a.jpg", "width_px": 640, "height_px": 480,
     "posts": [{"left_px": [[100, 50], [101, 200]], "right_px": [[112, 50], [112, 200]], "foot_px": [106, 201]}],
     "lines": [{"ends_px": [[10, 300], [400, 320]]}], "circles": [{"points_px": [[..], ..]}],
     "corners": [{"point_px": [5, 6], "kind": "L", "lines": [0, 1]}], "marks": [{"centre_px": [7, 8]}],
     "boundary_px": [[0, 90], [639, 95]]}

All but image and size may be left out. `sigma_px` with any of them says how exact it is (1 where it is left out);
`covariance_px2`, `foot_covariance_px2`, `top_covariance_px2` as in `fieldloc.vision.detections` say more.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray
from fieldloc.toml_table import TomlTable
from fieldloc.vision.detections import Detections, SeenCircle, SeenCorner, SeenLine, SeenMark, SeenPost

_KINDS = ("L", "T", "X")


def load_detections(path: str | Path) -> dict[str, Detections]:
    """The detections of each image by its name; FieldlocError names the file, the line and what is wrong there."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such file of detections; give the path of one with JSON lines") from None
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a path with a zero byte
        raise FieldlocError(f"{path}: cannot be read as detections: {error}") from None
    found: dict[str, Detections] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        source = f"{path} line {number}"
        try:
            values = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise FieldlocError(f"{source}: not valid JSON: {error}") from None
        if not isinstance(values, Mapping):
            raise FieldlocError(f"{source}: needs an object {{..}} for each picture")
        table = TomlTable(values, source)
        name = table.string("image")
        if name in found:
            table.fail("image", f"{name!r} is there already")
        found[name] = _detections(table)
    return found


def _detections(table: TomlTable) -> Detections:
    width, height = (int(table.number(key, positive=True)) for key in ("width_px", "height_px"))
    lines = tuple(_line(entry) for entry in table.tables("lines"))
    done = Detections(
        width,
        height,
        lines,
        tuple(_post(entry) for entry in table.tables("posts")),
        tuple(_circle(entry) for entry in table.tables("circles")),
        tuple(_corner(entry, len(lines)) for entry in table.tables("corners")),
        tuple(_mark(entry) for entry in table.tables("marks")),
        table.array("boundary_px", (-1, 2), "pixels [[u, v], ..]") if table.has("boundary_px") else None,
    )
    table.finish()
    return done


def _line(table: TomlTable) -> SeenLine:
    ends = table.array("ends_px", (2, 2), "two pixels [[u, v], [u, v]]")
    if np.array_equal(*ends):
        table.fail("ends_px", "starts where it ends")
    width = table.array("width_px", (2,), "the width at either end") if table.has("width_px") else np.full(2, np.nan)
    sigma = table.number("sigma_px", 1.0, positive=True)
    line = SeenLine(ends, _covariance(table, "covariance_px2", 4, sigma), width, np.full(2, sigma))
    table.finish()
    return line


def _post(table: TomlTable) -> SeenPost:
    left, right = (table.array(key, (2, 2), "its upper and lower end") for key in ("left_px", "right_px"))
    sigma = table.number("sigma_px", 1.0, positive=True)
    covariance = _covariance(table, "covariance_px2", 8, sigma)
    ends: list[FloatArray | None] = []
    for key in ("foot", "top"):
        has = table.has(f"{key}_px")
        ends.append(table.array(f"{key}_px", (2,), "a pixel [u, v]") if has else None)
        ends.append(_covariance(table, f"{key}_covariance_px2", 2, sigma) if has else None)
    table.finish()
    return SeenPost(left, right, covariance, *ends)


def _circle(table: TomlTable) -> SeenCircle:
    points = table.array("points_px", (-1, 2), "pixels [[u, v], ..]")
    if len(points) < 5:
        table.fail("points_px", f"an ellipse needs five points, got {len(points)}")
    sigma = np.full(len(points), table.number("sigma_px", 1.0, positive=True))
    ellipse = (
        table.array("ellipse", (5,), "u, v, both semi-axes, angle") if table.has("ellipse") else np.full(5, np.nan)
    )
    table.finish()
    return SeenCircle(points, sigma, ellipse)


def _corner(table: TomlTable, lines: int) -> SeenCorner:
    point = table.array("point_px", (2,), "a pixel [u, v]")
    sigma = table.number("sigma_px", 1.0, positive=True)
    covariance, kind = _covariance(table, "covariance_px2", 2, sigma), table.string("kind")
    if kind not in _KINDS:
        table.fail("kind", f"needs one of {', '.join(_KINDS)}, got {kind!r}")
    first, second = table.array("lines", (2,), "the rows of two lines").tolist()
    if first == second or not all(row in range(lines) for row in (first, second)):
        table.fail("lines", f"needs the rows of two of the {lines} lines, got {first:g} and {second:g}")
    table.finish()
    return SeenCorner(point, covariance, kind, (int(first), int(second)))


def _mark(table: TomlTable) -> SeenMark:
    centre = table.array("centre_px", (2,), "a pixel [u, v]")
    mark = SeenMark(centre, _covariance(table, "covariance_px2", 2, table.number("sigma_px", 1.0, positive=True)))
    table.finish()
    return mark


def _covariance(table: TomlTable, key: str, size: int, sigma_px: float) -> FloatArray:
    if not table.has(key):
        return sigma_px**2 * np.eye(size)
    matrix = table.array(key, (size, size), f"a {size} by {size} matrix")
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] < -1e-9 * max(float(np.trace(matrix)), 1e-9):
        table.fail(key, "needs a symmetric matrix without negative eigenvalues")
    return matrix
