"""Measurements become mixtures: what is used, what is counted as useless, what is refused, what is old news."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_scene import CAMERA, MOUNT, see
from scipy.stats import chi2
from walks import ALL_NEWS, FIELD, POSITIONS, ns, scan

from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.fixes.landmarks import landmark_fix
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, LineObservation
from fieldloc.mixture import MixtureFactor
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation
from fieldloc.scan_fits import CHI2_LIMITS

POSE = np.array([0.5, -1.0, 2.5])
SENSOR = np.array([0.2, -0.1, 0.7])
SURE = np.diag([0.05, 0.05, 0.03]) ** 2

poses = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-7, 7)).map(np.array)


def rows(whole: LandmarkScan, chosen: list[int], labels: list[str | None] | None = None) -> LandmarkScan:
    """A part of a scan, with other labels if given."""
    kept = tuple(whole.labels[i] for i in chosen) if labels is None else tuple(labels)
    return LandmarkScan(
        whole.stamp_ns, kept, whole.range_bearing[chosen], whole.covariance[chosen], whole.robot_from_sensor
    )


def everything(pose: FloatArray = POSE, noisy: bool = True, mount: FloatArray | None = None) -> LandmarkScan:
    """All six posts from a pose."""
    return scan(3, pose, np.random.default_rng(5), max_range_m=99.0, noisy=noisy, mount=mount)


def likeliest(mixture: MixtureFactor | None, pose: FloatArray = POSE) -> tuple[Factor, ...]:
    """The factors of its best solution about a pose."""
    assert mixture is not None
    seen = mixture.expand(pose[None], SURE[None])
    return mixture.chosen(int(seen.ids[np.argmax(seen.evidence)]))


def assert_same(one: Factor, other: Factor) -> None:
    assert type(one) is type(other)
    assert one.stamp_ns == other.stamp_ns
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9)
    at = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(one.error(at), other.error(at), atol=1e-9)


# -- what is used ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 3, 6])
def test_two_or_more_known_landmarks_are_their_fix(count: int) -> None:
    made = rows(everything(mount=SENSOR), list(range(count)))
    (factor,) = likeliest(MixtureBuilder(FIELD).build(made))
    (fix,) = landmark_fix(
        POSITIONS[:count], made.range_bearing, made.covariance, np.zeros((count, 2, 2)), robot_from_sensor=SENSOR
    )
    assert_same(factor, PoseFactor.from_fix(3, fix))


@settings(deadline=None, max_examples=25)
@given(pose=poses, mounted=st.booleans(), labelled=st.booleans())
def test_what_is_likeliest_where_a_scan_was_made_has_no_error_there(
    pose: FloatArray, mounted: bool, labelled: bool
) -> None:
    whole = everything(pose, noisy=False, mount=SENSOR if mounted else np.zeros(3))
    for chosen in ([0], [0, 1], [1, 2, 4, 5]):
        made = rows(whole, chosen, None if labelled else [None] * len(chosen))
        for factor in likeliest(MixtureBuilder(FIELD).build(made), pose):
            np.testing.assert_allclose(factor.error(pose), 0.0, atol=1e-6)


@pytest.mark.parametrize("wrong", range(4))
def test_a_wrongly_labelled_landmark_among_others_is_left_out(wrong: int) -> None:
    whole = everything()
    labels: list[str | None] = list(whole.labels[:4])
    labels[wrong] = "5" if wrong % 2 else "4"
    (factor,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, [0, 1, 2, 3], labels)))
    right = [i for i in range(4) if i != wrong]
    (expected,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, right)))
    assert_same(factor, expected)


def test_a_good_scan_is_taken_apart_once_in_ten_thousand() -> None:
    limits = [chi2.isf(1e-4, 2 * n - 3) for n in range(2, 10)]
    np.testing.assert_allclose(CHI2_LIMITS, limits, atol=0.01)


def test_two_landmarks_that_leave_a_banana_stay_single() -> None:
    # half a metre apart at 3 m with 5 cm of noise each: the position swings with the heading, so the Gaussian is none
    near = FieldMap(
        "pair",
        np.zeros((0, 2, 2)),
        np.zeros((0, 3)),
        tuple(Landmark(str(i), np.array([3.0, y]), 0.02, np.zeros((2, 2))) for i, y in enumerate((-0.25, 0.25))),
    )
    seen = np.array([[3.01, -0.083], [3.01, 0.083]])
    made = LandmarkScan(3, ("0", "1"), seen, np.tile(np.diag([0.05, 0.03]) ** 2, (2, 1, 1)))
    (fix,) = landmark_fix(near.positions, seen, made.covariance)
    assert fix.nonlinearity > 0.5
    factors = likeliest(MixtureBuilder(near).build(made), np.zeros(3))
    assert [type(factor) for factor in factors] == [LandmarkFactor, LandmarkFactor]


def test_landmarks_without_a_label_are_those_that_the_robot_s_place_says() -> None:
    whole = everything()
    (named,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, [0, 1, 2])))
    for labels in ([None, None, None], ["0", None, None]):
        (found,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, [0, 1, 2], labels)))
        assert_same(found, named)


def test_a_compass_gives_its_heading() -> None:
    (factor,) = likeliest(MixtureBuilder(FIELD).build(Compass(4, -3.0, 0.2)))
    assert_same(factor, HeadingFactor(4, -3.0, np.array([[0.04]]), by_compass=True))


@settings(deadline=None, max_examples=25)
@given(pose=poses)
def test_an_initial_pose_keeps_its_covariance_in_field_axes(pose: FloatArray) -> None:
    covariance = np.array([[0.09, 0.01, 0.002], [0.01, 0.04, -0.003], [0.002, -0.003, 0.01]])
    (factor,) = likeliest(MixtureBuilder(FIELD).build(InitialPose(4, pose, covariance)), pose)
    assert isinstance(factor, PoseFactor)
    np.testing.assert_array_equal(factor.pose, pose)
    np.testing.assert_allclose(se2.rotate_covariance(factor.covariance, pose[2]), covariance, atol=1e-12)


# -- what is useless ---------------------------------------------------------------------------------------------------


def test_a_label_that_is_not_on_the_map_is_counted_and_left_out() -> None:
    builder = MixtureBuilder(FIELD)
    assert builder.warnings() == ()
    whole = everything()
    (factor,) = likeliest(builder.build(rows(whole, [0, 1, 2], ["0", "1", "tree"])))
    (expected,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, [0, 1])))
    assert_same(factor, expected)
    assert builder.build(rows(whole, [2], ["lamp"])) is None
    assert builder.build(rows(whole, [2], ["tree"])) is None
    (warning,) = builder.warnings()
    assert warning == "3 observations left out: landmark lamp, tree is not on the map six posts"


def test_images_without_a_camera_are_counted() -> None:
    builder = MixtureBuilder(FIELD)
    assert builder.build(ImageFeatures(0, MOUNT)) is None
    assert builder.warnings() == ("1 images left out: the log says nothing about the camera",)


def test_what_shows_nothing_is_no_mixture_and_no_reason_to_warn() -> None:
    builder = MixtureBuilder(FIELD, CAMERA)
    assert builder.build(LandmarkScan(3, (), np.zeros((0, 2)), np.zeros((0, 2, 2)))) is None
    assert builder.build(ImageFeatures(0, MOUNT)) is None
    assert builder.warnings() == ()


def test_a_landmark_whose_numbers_are_missing_is_left_out() -> None:
    whole = rows(everything(), [0, 1, 2])
    for missing in (np.nan, np.inf):
        numbers = whole.range_bearing.copy()
        numbers[2, 0] = missing
        (factor,) = likeliest(MixtureBuilder(FIELD).build(replace(whole, range_bearing=numbers)))
        (expected,) = likeliest(MixtureBuilder(FIELD).build(rows(whole, [0, 1])))
        assert_same(factor, expected)


# -- what is refused ---------------------------------------------------------------------------------------------------


def absurd() -> dict[str, LandmarkScan | ImageFeatures | Compass | InitialPose]:
    one = rows(everything(), [0])
    image = see(load_field("kidsize"), np.array([0.5, 0.2, 0.05]), 0, np.random.default_rng(1), 0.0)
    far_post = replace(image.posts[0], edges_px=image.posts[0].edges_px * 1e200)
    far_line = LineObservation(image.lines[0].ends_px - 1e8, image.lines[0].covariance_px2)
    return {
        r"range of 1e\+300": replace(one, range_bearing=np.array([[1e300, 0.0]])),
        r"bearing of 1e\+07": replace(one, range_bearing=np.array([[1.0, -1e7]])),
        r"covariance of 1e\+160": replace(one, covariance=1e160 * np.eye(2)[None]),
        r"place of the sensor of 1e\+08": replace(one, robot_from_sensor=np.array([0.0, -1e8, 0.0])),
        r"pixel of .*e\+202": replace(image, posts=(image.posts[1], far_post)),
        r"pixel of 1e\+08": replace(image, lines=(far_line,)),
        r"place of the camera of 1e\+09": replace(image, mount=replace(MOUNT, height_m=1e9)),
        r"attitude of the camera of 1e\+09": replace(image, mount=replace(MOUNT, pan_rad=1e9)),
        r"heading of nan": Compass(0, np.nan, 0.1),
        r"standard deviation of inf": Compass(0, 0.0, np.inf),
        r"pose of 2e\+06": InitialPose(0, np.array([2e6, 0.0, 0.0]), np.eye(3)),
        r"covariance of nan": InitialPose(0, np.zeros(3), np.full((3, 3), np.nan)),
    }


@pytest.mark.parametrize("why", absurd())
def test_numbers_that_no_sensor_can_mean_are_refused_before_they_overflow(why: str) -> None:
    with pytest.raises(ValueError, match=f"^{why}.* is no measurement: it is beyond 1e"):
        MixtureBuilder(load_field("kidsize"), CAMERA).build(absurd()[why])


def test_who_is_told_a_pose_with_no_idea_of_the_heading_is_not_refused() -> None:
    """Drivers write a million or so for a variance that they do not know."""
    told = InitialPose(0, np.zeros(3), np.diag([0.01, 0.01, 1e9]))
    assert MixtureBuilder(FIELD).build(told) is not None


# -- what is old news --------------------------------------------------------------------------------------------------


def test_a_landmark_seen_again_a_moment_later_is_little_news() -> None:
    builder = MixtureBuilder(FIELD, correlation=ErrorCorrelation(range_s=2.0, bearing_s=0.5))
    first = LandmarkScan(0, ("0",), np.array([[2.0, 0.0]]), np.diag([0.1, 0.02])[None] ** 2)
    again = replace(first, stamp_ns=ns(0.5))
    other = replace(first, labels=("1",), stamp_ns=ns(0.6))
    later = replace(first, stamp_ns=ns(60.0))
    # straight ahead: range along x, bearing across, 2 m away
    plain = np.array([0.1**2, (2.0 * 0.02) ** 2])
    wider = [float(inflation(np.array(0.5), tau)) for tau in (2.0, 0.5)]

    def covariance(made: LandmarkScan) -> FloatArray:
        """Of what is seen by a robot that sees it where it is, and remembers."""
        assert made.labels[0] is not None
        pose = np.array([*(POSITIONS[int(made.labels[0])] - [2.0, 0.0]), 0.0])
        mixture = builder.build(made)
        (factor,) = likeliest(mixture, pose)
        assert isinstance(factor, LandmarkFactor)
        assert mixture is not None
        builder.remember(made, mixture, pose)
        return factor.covariance

    for made, expected in ((first, plain), (again, plain * wider), (other, plain), (later, plain)):
        np.testing.assert_allclose(covariance(made), np.diag(expected), rtol=1e-6, atol=1e-12)
    at_once = covariance(later)
    assert np.isfinite(at_once).all()
    assert at_once[0, 0] > 100 * plain[0]


def test_what_nobody_knows_the_landmark_of_is_no_old_news() -> None:
    builder = MixtureBuilder(FIELD)
    for _ in range(2):
        scan = rows(everything(), [0])
        mixture = builder.build(scan)
        assert mixture is not None
        (factor,) = likeliest(mixture)
        (expected,) = likeliest(MixtureBuilder(FIELD).build(rows(everything(), [0])))
        assert_same(factor, expected)
        builder.remember(scan, mixture, None)


def test_with_no_correlation_all_is_news() -> None:
    builder = MixtureBuilder(FIELD, correlation=ALL_NEWS)
    results = []
    for _ in range(2):
        scan = everything()
        mixture = builder.build(scan)
        results += likeliest(mixture)
        assert mixture is not None
        builder.remember(scan, mixture, POSE)
    assert_same(*results)
