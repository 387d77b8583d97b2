import numpy as np
import pytest

from fieldloc.repetition import inflation


def test_what_alike_errors_leave_of_the_news_is_as_much_as_their_mean_says() -> None:
    # errors that decay with exp(-t / 2 s), seen every 0.5 s: the mean of many is as uncertain as n / inflation of them
    rho, count = np.exp(-0.5 / 2.0), 4000
    random = np.random.default_rng(0)
    errors = random.standard_normal(2000)
    total = np.zeros(2000)
    for _ in range(count):
        total += errors
        errors = rho * errors + np.sqrt(1.0 - rho**2) * random.standard_normal(2000)
    wider = float(inflation(np.array(0.5), 2.0))
    # standard error of a sampled variance: sqrt(2 / 2000) = 3 %; four of these
    assert np.var(total / count) * count == pytest.approx(wider, rel=0.13)
