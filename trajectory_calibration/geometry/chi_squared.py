# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chi-squared, Fisher's F and Student's t, and the one false-alarm probability of all checks.

SciPy has them; importing ``scipy.special`` takes longer than a calibration. For whole degrees of
freedom chi-squared is a finite sum, and F an incomplete beta function: M. Abramowitz, I. A.
Stegun, "Handbook of Mathematical Functions", 1964, 26.4.4, 26.4.5, 26.5.8 and 26.6.2.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
import math

# Probability of a finding for sound data.
FALSE_ALARM = 1e-3


def exceedance(value: float, degrees_of_freedom: int) -> float:
    """Return the probability that a chi-squared variable exceeds a value.

    1 if the value is NaN or there are no degrees of freedom.
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


def exceedance_of_ratio(value: float, degrees_of_freedom: int, of_noise: float) -> float:
    """Return the probability that a sum of squares, over an estimated variance, exceeds a value.

    The variance was estimated with ``of_noise`` degrees of freedom. ``value`` is then the number
    of degrees of freedom times a variable with Fisher's F distribution.
    """
    a, b = 0.5 * of_noise, 0.5 * degrees_of_freedom
    x = of_noise / (of_noise + max(value, 0.0))
    # The continued fraction of the incomplete beta function converges fast on one side.
    return _beta(a, b, x) if x < (a + 1) / (a + b + 2) else 1.0 - _beta(b, a, 1.0 - x)


def _beta(a: float, b: float, x: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b), where its fraction converges."""
    if x <= 0:
        return 0.0
    fraction = 0.0
    # With half of these terms the error is below 1e-9.
    for m in range(50, 0, -1):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        fraction = even / (1 + odd / (1 + fraction))
    first = -(a + b) * x / (a + 1)
    front = a * math.log(x) + b * math.log1p(-x) + (
        math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b))
    return math.exp(front) / a / (1 + first / (1 + fraction))


@lru_cache(maxsize=256)
def student_quantile(degrees_of_freedom: int, probability: float = FALSE_ALARM) -> float:
    """Return the value that the size of Student's t exceeds with a probability in (0, 1)."""
    low, high = 0.0, 1.0
    while exceedance_of_ratio(high, 1, degrees_of_freedom) > probability:
        low, high = high, 2 * high
    return math.sqrt(_bisected(low, high, lambda square: exceedance_of_ratio(
        square, 1, degrees_of_freedom) > probability))


def _bisected(low: float, high: float, above: Callable[[float], bool]) -> float:
    """Return where a test, true at the low end, begins to fail: by halves, to the last digit."""
    while low < (middle := 0.5 * (low + high)) < high:
        if above(middle):
            low = middle
        else:
            high = middle
    return high
