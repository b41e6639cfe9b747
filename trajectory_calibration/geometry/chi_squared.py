# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chi-squared probabilities and quantiles, and the one false-alarm probability of all checks.

SciPy has both; importing ``scipy.special`` takes longer than a calibration. For whole degrees of
freedom the probability is a finite sum: M. Abramowitz, I. A. Stegun, "Handbook of Mathematical
Functions", 1964, 26.4.4 and 26.4.5.
"""

from __future__ import annotations

from functools import lru_cache
import math

# How often a check may raise a finding about data that have nothing wrong with them.
FALSE_ALARM = 1e-3


def exceedance(value: float, degrees_of_freedom: int) -> float:
    """Return the probability that a chi-squared variable exceeds a value; 1 where that is NaN.

    Without degrees of freedom nothing is told, and the probability is 1 as well.
    """
    if degrees_of_freedom <= 0 or not 0 < value < math.inf:
        return 1.0
    x, odd = 0.5 * value, degrees_of_freedom % 2
    return (math.erfc(math.sqrt(x)) if odd else 0.0) + math.fsum(
        math.exp(n * math.log(x) - x - math.lgamma(n + 1))
        for n in (0.5 * odd + k for k in range(degrees_of_freedom // 2)))


@lru_cache(maxsize=256)
def quantile(degrees_of_freedom: int, probability: float = FALSE_ALARM) -> float:
    """Return the value that a chi-squared variable exceeds with a probability in (0, 1)."""
    low, high = 0.0, float(degrees_of_freedom)
    while exceedance(high, degrees_of_freedom) > probability:
        low, high = high, 2 * high
    # By halves, down to neighbouring numbers.
    while low < (middle := 0.5 * (low + high)) < high:
        if exceedance(middle, degrees_of_freedom) > probability:
            low = middle
        else:
            high = middle
    return high
