"""Lines, circle, corners and marks in drawn pictures, whose truth is exact, and in two real ones."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from turf_drawings import exposed, turf, with_ellipse, with_spot, with_stripe

from fieldloc.camera import Camera
from fieldloc.vision import lines, rim, white
from fieldloc.vision.detect import detect
from fieldloc.vision.detections import SeenLine
from fieldloc.vision.picture import load_picture
from fieldloc.vision.settings import VisionSettings

IMAGES = Path(__file__).parents[2] / "shared" / "data"


CROSSINGS = {
    "L": [((100.0, 300.0), (400.0, 200.0)), ((400.0, 200.0), (550.0, 350.0))],
    "T": [((60.0, 200.0), (600.0, 230.0)), ((330.0, 215.0), (300.0, 420.0))],
    "X": [((60.0, 200.0), (600.0, 260.0)), ((420.0, 100.0), (250.0, 420.0))],
}


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def wide(point, width_px):
    """The width at a point of a stripe on the ground that is that wide in the middle row; the horizon is at row 0."""
    return width_px * point[1] / 240.0


def across(line: SeenLine, first, last, widths=(0.0, 0.0)):
    """(2,) of the line's ends from the true one, and the (2, 2) covariance that is claimed for that. widths: of the
    stripe on the ground, whose middle is nearer to the horizon, at row 0, than to its nearer edge.
    """
    along = (last - first) / np.linalg.norm(last - first)
    normal = np.array([-along[1], along[0]])
    first, last = (
        end - normal * width**2 * normal[1] / (4.0 * end[1]) for end, width in zip((first, last), widths, strict=True)
    )
    along = (last - first) / np.linalg.norm(last - first)
    normal = np.array([-along[1], along[0]])
    gain = np.kron(np.eye(2), normal)
    return (line.ends_px - first) @ normal, gain @ line.covariance_px2 @ gain.T


@pytest.mark.parametrize("height", [60, 61])
def test_scan_lines_are_what_a_resize_makes_of_a_picture(rng, height):
    grey = rng.integers(0, 256, (height, 50), dtype=np.uint8)
    expected = cv2.resize(grey, (50, height // white.SCAN_STEP_PX), interpolation=cv2.INTER_AREA)
    assert np.array_equal(white._scan_lines(grey), expected)


@pytest.mark.parametrize("width_px", [3.0, 6.0, 20.0])
@pytest.mark.parametrize("turn", [0.05, 0.6, 1.4, 2.3])
def test_a_line_is_found_to_a_part_of_a_pixel_with_its_width(rng, width_px, turn):
    reach = 170.0 * np.array([np.cos(turn), np.sin(turn)])
    first, last = np.array([[320.0, 270.0]]) + np.array([[-1.0], [1.0]]) * reach
    widths = wide(first, width_px), wide(last, width_px)
    found = detect(exposed(with_stripe(turf(rng), first, last, widths), rng))
    assert len(found.lines) == 1
    line = found.lines[0]
    off, _ = across(line, first, last, widths)
    assert np.abs(off).max() < 0.15
    assert np.linalg.norm(line.ends_px[1] - line.ends_px[0]) == pytest.approx(340.0, abs=25.0)
    true = np.interp(line.ends_px[:, 1], *zip(*sorted(zip((first[1], last[1]), widths, strict=True)), strict=True))
    blurred = np.maximum(true, 2.0)  # nothing is seen thinner than a lens with a sigma of 0.7 px shows a thread
    assert np.allclose(line.width_px, blurred, rtol=0.1, atol=0.7)


def test_the_covariance_of_a_line_says_how_far_off_it_is(monkeypatch):
    monkeypatch.setattr(lines, "_FLOOR_PX", 0.0)  # which is for what these drawings have not: JPEG, a lens
    scores = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        first, last = np.array([90.0, 130.0 + 8.0 * seed]), np.array([560.0, 280.0 - 5.0 * seed + rng.uniform(0, 1)])
        width = rng.uniform(3.0, 14.0)
        widths = wide(first, width), wide(last, width)
        found = detect(exposed(with_stripe(turf(rng), first, last, widths), rng, noise=20.0))
        off, covariance = across(max(found.lines, key=lambda line: np.ptp(line.ends_px)), first, last, widths)
        scores.append(off @ np.linalg.solve(covariance, off) / 2.0)
    # Half of chi squares of two degrees of freedom, the mean of 24 of them: 1 +- 0.2
    assert 0.5 < np.mean(scores) < 1.5


def test_a_fields_corner_at_the_pictures_border_is_two_lines(rng):
    corner = np.array([111.0, 442.0])
    light = turf(rng)
    for end, width in (([-40.0, 492.0], 18.0), ([170.0, 498.0], 27.0)):
        light = with_stripe(light, corner, np.array(end), (0.9 * width, width))
    found = detect(exposed(light, rng)).lines
    assert len(found) == 2
    slopes = sorted(float(np.divide(*(line.ends_px[1] - line.ends_px[0])[::-1])) for line in found)
    assert slopes == pytest.approx([-50.0 / 151.0, 56.0 / 59.0], abs=0.05)


@pytest.mark.parametrize("touchline", [True, False])
def test_a_short_piece_is_a_line_only_between_another_and_the_pictures_border(rng, touchline):
    end = np.array([28.0, 352.5] if touchline else [17.0, 355.0])  # as much is seen of it beside the touchline
    light = with_stripe(turf(rng), np.array([-20.0, 363.0]), end, (8.0, 8.0))
    if touchline:
        light = with_stripe(light, np.array([13.0, 98.0]), np.array([42.0, 500.0]), (4.0, 23.0))
    found = detect(exposed(light, rng)).lines
    flat = [line for line in found if abs(np.ptp(line.ends_px[:, 0])) > np.ptp(line.ends_px[:, 1])]
    assert len(flat) == touchline
    assert len(found) == 2 * touchline


@pytest.mark.parametrize("finder", ["lsd", "hough"])
def test_opencvs_finders_of_edges_lead_to_the_same_lines(rng, finder):
    light = turf(rng)
    for first, last in CROSSINGS["X"]:
        light = with_stripe(light, np.array(first), np.array(last), (wide(first, 5.0), wide(last, 5.0)))
    light = with_ellipse(light, np.array([330.0, 290.0]), (220.0, 100.0), 7.0)
    picture = exposed(light, rng)
    own, other = detect(picture), detect(picture, settings=VisionSettings(finder=finder))
    assert len(own.lines) == len(other.lines) == 2
    for line in own.lines:
        away = [np.abs(across(line, *one.ends_px)[0]).max() for one in other.lines]
        assert min(away) < 0.1


def test_a_line_behind_something_is_one_line(rng):
    light = with_stripe(turf(rng), np.array([40.0, 200.0]), np.array([600.0, 330.0]), (7.0, 7.0))
    light[180:420, 280:350] = (30, 30, 35)
    seen = detect(exposed(light, rng)).lines
    assert len(seen) == 1
    assert np.ptp(seen[0].ends_px[:, 0]) > 530.0


def test_a_stripe_of_sun_is_no_line(rng):
    light = turf(rng)
    light[:] *= 0.45
    light[200:212, 60:600] /= 0.45
    assert detect(exposed(light, rng)).lines == ()


def test_a_white_wall_behind_the_field_is_no_line(rng):
    light = turf(rng, top=150)
    light[:150] = (240, 240, 240)
    light[60:64] = (50, 140, 60)
    assert detect(exposed(light, rng)).lines == ()


def test_something_white_that_stands_on_the_turf_is_no_line(rng):
    light = with_stripe(turf(rng, top=200), np.array([300.0, 80.0]), np.array([300.0, 330.0]), (16.0, 16.0))
    light = with_stripe(light, np.array([450.0, 60.0]), np.array([455.0, 300.0]), (24.0, 24.0))
    assert detect(exposed(light, rng)).lines == ()


@pytest.mark.parametrize("met", [True, False])
def test_a_wide_piece_that_ends_behind_something_is_a_line_where_another_ends_at_it(rng, met):
    light = with_stripe(turf(rng), np.array([355.0, 510.0]), np.array([425.0, 270.0]), (36.0, 13.0))
    if met:
        light = with_stripe(light, np.array([399.0, 391.0]), np.array([660.0, 419.0]), (9.0, 10.0))
    light[200:325, 380:440] = (60, 60, 65)
    assert len(detect(exposed(light, rng)).lines) == 2 * met


def test_a_line_is_one_however_high_the_fields_border_seems(rng):
    light = with_stripe(turf(rng, top=240), np.array([146.0, 289.0]), np.array([440.0, 490.0]), (4.0, 20.0))
    light[:240] = (75, 140, 85)  # a green wall
    (line,) = detect(exposed(light, rng)).lines
    assert np.linalg.norm(line.ends_px[1] - line.ends_px[0]) > 280.0


def test_a_net_before_the_turf_is_no_line_but_what_is_seen_beside_it_is(rng):
    light = with_stripe(turf(rng), np.array([-20.0, 440.0]), np.array([660.0, 400.0]), (13.0, 12.0))
    for step in range(7):
        light = with_stripe(
            light, np.array([300.0 + 35.0 * step, 120.0]), np.array([290.0 + 38.0 * step, 340.0]), (3, 3)
        )
        light = with_stripe(light, np.array([280.0, 130.0 + 30 * step]), np.array([540.0, 110.0 + 33 * step]), (3, 3))
    (line,) = detect(exposed(light, rng)).lines
    assert np.linalg.norm(line.ends_px[1] - line.ends_px[0]) > 500.0


def test_a_circle_is_a_circle_and_no_line(rng, monkeypatch):
    monkeypatch.setattr(rim, "middle_shift", lambda pixels, *_: np.zeros((2, len(pixels))))  # it lies not on the ground
    centre = np.array([330.0, 280.0])
    found = detect(exposed(with_ellipse(turf(rng), centre, (220.0, 70.0), 9.0), rng))
    assert len(found.circles) == 1
    assert found.lines == ()
    circle = found.circles[0]
    assert np.allclose(circle.ellipse[:2], centre, atol=0.3)
    assert np.allclose(circle.ellipse[2:4], (220.0, 70.0), atol=0.5)
    x, y = ((circle.points_px - centre) / (220.0, 70.0)).T
    off = (np.hypot(x, y) - 1.0) / np.hypot(x / 220.0, y / 70.0)
    assert np.sqrt(np.mean(off**2)) < 0.25
    assert 0.3 < np.mean((off / circle.sigma_px) ** 2) < 3.0


@pytest.mark.parametrize("centre", [(0.0, 300.0), (330.0, 470.0), (640.0, 200.0)])
def test_a_part_of_a_circle_is_enough(rng, centre):
    found = detect(exposed(with_ellipse(turf(rng), np.array(centre), (210.0, 90.0), 8.0), rng))
    assert len(found.circles) == 1
    assert np.allclose(found.circles[0].ellipse[:2], centre, atol=3.0)


def arcs_of_a_circle(rng, columns):
    """A wide near arc, seen between dark things in these columns only."""
    light = with_ellipse(turf(rng), np.array([330.0, 520.0]), (520.0, 240.0), 12.0)
    seen = np.zeros(640, dtype=bool)
    for first, last in columns:
        seen[first:last] = True
    light[150:, ~seen] = (30, 30, 35)
    return exposed(light, rng)


CAMERA = Camera("pinhole", 640, 480, 550.0, 550.0, 319.5, 239.5)


@pytest.mark.parametrize("first", [100, 250, 450])
def test_a_short_arc_that_bends_by_half_a_pixel_is_no_line(rng, first):
    picture = arcs_of_a_circle(rng, [(first, first + 75)])
    assert detect(picture, camera=CAMERA).lines == ()


def test_short_arcs_are_a_circle_together(rng):
    found = detect(arcs_of_a_circle(rng, [(60, 140), (270, 350), (480, 570)]), camera=CAMERA)
    assert found.lines == ()
    assert len(found.circles) == 1
    x, y = ((found.circles[0].points_px - (330.0, 520.0)) / (520.0, 240.0)).T
    off = 240.0 * (np.hypot(x, y) - 1.0)  # pixels, as the arcs lie flat
    assert np.sqrt(np.mean(off**2)) < 0.3
    assert np.abs(off).max() < 1.5  # beside something dark


def test_the_line_through_a_circle_is_found_beside_it(rng):
    light = with_ellipse(turf(rng), np.array([330.0, 280.0]), (200.0, 80.0), 8.0)
    light = with_stripe(light, np.array([-20.0, 262.0]), np.array([660.0, 300.0]), (7.0, 7.0))
    found = detect(exposed(light, rng))
    assert len(found.circles) == 1
    assert len(found.lines) == 1
    assert np.ptp(found.lines[0].ends_px[:, 0]) > 600.0


def test_the_corner_of_two_lines_is_no_circle(rng):
    light = with_stripe(turf(rng), np.array([60.0, 200.0]), np.array([330.0, 240.0]), (5.0, 5.0))
    light = with_stripe(light, np.array([330.0, 240.0]), np.array([620.0, 190.0]), (5.0, 5.0))
    found = detect(exposed(light, rng))
    assert found.circles == ()
    assert len(found.lines) == 2


@pytest.mark.parametrize("kind", CROSSINGS)
def test_where_lines_meet_is_a_corner_of_its_kind(rng, kind):
    light = turf(rng)
    for first, last in CROSSINGS[kind]:
        light = with_stripe(light, np.array(first), np.array(last), (wide(first, 5.0), wide(last, 5.0)))
    found = detect(exposed(light, rng))
    assert [corner.kind for corner in found.corners] == [kind]
    (a, b), (c, d) = (np.array(ends) for ends in CROSSINGS[kind])
    true = a + (b - a) * np.linalg.solve(np.stack([b - a, c - d], axis=1), c - a)[0]
    off = found.corners[0].point_px - true
    assert np.abs(off).max() < 0.5
    assert off @ np.linalg.solve(found.corners[0].covariance_px2, off) < 13.8  # 99.9 %
    assert found.corners[0].lines == (0, 1)


def test_a_spot_on_the_turf_is_a_mark_and_no_line(rng):
    found = detect(exposed(with_spot(turf(rng), np.array([400.5, 250.0]), (20.0, 7.0)), rng))
    assert found.lines == ()
    assert len(found.marks) == 1
    assert np.allclose(found.marks[0].centre_px, (400.5, 250.0), atol=0.4)


def test_a_ball_with_black_patches_is_no_mark(rng):
    light = with_spot(turf(rng), np.array([400.0, 250.0]), (16.0, 16.0))
    light = light.copy()
    light[240:250, 392:400] = light[252:262, 402:410] = 10.0
    assert detect(exposed(light, rng)).marks == ()


def test_lines_are_straight_through_the_lens(rng):
    camera = Camera("pinhole", 640, 480, 420.0, 420.0, 319.5, 239.5, (-0.3, 0.1, 0.0, 0.0))
    light = with_stripe(turf(rng, top=0), np.array([-80.0, 400.0]), np.array([720.0, 410.0]), (9.0, 9.0))
    # A picture through the lens: each of its pixels shows what is in that direction of the one without distortion.
    v, u = np.mgrid[:480, :640].astype(np.float64)
    rays, _ = camera.ray(np.stack([u, v], axis=-1))
    flat = (rays[..., :2] / rays[..., 2:] * 420.0 + (319.5, 239.5)).astype(np.float32)
    bent = cv2.remap(light, flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    seen = detect(exposed(bent, rng), camera=camera).lines
    assert len(seen) == 1
    rays, _ = camera.ray(seen[0].ends_px)
    points = rays[:, :2] / rays[:, 2:] * 420.0 + (319.5, 239.5)
    off, _ = across(
        SeenLine(points, seen[0].covariance_px2, *[np.zeros(2)] * 2), np.array([-80, 400.0]), np.array([720, 410.0])
    )
    assert np.abs(off).max() < 0.3  # interpolation twice
    assert np.ptp(seen[0].ends_px[:, 0]) > 560.0


def scattered(rng, name):
    green = np.full((480, 640, 3), (50, 140, 60), np.uint8)
    if name == "salt":
        return np.where(rng.random((480, 640, 1)) < 0.02, np.uint8(255), green)
    for _ in range(300):
        begin = rng.integers(0, [640, 480])
        if name == "strokes":
            cv2.line(green, begin.tolist(), (begin + rng.integers(-80, 80, 2)).tolist(), (255, 255, 255), 3)
        else:
            axes, turn, arc = rng.integers(20, 200, 2).tolist(), rng.uniform(0, 180), rng.uniform(30, 360)
            cv2.ellipse(green, begin.tolist(), axes, turn, 0, arc, (255, 255, 255), 3)
    return green


@pytest.mark.parametrize("name", ["salt", "strokes", "curves"])
def test_no_picture_takes_long(rng, name):
    picture = scattered(rng, name)
    start = time.process_time()
    detect(picture, camera=CAMERA)
    assert time.process_time() - start < 1.0  # 0.1 s; a field takes 0.02 s


@pytest.mark.parametrize("name", ["black", "white", "green", "noise", "grey", "one", "row", "column", "checker"])
def test_pictures_of_nothing_show_nothing(rng, name):
    green = np.full((480, 640, 3), (50, 140, 60), np.uint8)
    squares = ((np.add.outer(np.arange(480) // 8, np.arange(640) // 8) % 2) == 0)[..., None]
    picture = {
        "black": green * 0,
        "white": green * 0 + 255,
        "green": green,
        "noise": rng.integers(0, 256, green.shape, dtype=np.uint8),
        "grey": green * 0 + 100,
        "one": green[:1, :1],
        "row": green[:1],
        "column": green[:, :1],
        "checker": np.where(squares, green, 255).astype(np.uint8),
    }[name]
    found = detect(picture)
    assert (found.width_px, found.height_px) == picture.shape[1::-1]
    assert found.lines + found.circles + found.corners + found.marks + found.posts == ()


def test_a_line_stays_where_it_is_when_the_picture_is_twice_as_large(rng):
    first, last = np.array([100.0, 150.0]), np.array([560.0, 300.0])
    light = with_stripe(turf(rng), first, last, (7.0, 7.0))
    large = cv2.resize(exposed(light, rng), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    seen = detect(np.asarray(large)).lines
    assert len(seen) == 1
    off, _ = across(seen[0], 2.0 * first + 0.5, 2.0 * last + 0.5)
    assert np.abs(off).max() < 0.2


def drawn(found, shape):
    """Which pixels are white by what was found: lines as wide as they are, the circle's points in a stroke of 7."""
    mask = np.zeros(shape, np.uint8)
    for line in found.lines:
        along = np.diff(line.ends_px, axis=0)[0]
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        half = 0.5 * line.width_px[:, None] * normal
        corners = np.concatenate([line.ends_px + half, (line.ends_px - half)[::-1]])
        cv2.fillPoly(mask, [np.rint(8 * corners).astype(np.int32)], 1, cv2.LINE_8, 3)
    for circle in found.circles:
        for u, v in circle.points_px:
            cv2.circle(mask, (round(u), round(v)), 3, 1, -1)
    return mask > 0


@pytest.mark.skipif(not (IMAGES / "images" / "torso").is_dir(), reason="needs ../shared/data, which is not shipped")
def test_lines_of_a_real_picture_are_where_its_mask_says():
    folder = IMAGES / "images" / "torso"
    truth = cv2.imread(str(folder / "segmentation_1_0.png"), cv2.IMREAD_UNCHANGED)[:, :, 0] == 127
    found = drawn(detect(load_picture(folder / "segmentation_1_1.png")), truth.shape)
    away_from_truth = cv2.distanceTransform((~truth).astype(np.uint8), cv2.DIST_L2, 5)
    away_from_found = cv2.distanceTransform((~found).astype(np.uint8), cv2.DIST_L2, 5)
    assert np.mean(away_from_truth[found] <= 3.0) > 0.9
    assert np.mean(away_from_found[truth] <= 3.0) > 0.85


@pytest.mark.skipif(not (IMAGES / "nao").is_dir(), reason="needs ../shared/data, which is not shipped")
@pytest.mark.parametrize("point", [1, 2, 3, 4, 5])
def test_the_circle_and_the_halfway_line_are_found_in_every_picture_of_a_nao(point):
    found = detect(load_picture(IMAGES / "nao" / "black1" / f"point{point}" / "imagetop.jpg"))
    assert len(found.circles) == 1
    assert max(np.ptp(line.ends_px[:, 0]) for line in found.lines) > 500.0
    if point == 2:  # picked by hand to two pixels: where the circle is nearest, farthest, and meets the halfway line
        picked = np.array([[345.0, 409.5], [345.0, 353.0], [176.0, 374.5], [524.0, 373.0]])
        u, v, longer, shorter, angle = found.circles[0].ellipse
        turn = np.linspace(0.0, 2.0 * np.pi, 2000)[:, None]
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        rim = np.array([u, v]) + longer * np.cos(turn) * along + shorter * np.sin(turn) * across
        away = np.linalg.norm(picked[:, None] - rim, axis=2).min(axis=1)
        assert away.max() < 4.0


@pytest.mark.skipif(not (IMAGES / "nao").is_dir(), reason="needs ../shared/data, which is not shipped")
@pytest.mark.parametrize("point", [2, 3])
def test_in_another_light_the_circle_is_seen_all_around_still(point):
    picture = load_picture(IMAGES / "nao" / "black1" / f"point{point}" / "imagetop.jpg")
    warm = np.minimum(picture * [0.75, 1.0, 1.2], 255.0)
    pale = 255.0 * (picture / 255.0) ** 0.6
    rim = detect(picture).circles[0].points_px
    for other in (warm, pale):
        found = detect(other.astype(np.uint8)).circles[0].points_px
        away = np.linalg.norm(rim[:, None] - found, axis=2).min(axis=1)
        assert np.mean(away < 5.0) > 0.8
