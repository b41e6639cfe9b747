# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chi-squared probabilities and quantiles, and the one false-alarm probability of all checks.

SciPy has both; importing ``scipy.special`` takes longer than a calibration. The probability is the
incomplete gamma function, as a series or a continued fraction (W. H. Press et al., "Numerical
Recipes", 3rd edition, 2007, section 6.2); the quantile starts from E. B. Wilson, M. M. Hilferty,
"The Distribution of Chi-Square", PNAS 17(12), 1931, doi:10.1073/pnas.17.12.684, and is refined by
Newton's method.
"""

from __future__ import annotations

from functools import lru_cache
import math

# How often a check may raise a finding about data that have nothing wrong with them.
FALSE_ALARM = 1e-3

_PRECISION = 1e-16
_MAX_TERMS = 10_000
_MAX_REFINEMENTS = 100


def exceedance(value: float, degrees_of_freedom: float) -> float:
    """Return the probability that a chi-squared variable exceeds a value."""
    if value <= 0:
        return 1.0
    shape, x = 0.5 * degrees_of_freedom, 0.5 * value
    scale = math.exp(shape * math.log(x) - x - math.lgamma(shape))
    if x < shape + 1:
        return 1.0 - scale * _series(shape, x)
    return scale * _continued_fraction(shape, x)


@lru_cache(maxsize=256)
def quantile(degrees_of_freedom: float, probability: float = FALSE_ALARM) -> float:
    """Return the value that a chi-squared variable exceeds with a probability in (0, 1)."""
    k = float(degrees_of_freedom)
    share = 2.0 / (9.0 * k)
    value = max(k * (1.0 - share + _normal_quantile(probability) * math.sqrt(share))**3, 1e-6 * k)
    for _ in range(_MAX_REFINEMENTS):
        found = exceedance(value, k)
        log_density = ((0.5 * k - 1.0) * math.log(0.5 * value) - 0.5 * value
                       - math.lgamma(0.5 * k) - math.log(2.0))
        # Newton on the logarithm of the probability: nearly linear far out, and never negative.
        slope = -math.exp(log_density) / found
        step = (math.log(found) - math.log(probability)) / slope
        following = value - step if step < value else 0.5 * value
        if abs(following - value) <= 1e-14 * value:
            return following
        value = following
    return value


def _normal_quantile(probability: float) -> float:
    """Return the value that a normal variable exceeds, to 5e-4 (Abramowitz, Stegun 26.2.23)."""
    t = math.sqrt(-2.0 * math.log(min(probability, 1.0 - probability)))
    value = t - (2.515517 + t * (0.802853 + 0.010328 * t)) / (
        1.0 + t * (1.432788 + t * (0.189269 + 0.001308 * t)))
    return value if probability < 0.5 else -value


def _series(shape: float, x: float) -> float:
    term = total = 1.0 / shape
    for n in range(1, _MAX_TERMS):
        term *= x / (shape + n)
        total += term
        if term < _PRECISION * total:
            break
    return total


def _continued_fraction(shape: float, x: float) -> float:
    """Return the fraction by Lentz's method."""
    tiny = 1e-300
    b = x + 1.0 - shape
    c, d = 1.0 / tiny, 1.0 / b
    total = d
    for n in range(1, _MAX_TERMS):
        a = -n * (n - shape)
        b += 2.0
        d = 1.0 / (a * d + b or tiny)
        c = b + a / c or tiny
        total *= d * c
        if abs(d * c - 1.0) < 2 * _PRECISION:
            break
    return total
