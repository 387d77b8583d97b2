import json
from pathlib import Path

import numpy as np
import pytest

from fieldloc.errors import FieldlocError
from fieldloc.vision.plugged import load_detections

SIZE = {"image": "a.jpg", "width_px": 640, "height_px": 480}
POST = {"left_px": [[100, 50], [101, 200]], "right_px": [[112, 50], [112, 200]]}
LINES = [{"ends_px": [[10, 300], [400, 320]]}, {"ends_px": [[10, 300], [40, 420]], "sigma_px": 0.5}]


def written(tmp_path: Path, *records: object) -> Path:
    path = tmp_path / "seen.jsonl"
    path.write_text("\n".join(record if isinstance(record, str) else json.dumps(record) for record in records))
    return path


def test_what_another_detector_found_is_read_by_image(tmp_path: Path) -> None:
    corner = {"point_px": [10, 300], "kind": "L", "lines": [0, 1], "covariance_px2": [[2, 1], [1, 2]]}
    record = SIZE | {
        "posts": [POST | {"foot_px": [106, 201], "sigma_px": 0.3}, POST],
        "lines": LINES,
        "corners": [corner],
        "circles": [{"points_px": [[n, n * n] for n in range(6)]}],
        "marks": [{"centre_px": [7, 8]}],
        "boundary_px": [[0, 90], [639, 95]],
    }
    found = load_detections(written(tmp_path, record, "", SIZE | {"image": "b.jpg"}))
    assert list(found) == ["a.jpg", "b.jpg"]
    seen = found["a.jpg"]
    assert (seen.width_px, seen.height_px) == (640, 480)
    assert np.allclose(seen.posts[0].covariance_px2, 0.09 * np.eye(8))
    assert np.allclose(seen.posts[0].observation().foot_px, [106, 201])
    assert seen.posts[1].foot_px is None
    assert np.allclose(seen.lines[1].covariance_px2, 0.25 * np.eye(4))
    assert seen.corners[0].lines == (0, 1)
    assert seen.circles[0].points_px.shape == (6, 2)
    assert np.array_equal(seen.boundary_px, [[0, 90], [639, 95]])
    assert found["b.jpg"].posts == ()


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ("{", "line 1: not valid JSON"),
        ("[1]", "line 1: needs an object"),
        ({"image": "a.jpg"}, "line 1: width_px: missing"),
        (SIZE | {"balls": []}, "balls: unknown key"),
        (SIZE | {"posts": [{"left_px": [[1, 2], [3, 4]]}]}, "posts[0].right_px: missing"),
        (SIZE | {"posts": [POST | {"sigma_px": 0}]}, "posts[0].sigma_px: needs a number above 0"),
        (SIZE | {"lines": [{"ends_px": [[1, 2], [1, 2]]}]}, "lines[0].ends_px: starts where it ends"),
        (SIZE | {"lines": [LINES[0] | {"covariance_px2": np.diag([1, 1, 1, -1]).tolist()}]}, "symmetric matrix"),
        (SIZE | {"circles": [{"points_px": [[1, 2]]}]}, "five points"),
        (
            SIZE | {"corners": [{"point_px": [1, 2], "kind": "Y", "lines": [0, 1]}]},
            "corners[0].kind: needs one of L, T, X",
        ),
        (SIZE | {"lines": LINES, "corners": [{"point_px": [1, 2], "kind": "L", "lines": [0, 2]}]}, "of the 2 lines"),
    ],
)
def test_a_mistake_names_the_file_the_line_and_the_key(record: object, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, record)
    with pytest.raises(FieldlocError) as caught:
        load_detections(path)
    assert str(caught.value).startswith(f"{path} line 1: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_records_of_one_image_and_a_missing_file_are_mistakes(tmp_path: Path) -> None:
    with pytest.raises(FieldlocError, match=r"line 2: image: 'a.jpg' is there already"):
        load_detections(written(tmp_path, SIZE, SIZE))
    with pytest.raises(FieldlocError, match="no such file of detections"):
        load_detections(tmp_path / "none.jsonl")
