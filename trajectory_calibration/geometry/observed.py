# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which directions have a say: what the motion leaves unobserved agrees with anything.

A direction is unobserved where its standard deviation is above the limit of the settings. Metres
and radians are compared in units of these limits, and directions are those of a covariance (its
eigenvectors), not axes: the height of a tilted sensor is no axis of it.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Variance relative to that of the limits which is rounding.
_ROUNDING = 1e-16


def misfit(error: FloatArray, V: FloatArray, limits: FloatArray) -> tuple[float, int]:
    """Return chi-squared of (n,) errors along the observed directions, and how many these are.

    ``V`` (n, n) is the covariance of the errors, ``limits`` (n,) or (6,), then repeated.
    """
    if not len(error):
        return 0.0, 0
    rows = whitener(V, limits)
    return float(np.sum((rows @ error)**2)), len(rows)


def whitener(V: FloatArray, limits: FloatArray) -> FloatArray:
    """Return the (k, n) rows K along observed directions with ``K V K^T = 1``; as ``misfit``."""
    unit = np.tile(limits, len(V) // len(limits))
    values, vectors = np.linalg.eigh(0.5 * (V + V.T) / np.outer(unit, unit))
    known = values < 1.0
    floor = _ROUNDING * max(float(values[-1]), 1.0)
    rows: FloatArray = (vectors[:, known] / np.sqrt(np.maximum(values[known], floor))).T / unit
    return rows


def unobserved_directions(P: FloatArray, limits: FloatArray) -> FloatArray:
    """Return (6, K) the unobserved directions of a (6, 6) covariance, as long as their limits."""
    values, vectors = np.linalg.eigh(P / np.outer(limits, limits))
    found: FloatArray = limits[:, None] * vectors[:, values >= 1.0]
    return found


def along(unobserved: FloatArray, step: FloatArray, limits: FloatArray) -> FloatArray:
    """Return the part of a (6,) step in the (6, K) ``unobserved_directions``."""
    part: FloatArray = unobserved @ (unobserved.T @ (step / limits**2))
    return part


def without(weight: FloatArray, unobserved: FloatArray) -> FloatArray:
    """Return the (6, 6) weight of a step of which the (6, K) unobserved directions say nothing."""
    if not unobserved.shape[1]:
        return weight
    lost = weight @ unobserved
    left: FloatArray = weight - lost @ np.linalg.pinv(unobserved.T @ lost) @ lost.T
    return left


def drawn_near(
    T: FloatArray, P: FloatArray, near: FloatArray, limits: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return an answer (4, 4) that is as close to another as its unobserved directions let it be.

    Where an answer lies along them means nothing, and may be hundreds of metres off. They are as
    sure as the rotations are: what these leave of the way that the answer is moved is added to its
    (6, 6) covariance, which is returned beside it.
    """
    unobserved = unobserved_directions(P, limits)
    if not unobserved.shape[1]:
        return T, P
    way = along(unobserved, se3.step_between(near, T), limits)
    swung = se3.skew(way[:3])
    wider = P.copy()
    wider[:3, :3] += swung @ P[3:, 3:] @ swung.T
    return se3.moved(T, -way), wider
