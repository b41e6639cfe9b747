# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Small matrices by the thousand: rotations, adjoints and products without a loop."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray, log_so3, skew

# Components of a twist: (translation, rotation), both in the axes of the body.
TRANSLATION, ROTATION = slice(0, 3), slice(3, 6)

# The elements of a flat rotation whose differences are twice the axis times the sine.
_LOWER, _UPPER = np.array([7, 2, 3]), np.array([5, 6, 1])
_IDENTITY = np.eye(3)


def transposed(matrices: FloatArray) -> FloatArray:
    """Return (..., k, j) of (..., j, k)."""
    return matrices.swapaxes(-1, -2)


def apply(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return (n, j): (n, j, k) matrices times (n, k) vectors."""
    result: FloatArray = (matrices @ vectors[..., None])[..., 0]
    return result


def exp(vectors: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 3) rotation vectors."""
    square = np.einsum('...i,...i->...', vectors, vectors)[..., None, None]
    # Not quite zero, where sin(half) / half is one and not zero over zero.
    half = np.maximum(0.5 * np.sqrt(square), 1e-150)
    share = np.sin(half) / half
    hat = skew(vectors)
    result: FloatArray = (share * np.cos(half)) * hat
    hat = hat @ hat
    hat *= 0.5 * share**2
    result += hat
    result += _IDENTITY
    return result


def log(rotations: FloatArray) -> FloatArray:
    """Return (n, 3) rotation vectors of (n, 3, 3) rotations; fast where all are small."""
    flat = rotations.reshape(-1, 9)
    half = 0.5 * (flat[:, _LOWER] - flat[:, _UPPER])
    square = np.einsum('ni,ni->n', half, half)
    # Below this the series is exact to rounding of what is noise anyway.
    if len(square) and (square.max() > 0.03
                        or (flat[:, 0] + flat[:, 4] + flat[:, 8]).min() < 1.0):
        return log_so3(rotations)
    # arcsin(s) / s = 1 + s^2 / 6 + 3 s^4 / 40 + 15 s^6 / 336 + ...
    series = 1 + square * (1 / 6 + square * (3 / 40 + square * (15 / 336 + square * 35 / 1152)))
    result: FloatArray = half * series[:, None]
    return result


def adjoint_of_inverse(rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return the (n, 6, 6) adjoints of T^-1, for T of (n, 3, 3) rotations and (n, 3) positions."""
    back = transposed(rotations)
    result = np.zeros((len(back), 6, 6))
    result[:, TRANSLATION, TRANSLATION] = back
    result[:, ROTATION, ROTATION] = back
    result[:, TRANSLATION, ROTATION] = -back @ skew(translations)
    return result


def lengths(vectors: FloatArray) -> FloatArray:
    """Return (n,) of (n, k)."""
    result: FloatArray = np.sqrt(np.einsum('ni,ni->n', vectors, vectors))
    return result


def median(values: FloatArray) -> float:
    """Return the median of (n,), NaN where one is: a tenth of the time of ``np.median``."""
    last = len(values) - 1
    ordered = np.partition(values, (last // 2, (last + 1) // 2, last))
    middle = 0.5 * (ordered[last // 2] + ordered[(last + 1) // 2])
    return float(np.nan if np.isnan(ordered[last]) else middle)


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return x of ``matrix x = right`` for a positive semidefinite (m, m); zero where unobserved.

    Columns are scaled to one first; what is then below rounding is no information.
    """
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    unit = matrix * np.outer(scale, scale) + 1e-13 * np.eye(len(matrix))
    result = np.linalg.solve(unit, right * scale[:, None] if right.ndim > 1 else right * scale)
    return np.asarray(result * scale[:, None] if right.ndim > 1 else result * scale)
