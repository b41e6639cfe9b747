# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The covariance of all parameters: information, prior, sandwich over blocks of time."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.drive import HALF_WIDTH, LATENCY
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.drift_aware.spread import BLOCKS, scatter, whitener

# Below this part of the information of the others a direction is unobserved: a kilometre.
_ROUNDING, _FAR = 1e-11, 1e3

# Latencies beyond this, seconds, are unlikely, whatever the tail of the prior says.
_LONG_LATENCY_S = 0.1
# Where a posterior is integrated, in standard deviations of what the data say.
_ABSCISSAE = np.linspace(-8.0, 8.0, 2001)


def _inverse(bread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse where there is one, and the covariance of what is exactly unobserved."""
    diagonal = np.diag(bread)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(bread * np.outer(scale, scale))
    known = values > _ROUNDING
    rows = scale[:, None] * vectors
    kept = rows[:, known]
    free = rows[:, ~known] / np.linalg.norm(rows[:, ~known], axis=0)
    return kept / values[known] @ kept.T, free @ free.T * _FAR**2


def _told_of_latency(fit: Fit, A: FloatArray) -> float:
    """Return the precision that the latency has beyond that of the data, A (12, 12).

    At a constant speed nothing tells a latency from the lever arm along the way. Its posterior, a
    Cauchy prior by the normal distribution that the data give, is then wide and lopsided, and its
    curvature at the mode says little of it: its second moment about the mode does.
    """
    prior = fit.prior.copy()
    prior[LATENCY] = 0.0
    known, apart = _inverse(A / fit.phi + np.diag(prior))
    told = 1 / (known + apart)[LATENCY, LATENCY]
    mode = fit.state.terms[LATENCY - 6]
    precision = told + _LONG_LATENCY_S**-2
    middle = (told + fit.prior[LATENCY]) * mode / precision
    x = middle + _ABSCISSAE / np.sqrt(precision)
    cost = np.log1p((x / HALF_WIDTH[LATENCY - 6])**2) + 0.5 * _ABSCISSAE**2
    p = np.exp(cost.min() - cost)
    return max(0.0, float(p.sum() / (p @ (x - mode)**2)) - told)


def covariance(fit: Fit) -> FloatArray:
    """Return (12, 12), of all parameters; fixed ones have none."""
    A = fit.octaves.information(fit.c)
    W, back = whitener(A)
    middle = np.zeros_like(A)
    for sandwich in scatter(fit.drive, fit.tree, fit.octaves, fit.c, fit.rho, W):
        values, vectors = np.linalg.eigh(sandwich)
        middle += (vectors * np.maximum(values, fit.phi)) @ vectors.T / len(BLOCKS)
    prior = fit.prior.copy()
    prior[:6] = 0.0
    prior[LATENCY] = _told_of_latency(fit, A)
    inverse, apart = _inverse(A / fit.phi + np.diag(prior))
    result = inverse @ (back.T @ middle @ back / fit.phi**2 + np.diag(prior)) @ inverse + apart
    result = np.where(np.outer(fit.free, fit.free), result, 0.0)
    return 0.5 * (result + result.T)
