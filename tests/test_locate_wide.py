"""Views that leave much open: posteriors in pieces, heights and attitudes far off their priors, posts that are none."""

from dataclasses import replace

import numpy as np
from seen_scenes import NAO, Look, Scene, off

from fieldloc.field import load_field
from fieldloc.locate import CameraPrior, Located, locate
from fieldloc.locate.windows import Windows, cut
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import Detections

FIELD = load_field("spl")
JUNCTION = Look(np.array([-1.4, -0.2, 1.35]), 0.52, 0.3, 0.0)  # the touch line, and the halfway line that ends there
GOAL = Look(np.array([1.6, 0.7, -0.1]), 0.5, 0.22, 0.03)


def told(look: Look, height_m: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> CameraPrior:
    return CameraPrior.told(
        look.height_m + height_m, look.pitch_rad + np.radians(pitch_deg), look.roll_rad + np.radians(roll_deg)
    )


def two_lines(seed: int) -> Detections:
    seen = Scene(NAO, FIELD, np.random.default_rng(seed)).seen(JUNCTION, circles=False, posts=False)
    longest = sorted(seen.lines, key=lambda line: -float(np.linalg.norm(line.ends_px[1] - line.ends_px[0])))
    return replace(seen, lines=tuple(longest[:2]))


def errors(located: Located, look: Look) -> list[FloatArray]:
    return [off(one.pose, look.pose, FIELD.symmetries) for one in located.hypotheses]


def test_the_pieces_of_a_wide_posterior_add_up_to_it() -> None:
    covariance = np.diag([0.8, 0.02, 0.05, 0.03, 0.05, 0.05]) ** 2
    covariance[0, 4] = covariance[4, 0] = 0.9 * 0.8 * 0.05
    state = np.array([[1.0, 2.0, 0.1, 0.5, 0.2, 0.0]])
    pieces, windows, parents = cut(state, covariance[None], np.array([0]))
    assert len(pieces) > 4
    assert (parents == 0).all()
    # along the posterior, from two standard deviations before its middle to two after it
    for x in np.linspace(-0.6, 2.6, 41):
        at = np.tile([x, 2.0, 0.0, 0.0, 0.0, 0.0], (len(pieces), 1))
        assert abs(np.exp(windows.logs(at)).sum() - 1.0) < 0.01
    # a piece that lies farther along has the pitch that goes with it
    np.testing.assert_allclose(pieces[:, 4] - 0.2, covariance[4, 0] / 0.64 * (pieces[:, 0] - 1.0), atol=1e-12)


def test_what_is_narrow_or_endless_is_left_whole() -> None:
    covariances = np.stack([np.diag([sigma, 0.01, 0.1, 0.1, 0.1, 0.1]) ** 2 for sigma in (0.05, 4.0)])
    pieces, windows, _ = cut(np.zeros((2, 6)), covariances, np.arange(2))
    assert len(pieces) == 0
    assert len(windows.centre) == 0


def test_no_windows_change_nothing() -> None:
    windows = Windows.none(3)
    assert (windows.logs(np.ones((3, 6))) == 0.0).all()
    assert (windows.rows == 0.0).all()


def test_two_lines_and_a_wrong_attitude_have_the_truth_among_their_pieces() -> None:
    near = 0
    for seed, (height_m, pitch_deg, roll_deg) in enumerate([(0, 5, 0), (0.05, -4, 3), (-0.05, 3, -4), (0, 0, 5)]):
        located = locate(two_lines(seed), NAO, FIELD, told(JUNCTION, height_m, pitch_deg, roll_deg))
        offs = errors(located, JUNCTION)
        near += min(float(np.hypot(x, y)) for x, y, _ in offs) < 0.3  # the pieces are that far apart
        squares = [e @ np.linalg.solve(h.covariance, e) for e, h in zip(offs, located.hypotheses, strict=True)]
        assert min(squares) < 16.0
    assert near >= 3


def test_a_net_that_is_thinner_than_any_line_of_the_field_is_no_line() -> None:
    seen = Scene(NAO, FIELD, np.random.default_rng(4)).seen(GOAL, posts=False)
    behind = Look(np.array([2.2, 0.3, -0.1]), GOAL.height_m, GOAL.pitch_rad, GOAL.roll_rad)
    # the lines of a place nearby, all as thin as cords, stand for what of a net lies on the ground, along the grid
    cords = Scene(NAO, FIELD, np.random.default_rng(5)).seen(behind, circles=False, posts=False).lines
    net = tuple(replace(one, width_px=np.full(2, 2.0), width_sigma_px=np.full(2, 0.3)) for one in cords)
    located = locate(replace(seen, lines=seen.lines + net), NAO, FIELD, told(GOAL))
    x, y, _ = errors(located, GOAL)[0]
    assert np.hypot(x, y) < 0.05
    assert 2.0 * located.hypotheses[0].probability > 0.99  # were they lines, it would be 0.7


def test_a_height_far_off_its_prior_spoils_nothing() -> None:
    detections = Scene(NAO, FIELD, np.random.default_rng(3)).seen(GOAL, posts=False)
    for height_m in (-0.08, 0.08):  # two and a half standard deviations, a sixth of all distances
        x, y, _ = errors(locate(detections, NAO, FIELD, told(GOAL, height_m)), GOAL)[0]
        assert np.hypot(x, y) < 0.05


def test_a_post_that_is_none_does_not_pull_the_pose_from_where_lines_have_it() -> None:
    seen = Scene(NAO, FIELD, np.random.default_rng(4)).seen(GOAL)
    assert len(seen.posts) == 2
    # seven centimetres beside the right post, as sharp as the post would be
    aside = np.array([14.0, 0.0])
    false = replace(seen.posts[0], left_px=seen.posts[0].left_px + aside, right_px=seen.posts[0].right_px + aside)
    false = replace(false, foot_px=None, foot_covariance_px2=None)
    located = locate(replace(seen, posts=(false,)), NAO, FIELD, told(GOAL))
    x, y, heading = errors(located, GOAL)[0]
    assert np.hypot(x, y) < 0.03
    assert abs(heading) < np.radians(0.3)


def test_a_line_taken_for_its_neighbour_does_not_keep_the_pose_from_where_the_others_have_it() -> None:
    seen = Scene(NAO, FIELD, np.random.default_rng(4)).seen(GOAL, posts=False)
    longest = max(seen.lines, key=lambda line: float(np.linalg.norm(line.ends_px[1] - line.ends_px[0])))
    # white beside a line, as a shoe's sole is, so near that it passes for the line while the camera's turn is rough
    aside = replace(longest, ends_px=longest.ends_px + np.array([0.0, 9.0]))
    for pitch_deg in (-3.0, 3.0):
        located = locate(replace(seen, lines=(*seen.lines, aside)), NAO, FIELD, told(GOAL, 0.0, pitch_deg))
        x, y, _ = errors(located, GOAL)[0]
        assert np.hypot(x, y) < 0.05
