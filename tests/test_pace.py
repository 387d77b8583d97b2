from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from logs.pace import Pace


def measured(stamps):
    pace = Pace()
    for stamp_ns in stamps:
        pace.add(stamp_ns)
    return pace.measured()


def test_no_stamps_have_no_pace():
    assert measured([]) is None


@given(st.lists(st.integers(0, 2**64 - 1), min_size=2, max_size=50))
def test_the_pace_is_that_of_the_stamps_in_their_order(stamps):
    first, last, rate_hz, gap_s = measured(stamps)
    ordered = sorted(stamps)
    assert (first, last) == (ordered[0], ordered[-1])
    gaps = [b - a for a, b in pairwise(ordered)]
    assert np.isclose(gap_s, max(gaps) / 1e9)
    assert rate_hz is None if first == last else np.isclose(rate_hz, len(gaps) / ((last - first) / 1e9))


def test_many_stamps_a_little_out_of_order_lose_nothing():
    stamps = np.arange(300_000) * 10**7
    stamps[200_000:] += 5 * 10**9
    shuffled = stamps[np.argsort(stamps + np.random.default_rng(1).integers(0, 10**9, len(stamps)))]
    assert shuffled.tolist() != stamps.tolist()
    first, last, rate_hz, gap_s = measured(shuffled.tolist())
    assert (first, last, round(gap_s, 9)) == (0, int(stamps[-1]), 5.01)
    assert np.isclose(rate_hz, (len(stamps) - 1) / (stamps[-1] / 1e9))
