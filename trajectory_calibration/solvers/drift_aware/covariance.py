# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The covariance of all parameters: information, prior and the sandwich over blocks."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.drive import LATENCY
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.drift_aware.spread import BLOCKS, scatter, whitener

# Directions with less information than this part of the others (rounding) are open: a kilometre.
_OPEN, _FAR = 1e-11, 1e3

# A latency that the motion does not tell is stated with this deviation, seconds: 68 % of its prior
# lie within it. At a constant speed nothing tells it from the lever arm along the way.
_LATENCY_STATED = 0.01


def _inverse(bread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse where there is one, and the covariance of what is exactly open."""
    diagonal = np.diag(bread)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(bread * np.outer(scale, scale))
    known = values > _OPEN
    rows = scale[:, None] * vectors
    kept = rows[:, known]
    free = rows[:, ~known] / np.linalg.norm(rows[:, ~known], axis=0)
    return kept / values[known] @ kept.T, free @ free.T * _FAR**2


def covariance(fit: Fit) -> FloatArray:
    """Return (12, 12), of all parameters about the truth; fixed ones have none."""
    A = fit.octaves.information(fit.c)
    W, back = whitener(A)
    middle = np.zeros_like(A)
    for sandwich in scatter(fit.drive, fit.tree, fit.octaves, fit.c, fit.rho, W):
        values, vectors = np.linalg.eigh(sandwich)
        middle += (vectors * np.maximum(values, fit.phi)) @ vectors.T / len(BLOCKS)
    prior = fit.prior.copy()
    prior[:6] = 0.0
    latency = fit.state.terms[LATENCY - 6]
    prior[LATENCY] = min(prior[LATENCY], 1.0 / (_LATENCY_STATED**2 + latency**2))
    inverse, open_ = _inverse(A / fit.phi + np.diag(prior))
    result = inverse @ (back.T @ middle @ back / fit.phi**2 + np.diag(prior)) @ inverse + open_
    result = np.where(np.outer(fit.free, fit.free), result, 0.0)
    return 0.5 * (result + result.T)
