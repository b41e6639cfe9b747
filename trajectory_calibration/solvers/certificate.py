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

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray

_MAX_PROJECTIONS = 300

# Eigenvalues above this share of the largest, negative, are zero but for rounding.
_ROUNDING = 1e-11

# A gap below this share of the cost proves the answer.
_PROVEN = 1e-6


@dataclass(frozen=True)
class Certificate:
    """How far below the cost of an answer any other could be.

    Attributes
    ----------
    gap : upper bound of the difference, in units of the cost; zero where it is proven.
    relative_gap : the same as a share of the cost.
    proven : whether the answer is the global minimum, to one part in a million.

    """

    gap: float
    relative_gap: float
    proven: bool


def certify(G: FloatArray, T_a_b: FloatArray) -> Certificate:
    """Bound the global minimum of ``v^T G v`` (13, 13) from below, at a (4, 4) answer."""
    outer = np.r_[0:9, 12]
    F = G[np.ix_(outer, outer)] - G[np.ix_(outer, range(9, 12))] @ np.linalg.solve(
        G[9:12, 9:12], G[np.ix_(range(9, 12), outer)])
    size = float(np.trace(F[:9, :9]))
    u = np.append(T_a_b[:3, :3].ravel(), 1.0)
    cost = max(float(u @ F @ u), 0.0)
    lowest = _raise_lowest(0.5 * (F + F.T) / size, u) * size
    gap = 4.0 * max(-lowest - _ROUNDING * size, 0.0)
    # A cost of rounding errors only has no parts in a million.
    floor = max(cost, _ROUNDING * size)
    return Certificate(gap, gap / floor, gap <= _PROVEN * floor)


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
    for _ in range(_MAX_PROJECTIONS):
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
    """Return (K, 10, 10) symmetric Q with ``u^T Q u = 0`` at every rotation; the last is e e^T."""
    def entry(i: int, j: int) -> int:
        return 3 * i + j

    found = []

    def add(products: list[tuple[int, int, float]]) -> None:
        Q = np.zeros((10, 10))
        for a, b, factor in products:
            Q[a, b] += 0.5 * factor
            Q[b, a] += 0.5 * factor
        found.append(Q)

    for i in range(3):
        for j in range(i, 3):
            one = [(9, 9, -1.0)] if i == j else []
            add([(entry(i, k), entry(j, k), 1.0) for k in range(3)] + one)
            add([(entry(k, i), entry(k, j), 1.0) for k in range(3)] + one)
    for i in range(3):
        # The cofactor of every entry is the entry itself: both handedness conditions at once.
        for j in range(3):
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            add([(entry(i1, j1), entry(i2, j2), 1.0), (entry(i1, j2), entry(i2, j1), -1.0),
                 (entry(i, j), 9, -1.0)])
    add([(9, 9, 1.0)])
    return np.array(found)


_CONSTRAINTS = _constraints()
