import math

import numpy as np
import pytest

from fieldloc.vision.stripes import HIGHEST, LOWEST, middle_shift
from fieldloc.vision.turf import Turf

HEIGHT, BLUR_PX = 480, 2.35
BORDER = 100.0
TURF = Turf(
    np.ones((240, 320), np.bool_), np.array([2.0, 2.0]), np.array([[-0.5, BORDER], [639.5, BORDER]]), np.zeros(3)
)


@pytest.mark.parametrize("angle", [0.1, 0.8, 1.5, 2.6])
@pytest.mark.parametrize("row", [140.0, 300.0, 460.0])
@pytest.mark.parametrize("width", [6.0, 20.0])
def test_the_middle_of_a_stripe_is_where_perspective_puts_it(angle, row, width):
    normal = np.array([math.cos(angle), math.sin(angle)])
    horizon = BORDER - math.sqrt(LOWEST * HIGHEST) * HEIGHT
    depth = row - horizon
    half = 0.5 * math.sqrt(width**2 - BLUR_PX**2)
    # What is at t along the normal in the picture is at t / (depth + t n) on the ground, but for a factor.
    nearer, farther = (t / (depth + t * normal[1]) for t in (half, -half))
    middle = 0.5 * (nearer + farther)
    exact = middle * depth / (1.0 - middle * normal[1])
    shift, sigma = middle_shift(np.array([[320.0, row]]), normal[None], np.array([width]), TURF, HEIGHT)
    assert shift[0] == pytest.approx(exact, rel=0.05)
    assert 0.0 < sigma[0] < 0.6 * abs(shift[0])


def test_the_standard_deviation_covers_most_heights_of_the_horizon():
    pixel, normal, width = np.array([[320.0, 300.0]]), np.array([[0.0, 1.0]]), np.array([20.0])
    shift, sigma = middle_shift(pixel, normal, width, TURF, HEIGHT)
    heights = HEIGHT * np.exp(np.linspace(math.log(LOWEST), math.log(HIGHEST), 101))
    true = -0.25 * (20.0**2 - BLUR_PX**2) / (200.0 + heights)
    off = (true - shift) / sigma
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.2)


def test_what_is_no_wider_than_blur_stays_where_it_is():
    shift, sigma = middle_shift(np.full((2, 2), 200.0), np.eye(2), np.array([2.0, 0.0]), TURF, HEIGHT)
    assert (shift == 0.0).all()
    assert (sigma == 0.0).all()
