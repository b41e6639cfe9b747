# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much the answers of pairs err together.

The noise of sensor 2 is in the pairs 1-2 and 2-3. Each pair is taken as the estimating equation
``sum J^T K_ij (d_j - d_i) = 0`` over the common windows (``windows.py``), weighted with the noise
of its own two sensors, ``K_ij = (N_i + N_j)^-1``. Its answer then errs by ``H_ij^-1`` times that
sum, and the errors of two pairs have the covariance

``M_ij,kl = H_ij^-1 [ sum J^T K_ij (+-N of the sensors that both hold) K_kl J ] H_kl^-1``

over the windows that both pairs see. What a pair's own solver states of its answer is kept: M
gives the correlations only.

A part of each pair's error may be its own, from interpolation or another choice of jumps:
``(1 - own) C + own diag(P)``; ``own = 1`` calls the pairs independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.windows import SCALE, UNKNOWNS, WindowLevel

# Standard deviations of what no motion tells: metres, radians, seconds, log scale.
_UNTOLD = (30.0, 1.0, 0.05, 0.03)
_UNTOLD_FREE_SCALE = 1.0

# No sensor is known better than this, metres and radians: exact data are, but for rounding.
ROUNDING = np.repeat([1e-6, 1e-7], 3)

# Smallest variance relative to the largest, where a stated covariance is singular.
_SINGULAR = 1e-14


def joint_covariance(
    levels: Sequence[WindowLevel],
    noise: FloatArray,
    pairs: Sequence[tuple[int, int]],
    free_scale: Sequence[bool],
) -> FloatArray:
    """Return M, the (P, 8, P, 8) covariance of the answers of pairs, as their noise has it.

    ``noise`` (T, S, 6, 6) are the covariances of the differences of each sensor at each of the
    (T,) ``levels``; ``pairs`` (P,) two sensors each; ``free_scale`` (S,) whether one has its own
    unit.
    """
    role = _roles(noise.shape[1], pairs)
    # What nothing tells is zero give or take, and that too belongs to the sensors.
    untold = np.tile(np.repeat(_UNTOLD, (3, 3, 1, 1))**2, (noise.shape[1], 1))
    untold[np.array(free_scale, dtype=np.bool_), SCALE] = _UNTOLD_FREE_SCALE**2
    prior = 1.0 / (np.abs(role).T @ untold)
    bread = prior[:, :, None] * np.eye(UNKNOWNS)
    meat = np.zeros((len(pairs), UNKNOWNS, len(pairs), UNKNOWNS))
    weighted = prior[:, None] * prior[None] * np.einsum('sp,sq,sa->pqa', role, role, untold)
    for a in range(UNKNOWNS):
        meat[:, a, :, a] = weighted[:, :, a]
    for level, N in zip(levels, noise, strict=True):
        _add_level(bread, meat, level, N, role)
    inverse = np.linalg.inv(bread)
    M = np.einsum('pab,pbqc,qdc->paqd', inverse, meat, inverse, optimize=True)
    shared = role.T @ role
    for a, rounding in enumerate(ROUNDING):
        M[:, a, :, a] += rounding**2 * shared
    return M


def _roles(sensors: int, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Return (S, P): +1 where a sensor is the child of a pair, -1 where it is the parent."""
    i, j = np.array(pairs, dtype=np.intp).T
    return np.eye(sensors)[:, j] - np.eye(sensors)[:, i]


def _add_level(
    bread: FloatArray, meat: FloatArray, level: WindowLevel, N: FloatArray, role: FloatArray,
) -> None:
    K = np.linalg.inv(np.tensordot(np.abs(role), N, (0, 0)))
    # Windows that the same sensors cover are summed at once.
    for sensors, windows in level.patterns():
        seen = np.flatnonzero(np.abs(role[sensors]).sum(axis=0) == 2)
        if not len(seen):
            continue
        J = level.jacobian[windows]
        # [a, b, c, d]: sum of J[c, a] J[d, b] over the windows.
        products = np.einsum('wca,wdb->abcd', J, J, optimize=True).reshape(UNKNOWNS**2, 36)
        W = K[seen]
        bread[seen] += (W.reshape(-1, 36) @ products.T).reshape(-1, UNKNOWNS, UNKNOWNS)
        inner = np.zeros((len(seen), len(seen), 6, 6))
        for s in sensors:
            mine = np.flatnonzero(role[s, seen])
            signed = role[s, seen[mine], None, None] * W[mine]
            inner[np.ix_(mine, mine)] += (signed @ N[s])[:, None] @ signed[None]
        added = (inner.reshape(-1, 36) @ products.T).reshape(
            len(seen), len(seen), UNKNOWNS, UNKNOWNS)
        all_ = np.arange(UNKNOWNS)
        meat[np.ix_(seen, all_, seen, all_)] += added.transpose(0, 2, 1, 3)


def correlations(M: FloatArray) -> FloatArray:
    """Return (P, d, P, d): how answers err together, each in the deviations of its own block."""
    whitening = np.stack([np.linalg.inv(_root(M[p, :, p])) for p in range(len(M))])
    return np.einsum('pab,pbqc,qdc->paqd', whitening, M, whitening, optimize=True)


def carried_to_stated(
    R: FloatArray, stated: FloatArray, X: FloatArray, pairs: Sequence[tuple[int, int]],
) -> FloatArray:
    """Return the (P, 6, P, 6) covariance of answers with the (P, 6, 6) stated as its blocks.

    ``R`` (P, 6, P, 6) are correlations of twists about the base, ``X`` (S, 4, 4) sensors in it.
    """
    L = np.stack([twist_to_step(X[i], X[j]) for i, j in pairs])
    inverse = np.linalg.inv(L)
    in_base = inverse @ stated @ inverse.swapaxes(1, 2)
    roots = np.stack([to_pair @ _root(P) for to_pair, P in zip(L, in_base, strict=True)])
    C = np.einsum('pab,pbqc,qdc->paqd', roots, R, roots, optimize=True)
    for p, P in enumerate(stated):
        C[p, :, p] = P
    return C


def twist_to_step(X_i: FloatArray, X_j: FloatArray) -> FloatArray:
    """Return (6, 6): the step of the pose of j in i (its covariance's order) by a base twist."""
    T_i_j = se3.inverse(X_i) @ X_j
    result = se3.adjoint(se3.inverse(X_i))
    result[:3] -= se3.skew(T_i_j[:3, 3]) @ result[3:]
    return result


def assumed_correlations(sensors: int, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Return (P, 6, P, 6) where nothing tells whose errors they are: each sensor has half."""
    role = _roles(sensors, pairs)
    return np.einsum('pq,ab->paqb', 0.5 * role.T @ role, np.eye(6))


def with_own_share(C: FloatArray, own: float) -> FloatArray:
    """Return the (n, n) covariance of all (P, d, P, d) answers with a share of each its own."""
    V = (1.0 - own) * C
    for p in range(len(C)):
        V[p, :, p] = C[p, :, p]
    return V.reshape(C[:, :, 0, 0].size, -1)


def _root(P: FloatArray) -> FloatArray:
    """Return a (d, d) root of a covariance: the symmetric one of its correlations, scaled."""
    scale = np.sqrt(np.maximum(np.diagonal(P), 1e-300))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    return scale[:, None] * (vectors * np.sqrt(np.maximum(values, _SINGULAR))) @ vectors.T


def regular(P: FloatArray) -> FloatArray:
    """Return a (d, d) covariance, symmetric and with no variance of zero."""
    scale = np.sqrt(np.maximum(np.diagonal(P), 1e-24))
    values, vectors = np.linalg.eigh(0.5 * (P + P.T) / np.outer(scale, scale))
    values = np.maximum(values, _SINGULAR * len(P))
    return (scale[:, None] * vectors * values) @ (scale[:, None] * vectors).T
