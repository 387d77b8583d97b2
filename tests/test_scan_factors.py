import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.scan_factors import landmark_factors, seen_in_robot

MOUNT = np.array([0.2, -0.1, 0.7])
NOISE = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])


@settings(deadline=None, max_examples=50)
@given(r=st.floats(0.3, 9.0), bearing=st.floats(-3.2, 3.2), mounted=st.booleans())
def test_a_landmark_is_seen_where_its_range_and_bearing_put_it(r: float, bearing: float, mounted: bool) -> None:
    mount = MOUNT if mounted else np.zeros(3)

    def point(z: FloatArray) -> FloatArray:
        return se2.apply(mount, z[0] * np.array([np.cos(z[1]), np.sin(z[1])]))

    z = np.array([r, bearing])
    seen, covariance = seen_in_robot(LandmarkScan(1, (None,), z[None], NOISE[None], mount))
    np.testing.assert_allclose(seen, [point(z)], atol=1e-12)
    jacobian = central_difference(point, z)
    np.testing.assert_allclose(covariance, [jacobian @ NOISE @ jacobian.T], atol=1e-9)


def test_factors_are_the_landmarks_seen_with_the_largest_variance_of_the_survey() -> None:
    place, survey = np.array([3.0, 1.0]), np.array([[0.05, 0.02], [0.02, 0.02]])
    marks = tuple(Landmark(label, place, 0.1, by) for label, by in (("sure", np.zeros((2, 2))), ("unsure", survey)))
    field = FieldMap("two", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)
    made = LandmarkScan(1, (None, None), np.array([[1.0, 0.1], [2.0, 0.4]]), np.array([NOISE, NOISE]), MOUNT)
    rows, wider = np.array([1, 1]), np.array([NOISE, NOISE]) * 3.0
    exact, surveyed = landmark_factors(made, field, rows, np.array([0, 1]), wider)
    seen, covariance = seen_in_robot(made)
    np.testing.assert_allclose(exact.landmark, place)
    np.testing.assert_allclose(exact.seen, seen[1], atol=1e-12)
    np.testing.assert_allclose(exact.covariance, 3.0 * covariance[1], rtol=1e-9)
    # eigenvalues of the survey: 0.035 +- 0.025
    np.testing.assert_allclose(surveyed.covariance, exact.covariance + 0.06 * np.eye(2), atol=1e-12)
