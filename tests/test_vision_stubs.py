"""What the picture's border leaves of a line that meets another one, in drawn pictures and in rendered ones."""

import numpy as np
import pytest
from turf_drawings import exposed, turf, with_stripe

from fieldloc.field import load_field
from fieldloc.render import render_with_truth
from fieldloc.render.random_views import random_view
from fieldloc.vision.detect import detect
from fieldloc.vision.detections import SeenLine

LONG = np.array([[-30.0, 430.0], [670.0, 450.0]])


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def beside(lines: tuple[SeenLine, ...], other: SeenLine) -> tuple[SeenLine, ...]:
    return tuple(line for line in lines if line is not other)


def across(line: SeenLine, first, last):
    """(2,) how far the line's ends are off the line through two points, (2, 2) the covariance claimed for that."""
    along = (last - first) / np.linalg.norm(last - first)
    gain = np.kron(np.eye(2), np.array([-along[1], along[0]]))
    return (line.ends_px - first) @ np.array([-along[1], along[0]]), gain @ line.covariance_px2 @ gain.T


@pytest.mark.parametrize("lean", [-0.6, -0.3, 0.0, 0.3, 0.6])
def test_what_the_border_leaves_of_a_line_that_meets_another_is_a_line(rng, lean):
    first = np.array([330.0, 440.0])
    last = first + 60.0 * np.array([lean, 1.0])
    light = with_stripe(turf(rng), *LONG, (14.0, 14.0))
    found = detect(exposed(with_stripe(light, first, last, (15.0, 15.0)), rng)).lines
    longest = max(found, key=lambda line: float(np.ptp(line.ends_px[:, 0])))
    (stub,) = beside(found, longest)
    off, covariance = across(stub, first, last)
    assert np.abs(off).max() < 0.7
    assert off @ np.linalg.solve(covariance, off) < 16.0
    assert stub.width_px == pytest.approx(15.0, rel=0.1)


@pytest.mark.parametrize("last", [(330.0, 468.0), (330.0, 410.0)])
def test_what_does_not_reach_the_border_is_no_stub(rng, last):
    light = with_stripe(turf(rng), *LONG, (14.0, 14.0))
    light = with_stripe(light, np.array([330.0, 440.0]), np.array(last), (15.0, 15.0))
    assert len(detect(exposed(light, rng)).lines) == 1


def test_what_goes_on_beyond_the_line_as_a_nets_cords_do_is_no_stub(rng):
    light = with_stripe(turf(rng), *LONG, (5.0, 5.0))
    light = with_stripe(light, np.array([330.0, 405.0]), np.array([334.0, 500.0]), (5.0, 5.0))
    assert len(detect(exposed(light, rng)).lines) == 1


def test_what_is_not_as_bright_as_the_line_is_no_stub(rng):
    light = with_stripe(turf(rng), np.array([330.0, 440.0]), np.array([330.0, 500.0]), (15.0, 15.0))
    light[:] = 0.45 * light + 0.55 * np.array((50.0, 140.0, 60.0))
    light = with_stripe(light, *LONG, (14.0, 14.0))
    assert len(detect(exposed(light, rng)).lines) == 1


@pytest.mark.parametrize(("name", "seed"), [("kidsize-2014", 1013), ("spl", 1108), ("spl", 1039)])
def test_a_rendered_view_of_one_line_and_a_stub_shows_both_where_they_are(name, seed):
    field, random = load_field(name), np.random.default_rng([seed, *name.encode()])
    view = random_view(field, random)
    picture, truth = render_with_truth(view.scene, view.camera, field, view.mount, view.pose, random)
    found = detect(picture, field.colours, view.camera).lines
    assert len(found) == 2
    for line in found:
        offs = [across(line, *true.ends_px) for true in truth.lines]
        off, covariance = min(offs, key=lambda pair: float(np.abs(pair[0]).max()))
        assert off @ np.linalg.solve(covariance, off) < 16.0
