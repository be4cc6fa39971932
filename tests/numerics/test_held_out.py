"""The jackknife against the standard deviation of a mean, which it gives exactly."""

import numpy as np
import pytest

from strainwave.numerics.statistics import jackknife_std


def test_the_jackknife_of_a_mean_is_its_standard_deviation() -> None:
    values = np.random.default_rng(0).normal(size=12)
    without_one = (values.sum() - values) / (len(values) - 1)
    records = [str(k) for k in range(len(values))]
    expected = values.std(ddof=1) / np.sqrt(len(values))
    assert jackknife_std(without_one[:, None], records)[0] == pytest.approx(expected, rel=1e-12)


def test_errors_that_a_record_shares_count() -> None:
    """Stretches of a record that err alike tell no more than one of them."""
    values = np.repeat(np.random.default_rng(1).normal(size=6), 10)
    without_one = (values.sum() - values) / (len(values) - 1)
    of_stretches = jackknife_std(without_one[:, None], [str(k) for k in range(len(values))])
    of_records = jackknife_std(without_one[:, None], [str(k // 10) for k in range(len(values))])
    # ten times the effect of a stretch in six records instead of sixty stretches
    expected = np.sqrt(10.0 * (5.0 / 6.0) / (59.0 / 60.0))
    assert of_records[0] / of_stretches[0] == pytest.approx(expected, rel=1e-9)
