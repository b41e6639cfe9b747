# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Our chi-squared, F and Student's functions agree with SciPy's."""

import pytest
from scipy.stats import chi2, f, t

from trajectory_calibration.geometry import chi_squared


@pytest.mark.parametrize('k', [1, 2, 3, 6, 9, 30, 300, 5000])
def test_probabilities_and_quantiles_are_those_of_scipy(k):
    for probability in (0.99, 0.5, 0.05, 1e-3, 1e-6, 1e-12):
        value = chi_squared.quantile(k, probability)
        assert value == pytest.approx(chi2.isf(probability, k), rel=1e-10)
        assert chi_squared.exceedance(value, k) == pytest.approx(probability, rel=1e-9)
    for value in (1e-3, 0.3 * k, k, 1.2 * k, 3 * k):
        assert chi_squared.exceedance(value, k) == pytest.approx(
            chi2.sf(value, k), rel=1e-10, abs=1e-300)


def test_the_default_probability_is_the_stated_false_alarm():
    assert chi_squared.quantile(3) == pytest.approx(chi2.isf(chi_squared.FALSE_ALARM, 3))
    assert chi_squared.exceedance(-1.0, 3) == 1.0


@pytest.mark.parametrize('k', [1, 2, 3, 4, 9, 22, 101])
def test_quantiles_of_student_are_those_of_scipy(k):
    for probability in (0.5, 0.05, 1e-3, 1e-6, 1e-8):
        assert chi_squared.student_quantile(k, probability) == pytest.approx(
            t.isf(probability / 2, k), rel=1e-6)


@pytest.mark.parametrize('of_noise', [1, 3.5, 24, 96, 5000])
@pytest.mark.parametrize('k', [1, 2, 5, 6])
def test_probabilities_of_a_ratio_are_those_of_scipy(k, of_noise):
    for value in (0.01, 1.0, 6.0, 33.0, 400.0):
        assert chi_squared.exceedance_of_ratio(value, k, of_noise) == pytest.approx(
            f.sf(value / k, k, of_noise), rel=1e-9)
    assert chi_squared.exceedance_of_ratio(-1.0, k, of_noise) == 1.0
