# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Proof that a minimum of ``v^T G v`` over SE(3) is the lowest there is.

The cost is quadratic in v = (vec R, t, 1) and rotations are quadratic too: the rows and the
columns of R are orthonormal, and right-handed (each is the cross product of the other two). With
the translation eliminated, ``u = (vec R, 1)`` and ``F`` (10 x 10), every constraint is
``u^T Q_i u = 0``. For any multipliers

    u^T F u = gamma + u^T S u,   S = F - sum lambda_i Q_i - gamma e e^T,   e = (0, ..., 0, 1),

at every rotation, and ``|u|^2 = 4`` there, so that no cost is below ``gamma + 4 min eig S``. If
``S u = 0`` at the answer, gamma is its cost: where S has no negative eigenvalue the answer is
proven, otherwise the eigenvalue bounds how much lower another could be. The multipliers follow
from linear equations, in the least-squares sense; where these leave a negative eigenvalue, what
they leave free is spent on raising it (alternating projections).

J. Briales, J. Gonzalez-Jimenez, "Convex Global 3D Registration with Lagrangian Duality", IEEE
CVPR 2017, doi:10.1109/CVPR.2017.595 (the constraints); S. Boyd, L. Vandenberghe, "Convex
Optimization", 2004, section 5.1 (the bound).
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import quadratic

# A gap below this share of the cost proves the answer.
PROVEN = 1e-6

# Eigenvalues above this share of the largest, negative, are zero but for rounding.
_ROUNDING = 1e-11


def certify(G: FloatArray, T_a_b: FloatArray) -> float:
    """Return how much lower ``v^T G v`` (13, 13) could be than at a (4, 4) answer, at most.

    As a share of the cost there; zero is a proof.
    """
    F = quadratic.without_translation(G)
    size = float(np.trace(F[:9, :9]))
    u = np.append(T_a_b[:3, :3].ravel(), 1.0)
    lowest = _raise_lowest(F / size, u) * size
    gap = 4.0 * max(-lowest - _ROUNDING * size, 0.0)
    # A cost of rounding errors only has no parts in a million.
    return gap / max(float(u @ F @ u), _ROUNDING * size)


def _raise_lowest(F: FloatArray, u: FloatArray) -> float:
    """Return the highest lowest eigenvalue of S that was found, at most zero."""
    basis = np.linalg.svd(u[None])[2][1:].T
    # S u = 0 for the multipliers of all constraints and of e e^T.
    columns = (_CONSTRAINTS @ u).T
    start = np.linalg.lstsq(columns, F @ u, rcond=None)[0]
    free = np.linalg.svd(columns)[2][np.linalg.matrix_rank(columns, tol=1e-9):]
    S = basis.T @ (F - np.tensordot(start, _CONSTRAINTS, 1)) @ basis
    directions = basis.T @ np.tensordot(free, _CONSTRAINTS, 1) @ basis
    # Orthonormal, so that a projection is two products.
    _, size, rows = np.linalg.svd(directions.reshape(len(free), -1), full_matrices=False)
    flat = rows[size > 1e-9]
    # What is left of S u = 0 where the answer is not quite stationary.
    missed = float(np.linalg.norm(F @ u - columns @ start) / np.linalg.norm(u))
    best = -np.inf
    for _ in range(300):
        eigenvalues, vectors = np.linalg.eigh(S)
        best = max(best, float(eigenvalues[0]))
        if best >= -_ROUNDING:
            # Along a well-determined direction a slope only matters in the second order.
            return -missed * min(1.0, missed / max(best, np.finfo(float).tiny))
        # Aim beyond the boundary of the cone: the projections then reach it in finite steps.
        aim = np.maximum(eigenvalues, -0.5 * eigenvalues[0])
        change = ((vectors * aim) @ vectors.T - S).ravel()
        S = S + (flat.T @ (flat @ change)).reshape(S.shape)
        S = 0.5 * (S + S.T)
    return best - missed


def _constraints() -> FloatArray:
    """Return (22, 10, 10) Q with ``u^T Q u = 0`` at every rotation; the last is e e^T."""
    found: list[FloatArray] = []

    def add(products: FloatArray, linear: FloatArray, constant: float) -> None:
        found.append(0.5 * np.block([
            [products, linear[:, None]], [linear[None], np.array([[2 * constant]])]]))

    axes = np.eye(3)
    cross = se3.skew(axes)
    for i, j in np.ndindex(3, 3):
        # The cofactor of every entry is the entry itself: both handedness conditions at once.
        add(np.kron(cross[i], cross[j]), -np.kron(axes[i], axes[j]), 0.0)
        if i <= j:
            both = np.outer(axes[i], axes[j]) + np.outer(axes[j], axes[i])
            for rows_or_columns in (np.kron(both, axes), np.kron(axes, both)):
                add(rows_or_columns, np.zeros(9), -float(i == j))
    add(np.zeros((9, 9)), np.zeros(9), 1.0)
    return np.array(found)


_CONSTRAINTS = _constraints()
