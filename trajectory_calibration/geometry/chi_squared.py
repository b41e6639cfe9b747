# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles of chi-squared and Student's t, and the one false-alarm probability of all checks.

SciPy has them; importing ``scipy.special`` takes longer than a calibration. For whole degrees of
freedom the probabilities are finite sums: M. Abramowitz, I. A. Stegun, "Handbook of Mathematical
Functions", 1964, 26.4.4, 26.4.5, 26.7.3 and 26.7.4.
"""

from __future__ import annotations

from collections.abc import Callable
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
    return _bisected(low, high, lambda value: exceedance(value, degrees_of_freedom) > probability)


@lru_cache(maxsize=256)
def student_quantile(degrees_of_freedom: int, probability: float = FALSE_ALARM) -> float:
    """Return the value that the size of Student's t exceeds with a probability in (0, 1)."""
    odd = degrees_of_freedom % 2

    def exceeds(angle: float) -> bool:
        cosine = math.cos(angle)
        term, total = cosine if odd else 1.0, 0.0
        for k in range(odd, degrees_of_freedom - 1, 2):
            total += term
            term *= (k + 1) / (k + 2) * cosine**2
        total *= math.sin(angle)
        return 1 - (2 / math.pi * (angle + total) if odd else total) > probability

    return math.sqrt(degrees_of_freedom) * math.tan(_bisected(0.0, math.pi / 2, exceeds))


def _bisected(low: float, high: float, above: Callable[[float], bool]) -> float:
    """Return where a test, true at the low end, begins to fail: by halves, to the last digit."""
    while low < (middle := 0.5 * (low + high)) < high:
        if above(middle):
            low = middle
        else:
            high = middle
    return high
