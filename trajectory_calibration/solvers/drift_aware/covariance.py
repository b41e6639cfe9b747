# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The covariance of all parameters: information, priors, sandwich over blocks of time."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.drive import HALF_WIDTH, LATENCY
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.drift_aware.spread import BLOCKS, scatter, whitener


def _inverse(bread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pseudo-inverse, and the covariance of unobservable directions: a kilometre.

    Their information is below 1e-11 of that of the others, which is rounding.
    """
    diagonal = np.diag(bread)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(bread * np.outer(scale, scale))
    known = values > 1e-11
    rows = scale[:, None] * vectors
    kept = rows[:, known]
    free = rows[:, ~known] / np.linalg.norm(rows[:, ~known], axis=0)
    return kept / values[known] @ kept.T, free @ free.T * 1e3**2


def _prior_precision_of_latency(fit: Fit, A: FloatArray) -> float:
    """Return the precision that the prior adds to the latency; A is the (12, 12) information.

    At constant speed a latency cannot be separated from the lever arm along the path. The
    posterior, a Cauchy prior times a normal likelihood, is then wide and skewed. Its second moment
    about the mode is used, because the curvature at the mode is no measure of its width.
    """
    prior = fit.prior.copy()
    prior[LATENCY] = 0.0
    known, unobserved = _inverse(A / fit.phi + np.diag(prior))
    of_data = 1 / (known + unobserved)[LATENCY, LATENCY]
    mode = fit.state.terms[LATENCY - 6]
    # Latencies beyond 0.1 s are unlikely, whatever the tail of the prior.
    precision = of_data + 0.1**-2
    middle = (of_data + fit.prior[LATENCY]) * mode / precision
    deviations = np.linspace(-8.0, 8.0, 2001)
    x = middle + deviations / np.sqrt(precision)
    cost = np.log1p((x / HALF_WIDTH[LATENCY - 6])**2) + 0.5 * deviations**2
    p = np.exp(cost.min() - cost)
    return max(0.0, float(p.sum() / (p @ (x - mode)**2)) - of_data)


def covariance(fit: Fit) -> FloatArray:
    """Return the (12, 12) covariance of all parameters; zero for fixed ones."""
    A = fit.octaves.information(fit.c)
    W, back = whitener(A)
    middle = np.zeros_like(A)
    for sandwich in scatter(fit.drive, fit.tree, fit.octaves, fit.c, fit.rho, W):
        values, vectors = np.linalg.eigh(sandwich)
        middle += (vectors * np.maximum(values, fit.phi)) @ vectors.T / len(BLOCKS)
    prior = fit.prior.copy()
    prior[:6] = 0.0
    prior[LATENCY] = _prior_precision_of_latency(fit, A)
    inverse, unobserved = _inverse(A / fit.phi + np.diag(prior))
    scores = back.T @ middle @ back / fit.phi**2
    result = inverse @ (scores + np.diag(prior)) @ inverse + unobserved
    result = np.where(np.outer(fit.free, fit.free), result, 0.0)
    return 0.5 * (result + result.T)
