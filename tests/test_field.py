from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.colours import COLOURS, FieldColours
from fieldloc.errors import FieldlocError
from fieldloc.field import PRESETS, FieldMap, Landmark, field_to_toml, load_field, parse_field
from fieldloc.pose import FloatArray, apply
from fieldloc.symmetry import merge_segments

NO_LINES, NO_CIRCLES = np.zeros((0, 2, 2)), np.zeros((0, 3))


def landmark(label: str, x: float, y: float, diameter_m: float = 0.1) -> Landmark:
    return Landmark(label, np.array([x, y]), diameter_m, np.zeros((2, 2)))


def has_line(field: FieldMap, start: tuple[float, float], end: tuple[float, float]) -> bool:
    wanted = np.array([start, end])
    return any(np.allclose(line, wanted) or np.allclose(line[::-1], wanted) for line in field.lines)


@pytest.mark.parametrize(
    ("name", "length_m", "width_m", "lines"),
    [("kidsize-2014", 6, 4, 11), ("kidsize", 9, 6, 17), ("adultsize", 14, 9, 17), ("spl", 9, 6, 17)],
)
def test_every_preset_has_its_size_its_lines_and_four_posts_on_the_goal_lines(
    name: str, length_m: float, width_m: float, lines: int
) -> None:
    field = load_field(name)
    assert field.name == name
    assert field.bounds == (-length_m / 2, -width_m / 2, length_m / 2, width_m / 2)
    assert len(field.lines) == lines
    assert set(np.abs(field.positions[:, 0])) == {length_m / 2}
    assert field.index_of("post_opponent_left") == 0
    assert field.positions[0, 1] > 0 < field.positions[0, 0]
    assert {mark.diameter_m for mark in field.landmarks} == {0.1}


def test_the_paper_s_field_agrees_with_kidsize_2014() -> None:
    # Fig. 6 in the paper's centimetres, x to the right, z forward: goal area at z = +-240, x = +-110
    field = load_field("kidsize-2014")
    for end in (1, -1):
        assert has_line(field, (end * 2.4, -1.1), (end * 2.4, 1.1))
        for side in (1, -1):
            assert has_line(field, (end * 2.4, side * 1.1), (end * 3.0, side * 1.1))
    assert has_line(field, (0.0, -2.0), (0.0, 2.0))


def test_the_spl_field_agrees_with_the_one_the_nao_recordings_were_made_on() -> None:
    field = load_field("spl")
    assert np.allclose(np.abs(field.positions), [4.5, 0.8])
    assert has_line(field, (4.5 - 1.65, -2.0), (4.5 - 1.65, 2.0))
    assert has_line(field, (4.5 - 0.6, -1.1), (4.5 - 0.6, 1.1))
    assert np.allclose(field.circles, [[0, 0, 0.75]])


@pytest.mark.parametrize(
    ("name", "clear_m", "mark_m", "colour"),
    [
        ("kidsize-2014", 0.8, 1.8, "yellow"),
        ("kidsize", 1.2, 1.5, "white"),
        ("adultsize", 1.8, 2.1, "white"),
        ("spl", 0.8, 1.3, "white"),
    ],
)
def test_every_preset_has_its_crossbars_its_marks_and_the_colour_of_its_posts(
    name: str, clear_m: float, mark_m: float, colour: str
) -> None:
    field = load_field(name)
    assert [mark.height_m for mark in field.landmarks] == pytest.approx([clear_m + 0.1] * 4)  # the bar is 10 cm thick
    for ends in field.crossbars:
        a, b = (field.landmarks[field.labels.index(label)].position for label in ends)
        assert a[0] == b[0]
        assert a[1] == -b[1]
    assert len(field.crossbars) == 2
    x = field.bounds[2] - mark_m
    assert np.allclose(field.marks, [[x, 0], [-x, 0], [0, 0]])
    assert field.colours.posts == (COLOURS[colour],)
    assert field.post_section == "round"


def test_a_map_that_says_nothing_of_looks_has_white_round_posts_without_height_and_no_marks() -> None:
    field = parse_field(field_text(), "lab")
    assert field.colours == FieldColours(((255, 255, 255),))
    assert field.post_section == "round"
    assert field.crossbars == ()
    assert field.marks.shape == (0, 2)
    assert {mark.height_m for mark in field.landmarks} == {0.0}


def test_a_user_s_map_says_what_its_posts_look_like() -> None:
    text = """
        post_colour = ["yellow", "#0a14ff"]
        post_section = "square"
        marks = [[1, 0]]
        mark_size_m = 0.2
        crossbars = [["a", "b"]]
        landmarks = [
            {label = "a", position_m = [0, 0], height_m = 0.9},
            {label = "b", position_m = [1, 0], height_m = 0.9},
        ]
        """
    for field in (parse_field(text, "lab"), parse_field(field_to_toml(parse_field(text, "lab")), "again")):
        assert field.colours.posts == (COLOURS["yellow"], (10, 20, 255))
        assert field.post_section == "square"
        assert np.array_equal(field.marks, [[1, 0]])
        assert field.mark_size_m == 0.2
        assert field.crossbars == (("a", "b"),)
        assert [mark.height_m for mark in field.landmarks] == [0.9, 0.9]


@pytest.mark.parametrize("name", PRESETS)
def test_a_soccer_field_maps_onto_itself_by_the_half_turn_alone(name: str) -> None:
    assert np.array_equal(load_field(name).symmetries, [[0.0, 0.0, np.pi]])


def test_a_map_without_pattern_has_no_symmetry() -> None:
    points = np.random.default_rng(3).uniform(-5, 5, (17, 2))
    woods = FieldMap("woods", NO_LINES, NO_CIRCLES, tuple(landmark(str(i), x, y) for i, (x, y) in enumerate(points)))
    assert woods.symmetries.shape == (0, 3)
    assert woods.labels[4] == "4"
    assert np.array_equal(woods.positions, points)


def test_one_odd_landmark_breaks_the_half_turn() -> None:
    field = load_field("spl")
    for odd in (landmark("tree", 5.0, 1.0), landmark("tree", 0.0, 0.0)):
        marked = FieldMap("marked", field.lines, field.circles, (*field.landmarks, odd))
        # one on the centre turns onto itself and says nothing
        assert len(marked.symmetries) == (1 if odd.position[0] == 0.0 else 0)
    for circle in ([0.5, 0.0, 0.75], [4.0, 0.0, 0.2]):
        marked = FieldMap("marked", field.lines, np.vstack([field.circles, circle]), field.landmarks)
        assert len(marked.symmetries) == 0
    pair = np.array([[1.0, 0.0, 0.5], [-1.0, 0.0, 0.6]])
    assert len(FieldMap("pair", field.lines, pair, field.landmarks).symmetries) == 0
    thicker = (landmark("post_opponent_left", 4.5, 0.8, 0.12), *field.landmarks[1:])
    assert len(FieldMap("thicker", field.lines, field.circles, thicker).symmetries) == 0


def test_one_odd_mark_breaks_the_half_turn() -> None:
    field = load_field("spl")
    for odd, turns in (((1.0, 0.0), 0), ((0.0, 0.0), 1)):
        marked = FieldMap("marked", field.lines, field.circles, field.landmarks, marks=np.array([odd]))
        assert len(marked.symmetries) == turns


def test_a_square_of_posts_away_from_the_origin_turns_by_quarters_about_its_middle() -> None:
    corners = [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0), (1.0, 3.0)]
    square = FieldMap("square", NO_LINES, NO_CIRCLES, tuple(landmark(str(c), *c) for c in corners))
    assert np.allclose(square.symmetries[:, 2], [-np.pi / 2, np.pi / 2, np.pi])
    for turn in square.symmetries:
        assert np.allclose(apply(turn, np.array([2.0, 2.0])), [2.0, 2.0])
        assert {tuple(np.round(apply(turn, np.array(c)), 9)) for c in corners} == set(corners)


@given(st.integers(2, 7), st.floats(-20, 20), st.floats(-20, 20), st.floats(-3.1, 3.1), st.floats(0.1, 20))
@settings(deadline=None, max_examples=50)
def test_a_regular_polygon_of_posts_has_all_its_turns(n: int, x: float, y: float, phase: float, radius: float) -> None:
    angles = phase + 2 * np.pi * np.arange(n) / n
    marks = tuple(landmark(str(i), x + radius * np.cos(a), y + radius * np.sin(a), 0.0) for i, a in enumerate(angles))
    turns = FieldMap("polygon", NO_LINES, NO_CIRCLES, marks).symmetries
    steps = np.mod(turns[:, 2] * n / (2 * np.pi) + 1e-6, n)
    assert np.allclose(np.sort(steps), np.arange(1, n), atol=1e-5)


def test_it_does_not_matter_how_a_line_was_drawn() -> None:
    whole = np.array([[[-1.0, 0.0], [2.0, 0.0]]])
    pieces = np.array([[[2.0, 0.0], [0.5, 0.0]], [[-1.0, 0.0], [0.0, 0.0]], [[-0.5, 0.0], [1.0, 0.0]]])
    merged = merge_segments(pieces)
    assert np.allclose(np.sort(merged[0], axis=0), whole[0])
    field = load_field("spl")
    halves = np.array([[[4.5, -3.0], [4.5, 1.0]], [[4.5, 1.0], [4.5, 3.0]]])
    is_goal_line = (field.lines[:, :, 0] == 4.5).all(axis=1)
    redrawn = FieldMap("r", np.concatenate([field.lines[~is_goal_line], halves]), field.circles, field.landmarks)
    assert len(redrawn.symmetries) == 1


def test_parallel_lines_a_line_s_width_apart_stay_two() -> None:
    lines = np.array([[[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.05], [1.0, 0.05]], [[1.1, 0.0], [2.0, 0.0]]])
    assert len(merge_segments(lines)) == 3


@pytest.mark.parametrize("name", PRESETS)
def test_a_map_written_as_toml_reads_back_digit_by_digit(name: str) -> None:
    field = load_field(name)
    again = parse_field(field_to_toml(field), "again")
    assert again.name == name
    assert again.line_width_m == field.line_width_m
    assert again.labels == field.labels
    assert again.colours == field.colours
    assert again.post_section == field.post_section
    assert again.crossbars == field.crossbars
    assert [mark.height_m for mark in again.landmarks] == [mark.height_m for mark in field.landmarks]
    for key in ("lines", "circles", "marks", "positions", "positions_covariance", "symmetries"):
        assert np.array_equal(getattr(again, key), getattr(field, key))


def test_any_label_survives_toml() -> None:
    label = 'a "quoted" \\ label\n\twith é and \x01'
    marks = (Landmark(label, np.array([1 / 3, -1e-17]), 0.0, np.array([[2e-4, 1e-5], [1e-5, 1e-4]])),)
    again = parse_field(field_to_toml(FieldMap("one", NO_LINES, NO_CIRCLES, marks)), "again")
    assert again.labels == (label,)
    assert again.positions[0, 0] == 1 / 3
    assert np.array_equal(again.positions_covariance[0], marks[0].covariance)


def test_a_user_s_map_of_lines_circles_and_landmarks_is_read(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        """
        line_width_m = 0.04
        lines = [[[0, 0], [1, 0]], [[0, 0], [0, 2.5]]]
        circles = [[1, 2, 0.5]]
        [[landmarks]]
        label = "7"
        position_m = [3, -1]
        sigma_m = 0.02
        [[landmarks]]
        label = "8"
        position_m = [3.5, -1]
        diameter_m = 0.14
        covariance_m2 = [[4e-4, 1e-4], [1e-4, 1e-4]]
        """
    )
    field = load_field(str(path))
    assert field.name == "lab"
    assert field.line_width_m == 0.04
    assert field.lines.shape == (2, 2, 2)
    assert np.array_equal(field.circles, [[1, 2, 0.5]])
    assert field.labels == ("7", "8")
    assert field.index_of("8") == 1
    assert field.index_of("9") is None
    assert np.allclose(field.positions_covariance, [[[4e-4, 0], [0, 4e-4]], [[4e-4, 1e-4], [1e-4, 1e-4]]])
    assert [mark.diameter_m for mark in field.landmarks] == [0.0, 0.14]
    assert field.bounds == (0.0, -1.0, 3.5, 2.5)


def test_a_soccer_field_takes_more_lines_and_landmarks() -> None:
    text = field_text(goal_width_m=2.0) + '[[landmarks]]\nlabel = "beacon"\nposition_m = [0, 2.5]\n'
    field = parse_field("lines = [[[0, 3], [1, 3]]]\n" + text, "lab")
    assert field.labels[-1] == "beacon"
    assert np.isclose(field.positions[0, 1], 1.05)  # half the width between the posts and half a post
    assert has_line(field, (0.0, 3.0), (1.0, 3.0))
    assert len(field.lines) == 12


def field_text(**changes: object) -> str:
    numbers: dict[str, object] = {
        "field_length_m": 6.0,
        "field_width_m": 4.0,
        "goal_width_m": 1.5,
        "goal_area_length_m": 0.6,
        "goal_area_width_m": 2.2,
        "centre_circle_diameter_m": 1.2,
    }
    return "[soccer]\n" + "".join(f"{k} = {v}\n" for k, v in (numbers | changes).items() if v is not None)


MARK = '[[landmarks]]\nlabel = "a"\nposition_m = [0, 1]\n'
MISTAKES = [
    ("lines = [", "not valid TOML"),
    ("", "empty map"),
    ("lines = []", "empty map"),
    ("lines = [[[0, 0], [0, 0]]]", "lines[0]: starts where it ends"),
    ("lines = [[[0, 0], [1]]]", "lines: needs pairs"),
    ("lines = [[[0, 0], [1, nan]]]", "lines: needs pairs"),
    ("lines = [[0, 0, 1, 1]]", "lines: needs pairs"),
    ('lines = "none"', "lines: needs pairs"),
    ("circles = [[0, 0, 0]]", "circles[0]: needs a radius"),
    ("circles = [[0, 0]]", "circles: needs triples"),
    ("line_width_m = 0\n" + MARK, "line_width_m: needs a number above 0"),
    ("line_width_m = true\n" + MARK, "line_width_m: needs a number above 0"),
    ('name = ""\n' + MARK, "name: needs a name"),
    ("width = 3\n" + MARK, "width: unknown key; known here are circles, crossbars, landmarks, line"),
    ("[landmarks]\nx = 1", "landmarks: needs tables [[landmarks]]"),
    ("landmarks = [1]", "landmarks: needs tables [[landmarks]]"),
    ('[[landmarks]]\nlabel = "a"', "landmarks[0].position_m: missing"),
    ("[[landmarks]]\nposition_m = [0, 1]", "landmarks[0].label: missing"),
    ("[[landmarks]]\nlabel = 3\nposition_m = [0, 1]", "landmarks[0].label: needs a name in quotes, got 3"),
    (MARK + "position_m = [1, 2]", "not valid TOML"),
    (MARK + MARK, "landmarks[1].label: 'a' is already on the map"),
    (MARK + "diameter_m = -0.1", "landmarks[0].diameter_m: needs a number of at least 0"),
    (MARK + "diameter_m = inf", "landmarks[0].diameter_m: needs a number of at least 0"),
    (MARK + "sigma = 0.1", "landmarks[0].sigma: unknown key"),
    (MARK + "sigma_m = 0.1\ncovariance_m2 = [[1, 0], [0, 1]]", "landmarks[0].covariance_m2: give either"),
    (MARK + "covariance_m2 = [[1, 2], [2, 1]]", "landmarks[0].covariance_m2: needs a symmetric"),
    (MARK + "covariance_m2 = [[1, 0.5], [0, 1]]", "landmarks[0].covariance_m2: needs a symmetric"),
    ("soccer = 3", "soccer: needs a table [soccer]"),
    (field_text(goal_width_m=None), "soccer.goal_width_m: missing"),
    (field_text(goal_width_m='"wide"'), "soccer.goal_width_m: needs a number above 0, got 'wide'"),
    (field_text(penalty_area_length_m=1.0), "soccer.penalty_area_length_m: a penalty area needs"),
    (field_text(goal_hight_m=1.0), "soccer.goal_hight_m: unknown key"),
    (field_text(goal_height_m=-1.0), "soccer.goal_height_m: needs a number of at least 0"),
    (field_text(penalty_mark_distance_m=3.0), "soccer.penalty_mark_distance_m: the marks lie on the other half"),
    ('post_colour = "mauve"\n' + MARK, "post_colour: needs one or several of white, yellow,"),
    ("post_colour = []\n" + MARK, "post_colour: needs one or several of white, yellow,"),
    ('post_colour = "#12345"\n' + MARK, "post_colour: needs one or several of white, yellow,"),
    ('post_section = "oval"\n' + MARK, "post_section: needs 'round' or 'square', got 'oval'"),
    ("marks = [[1, 2, 3]]\n" + MARK, "marks: needs pairs [x, y]"),
    ('crossbars = [["a", "b"]]\n' + MARK, "crossbars: needs pairs of the labels"),
    ('crossbars = ["a", "b"]\n' + MARK, "crossbars: needs pairs of the labels"),
    ('crossbars = [["a", 3]]\n' + MARK, "crossbars: needs pairs of the labels"),
    (MARK + "height_m = -1", "landmarks[0].height_m: needs a number of at least 0"),
]


@pytest.mark.parametrize(("text", "message"), MISTAKES)
def test_every_mistake_is_one_line_that_names_the_file_and_the_key(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(FieldlocError) as caught:
        load_field(str(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_the_presets(tmp_path: Path) -> None:
    with pytest.raises(FieldlocError, match=r"kidsize-2015: no such field map; give one of kidsize-2014, kidsize,"):
        load_field("kidsize-2015")
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_field(str(tmp_path))
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_field("a\0b")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_field(str(tmp_path / "binary.toml"))


@pytest.mark.parametrize(
    ("lines", "circles", "marks"),
    [
        (np.zeros((1, 2, 2)), NO_CIRCLES, ()),
        (np.ones((2, 2)), NO_CIRCLES, ()),
        (NO_LINES, np.array([[0.0, np.nan, 1.0]]), ()),
        (NO_LINES, NO_CIRCLES, (landmark("a", 0, 0), landmark("a", 1, 0))),
        (NO_LINES, NO_CIRCLES, (Landmark("a", np.zeros(3), 0.1, np.zeros((2, 2))),)),
    ],
)
def test_a_map_made_wrongly_in_code_is_a_value_error(
    lines: FloatArray, circles: FloatArray, marks: tuple[Landmark, ...]
) -> None:
    with pytest.raises(ValueError):
        FieldMap("wrong", lines, circles, marks)


def test_looks_made_wrongly_in_code_are_a_value_error() -> None:
    post = landmark("a", 0, 0)
    with pytest.raises(ValueError, match="does not join two landmarks that have a height"):
        FieldMap("wrong", NO_LINES, NO_CIRCLES, (post, landmark("b", 1, 0)), crossbars=(("a", "b"),))
    with pytest.raises(ValueError, match="marks"):
        FieldMap("wrong", NO_LINES, NO_CIRCLES, (post,), marks=np.zeros((1, 3)))
    with pytest.raises(ValueError, match="no colour"):
        FieldColours(())
    with pytest.raises(ValueError, match="is no colour"):
        FieldColours(((0, 0, 256),))


def test_a_map_cannot_be_changed_behind_an_estimator_s_back() -> None:
    field = load_field("spl")
    with pytest.raises(ValueError, match="read-only"):
        field.positions[0, 0] = 1.0
    lines = np.array([[[0.0, 0.0], [1.0, 0.0]]])
    copied = FieldMap("copied", lines, NO_CIRCLES, ())
    lines[0, 0, 0] = 9.0
    assert copied.lines[0, 0, 0] == 0.0


def test_the_documented_example_is_a_map() -> None:
    text = (Path(__file__).parents[1] / "docs" / "field-maps.md").read_text(encoding="utf-8")
    example = text.split("```toml\n")[1].split("```")[0]
    field = parse_field(example, "docs/field-maps.md")
    assert field.labels[-1] == "beacon"
    assert len(field.lines) == 17
    # and with its commented lines, circles and marks, which the text says to put before the first table
    commented = [line[2:] for line in example.splitlines() if line.startswith(("# lines", "# circles", "# marks"))]
    more = parse_field("\n".join([*commented, example]), "docs")
    assert len(more.lines) == 19
    assert len(more.marks) == 4
