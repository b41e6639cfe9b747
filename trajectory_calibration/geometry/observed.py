# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of extrinsics along their observed directions only.

A direction is unobservable if its standard deviation exceeds the limit of the settings. Metres and
radians are scaled by these limits. Directions are eigenvectors of a covariance, not axes: the
height of a tilted sensor is oblique to its axes.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray


def misfit(error: FloatArray, V: FloatArray, limits: FloatArray) -> tuple[float, int]:
    """Return chi-squared of (n,) errors along observed directions, and its degrees of freedom.

    ``V`` (n, n) is the covariance of the errors, ``limits`` (n,) or (6,), then repeated.
    """
    if not len(error):
        return 0.0, 0
    rows = whitener(V, limits)
    return float(np.sum((rows @ error)**2)), len(rows)


def whitener(V: FloatArray, limits: FloatArray) -> FloatArray:
    """Return (k, n) rows K along observed directions with ``K V K^T = 1``; see ``misfit``."""
    unit = np.tile(limits, len(V) // len(limits))
    values, vectors = np.linalg.eigh(0.5 * (V + V.T) / np.outer(unit, unit))
    known = values < 1.0
    floor = np.finfo(float).eps * max(float(values[-1]), 1.0)
    rows: FloatArray = (vectors[:, known] / np.sqrt(np.maximum(values[known], floor))).T / unit
    return rows


def unobserved_directions(P: FloatArray, limits: FloatArray) -> FloatArray:
    """Return the (6, K) unobservable directions of a (6, 6) covariance, scaled to the limits."""
    values, vectors = np.linalg.eigh(P / np.outer(limits, limits))
    found: FloatArray = limits[:, None] * vectors[:, values >= 1.0]
    return found


def along(unobserved: FloatArray, step: FloatArray, limits: FloatArray) -> FloatArray:
    """Return the part of a (6,) step in the (6, K) ``unobserved_directions``."""
    part: FloatArray = unobserved @ (unobserved.T @ (step / limits**2))
    return part


def without(weight: FloatArray, unobserved: FloatArray) -> FloatArray:
    """Return a (6, 6) weight matrix with zero weight along (6, K) unobservable directions."""
    if not unobserved.shape[1]:
        return weight
    lost = weight @ unobserved
    left: FloatArray = weight - lost @ np.linalg.pinv(unobserved.T @ lost) @ lost.T
    return left


def drawn_near(
    T: FloatArray, P: FloatArray, near: FloatArray, limits: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Move an answer (4, 4) along its unobservable directions to be closest to another.

    Its position along them is arbitrary, and may be hundreds of metres off. Their axes are as
    uncertain as the rotation: this is added to the (6, 6) covariance, which is returned too.
    """
    unobserved = unobserved_directions(P, limits)
    if not unobserved.shape[1]:
        return T, P
    shift = along(unobserved, se3.step_between(near, T), limits)
    swung = se3.skew(shift[:3])
    wider = P.copy()
    wider[:3, :3] += swung @ P[3:, 3:] @ swung.T
    return se3.moved(T, -shift), wider
