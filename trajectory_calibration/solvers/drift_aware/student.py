# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Student's t for contrasts: weights, and the degrees of freedom of the tails."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray

_COMPONENTS = 6
_TAILS = np.array([3.0, 4.0, 6.0, 10.0, 20.0, 50.0, 1000.0])
_SCALES = np.geomspace(0.4, 2.5, 9)


def log_gamma(x: FloatArray) -> FloatArray:
    """Return the logarithm of the gamma function of positive numbers (Stirling's series)."""
    x = np.asarray(x, dtype=np.float64)
    # Shifted so that five terms are accurate to 1e-13.
    shift = np.zeros_like(x)
    for _ in range(8):
        shift = shift - np.log(x)
        x = x + 1.0
    square = 1 / x**2
    series = (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square / 1680))) / x
    result: FloatArray = shift + (x - 0.5) * np.log(x) - x + 0.5 * np.log(2 * np.pi) + series
    return result


def weights(squares: FloatArray, tail: float) -> FloatArray:
    """Return (n,) the weights ``(nu + 6) / (nu + d^2)`` of the EM algorithm for Student's t."""
    return (tail + _COMPONENTS) / (tail + squares)


def find_tail(squares: FloatArray) -> float:
    """Return the maximum-likelihood degrees of freedom of (n,) ``d' V^-1 d``.

    A common scale is estimated with them.
    """
    tails, scales = _TAILS[:, None, None], _SCALES[:, None]
    # A sum over quantiles in place of all squares: accurate enough, and fast.
    at = np.quantile(squares, (np.arange(200) + 0.5) / 200)
    fit = np.log1p(at / scales / tails).mean(axis=-1)
    t = _TAILS[:, None]
    likelihood = (log_gamma((t + _COMPONENTS) / 2) - log_gamma(t / 2)
                  - _COMPONENTS / 2 * np.log(t * _SCALES) - (t + _COMPONENTS) / 2 * fit)
    return float(_TAILS[np.argmax(likelihood.max(axis=1))])
