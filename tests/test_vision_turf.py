import numpy as np
import pytest
from turf_drawings import exposed, turf, with_stripe

from fieldloc.colours import COLOURS, FieldColours
from fieldloc.vision.turf import Turf, find_turf


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.mark.parametrize(
    "colour", [(50, 140, 60), (20, 60, 25), (40, 130, 120), (130, 150, 30), (90, 220, 110), (105, 120, 20)]
)
def test_turf_of_any_green_is_found_up_to_its_border(rng, colour):
    found = find_turf(exposed(turf(rng, colour=colour, top=120), rng))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], 119.5, atol=4.0)  # a pixel of the coarse grid is 4 wide
    assert found.boundary_px[0, 0] <= 0.0
    assert found.boundary_px[-1, 0] >= 639.0
    assert found.mask.mean() > 0.7
    assert np.allclose(found.colour, colour, atol=8.0)


def test_shade_and_sun_are_the_same_turf(rng):
    light = turf(rng, top=100)
    light[:, 200:350] *= 0.4
    light[:, 450:500] *= 1.6
    found = find_turf(exposed(light, rng))
    rows = np.full(4, 300.0)
    assert found.at(np.stack([[100.0, 275.0, 400.0, 475.0], rows], axis=1)).all()


def test_something_in_front_of_the_border_does_not_dent_it(rng):
    light = turf(rng, top=120)
    light[60:330, 250:330] = (40, 40, 45)
    found = find_turf(exposed(light, rng))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], 119.5, atol=4.0)
    assert not found.at(np.array([290.0, 200.0]))


def test_green_things_behind_the_field_are_not_the_field(rng):
    light = turf(rng, top=200)
    light[30:80, 100:200] = (50, 140, 60)
    light[:205, 400:412] = (50, 140, 60)
    found = find_turf(exposed(light, rng))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], 199.5, atol=6.0)


def test_a_white_line_is_within_the_field_but_no_turf(rng):
    light = with_stripe(turf(rng), np.array([-20.0, 300.0]), np.array([660.0, 300.0]), (16.0, 16.0))
    found = find_turf(exposed(light, rng))
    points = np.array([[320.0, 300.0], [320.0, 280.0], [320.0, 320.0]])
    assert found.at(points).tolist() == [False, True, True]
    assert (found.below_px(points) > 200).all()


@pytest.mark.parametrize("colour", [(0, 0, 0), (255, 255, 255), (128, 128, 128), (200, 60, 40), (40, 50, 200)])
def test_without_green_there_is_no_field(colour):
    found = find_turf(np.full((480, 640, 3), colour, np.uint8))
    assert found.boundary_px is None
    assert not found.mask.any()
    assert not found.at(np.array([3.0, 3.0]))
    assert found.below_px(np.array([3.0, 3.0])) == -np.inf


@pytest.mark.parametrize("shape", [(480, 1), (1, 640), (1, 1), (2, 3), (1080, 1920)])
def test_a_picture_of_nothing_but_turf_is_all_field_whatever_its_shape(shape):
    found = find_turf(np.full((*shape, 3), (50, 140, 60), np.uint8))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], -0.5, atol=1.0)
    assert found.mask.all()


def test_points_beside_the_picture_or_nowhere_are_not_turf():
    found = find_turf(np.full((480, 640, 3), (50, 140, 60), np.uint8))
    assert not found.at(np.array([[-2.0, 5.0], [640.0, 5.0], [3.0, 480.0], [np.nan, 4.0]])).any()
    assert found.at(np.array([[0.0, 0.0], [639.0, 479.0]])).all()


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.75])
def test_every_point_has_the_colour_of_the_pixel_of_the_mask_it_is_in(rng, scale):
    mask = rng.random((24, 32)) < 0.5
    field = Turf(mask, np.array([scale, scale]), np.array([[-0.5, -0.5], [31.5, -0.5]]), np.zeros(3))
    inside = np.nextafter(np.arange(1.0, 33.0), 0.0)  # at the far end of each pixel, by rounding in the next
    u = np.concatenate([np.arange(32.0), inside, [-1e-9, 32.0]])
    v = np.concatenate([np.arange(24.0), inside[:24], [-1e-9, 24.0]])
    expected = [[0 <= x < 32 and 0 <= y < 24 and mask[int(y), int(x)] for x in u] for y in v]
    got = field.at_uv(u * scale - 0.5, (v * scale - 0.5)[:, None])
    if scale == 1.0:  # else the last bit is lost on the way
        assert np.array_equal(got, expected)
    assert np.array_equal(got[:24, :32], mask)
    assert np.array_equal(got, field.at(np.stack(np.meshgrid(u * scale - 0.5, v * scale - 0.5), axis=-1)))


def test_a_post_right_before_the_camera_is_not_the_field(rng):
    light = turf(rng, top=200)
    light[:, 200:470] = (6, 175, 210)
    picture = exposed(light, rng)
    assert find_turf(picture).at(np.array([330.0, 100.0]))
    found = find_turf(picture, FieldColours((COLOURS["yellow"],)))
    assert found.at(np.array([100.0, 400.0]))
    assert not found.at(np.array([330.0, 400.0]))


def test_turf_of_the_posts_own_hue_is_found_where_there_is_no_other(rng):
    found = find_turf(exposed(turf(rng, colour=(40, 130, 130), top=120), rng), FieldColours(((220, 215, 70),)))
    assert found.mask.mean() > 0.7


def test_somebody_in_green_behind_the_field_does_not_raise_its_border(rng):
    light = turf(rng, top=200)
    light[20:205, 300:360] = (50, 140, 60)
    found = find_turf(exposed(light, rng))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], 199.5, atol=6.0)


def test_turf_between_two_robots_reaches_as_far_as_it_does(rng):
    light = turf(rng, top=100)
    light[60:420, 180:260] = light[60:420, 310:400] = (40, 40, 45)
    found = find_turf(exposed(light, rng))
    assert found.boundary_px is not None
    assert np.allclose(found.boundary_px[:, 1], 99.5, atol=6.0)
