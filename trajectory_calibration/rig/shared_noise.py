# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Correlation of the errors of pairs that share a sensor.

The noise of sensor 2 is in the pairs 1-2 and 2-3. Each pair is modelled by the estimating equation
``sum J^T K_ij (d_j - d_i) = 0`` over the common windows (``windows.py``), weighted with the noise
of its two sensors, ``K_ij = (N_i + N_j)^-1``. Its error is ``H_ij^-1`` times that sum, and the
errors of two pairs have the covariance

``M_ij,kl = H_ij^-1 [ sum J^T K_ij (+-N of the common sensors) K_kl J ] H_kl^-1``

over the windows of both pairs. Only the correlations of M are used: the covariance of each pair
is the one of its solver.

Part of the error of each pair may be independent, from interpolation or other detected jumps:
``(1 - own) C + own diag(P)``; for ``own = 1`` the pairs are independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.windows import WindowLevel

# Prior standard deviations of an extrinsic, metres and radians, for unobservable directions.
_PRIOR_STD = np.repeat([30.0, 1.0], 3)

# Smallest standard deviations of a sensor, metres and radians: rounding.
ROUNDING = np.repeat([1e-6, 1e-7], 3)

# Smallest variance of a singular covariance, relative to the largest.
_SINGULAR = 1e-14

_ALL = np.arange(6)


def joint_covariance(
    levels: Sequence[WindowLevel], noise: FloatArray, pairs: Sequence[tuple[int, int]],
) -> FloatArray:
    """Return M, the (P, 6, P, 6) covariance of the answers of pairs, twists about the base.

    ``noise`` (T, S, 6, 6) are covariances of the differences by level and sensor; ``pairs`` (P,)
    are the indices of parent and child.
    """
    signs = incidence(noise.shape[1], pairs)
    shared = signs.T @ signs
    # The prior of the extrinsics is shared between pairs, too.
    bread = np.broadcast_to(np.diag(0.5 / _PRIOR_STD**2), (len(pairs), 6, 6)).copy()
    meat = np.einsum('pq,ab->paqb', shared, np.diag(0.25 / _PRIOR_STD**2))
    for level, N in zip(levels, noise, strict=True):
        K = np.linalg.inv(np.tensordot(np.abs(signs), N, (0, 0)))
        seen = level.known[np.array(pairs)].all(axis=1)
        weighted = seen[:, :, None, None] * (K[:, None] @ level.jacobian)
        bread += np.tensordot(weighted, level.jacobian, ((1, 2), (0, 1)))
        for sensor, root in enumerate(np.linalg.cholesky(N)):
            mine = np.flatnonzero(signs[sensor])
            score = signs[sensor, mine, None, None, None] * (root.T @ weighted[mine])
            meat[np.ix_(mine, _ALL, mine, _ALL)] += np.tensordot(score, score, ((1, 2), (1, 2)))
    inverse = np.linalg.inv(bread)
    M = np.einsum('pab,pbqc,qdc->paqd', inverse, meat, inverse, optimize=True)
    M += np.einsum('pq,ab->paqb', shared, np.diag(ROUNDING**2))
    return M


def incidence(sensors: int, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Return (S, P): +1 if a sensor is the child of a pair, -1 for the parent, otherwise 0."""
    i, j = np.array(pairs, dtype=np.intp).T
    return np.eye(sensors)[:, j] - np.eye(sensors)[:, i]


def with_stated_blocks(
    M: FloatArray, stated: FloatArray, X: FloatArray, pairs: Sequence[tuple[int, int]],
) -> FloatArray:
    """Return the (P, 6, P, 6) covariance of the answers with the diagonal blocks ``stated``.

    ``stated`` (P, 6, 6) are the covariances of the pairs; ``M`` (P, 6, P, 6), of twists about the
    base, gives the correlations; ``X`` (S, 4, 4) are the sensors in the base.
    """
    L = np.stack([twist_to_step(X[i], X[j]) for i, j in pairs])
    inverse = np.linalg.inv(L)
    in_base = inverse @ stated @ inverse.swapaxes(1, 2)
    carry = np.stack([to_pair @ root_of(P) @ np.linalg.inv(root_of(M[p, :, p]))
                      for p, (to_pair, P) in enumerate(zip(L, in_base, strict=True))])
    C = np.einsum('pab,pbqc,qdc->paqd', carry, M, carry, optimize=True)
    for p, P in enumerate(stated):
        C[p, :, p] = P
    return C


def twist_to_step(X_i: FloatArray, X_j: FloatArray) -> FloatArray:
    """Return the (6, 6) Jacobian of a step of T_i_j, in covariance order, by a base twist."""
    T_i_j = se3.inverse(X_i) @ X_j
    result = se3.adjoint(se3.inverse(X_i))
    result[:3] -= se3.skew(T_i_j[:3, 3]) @ result[3:]
    return result


def half_shared(sensors: int, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Return (P, P) correlations if each sensor causes half of the variance of its pairs."""
    signs = incidence(sensors, pairs)
    shared: FloatArray = 0.5 * signs.T @ signs
    return shared


def with_own_share(C: FloatArray, own: float) -> FloatArray:
    """Return (P d, P d) from (P, d, P, d) covariances; a share ``own`` is independent."""
    V = (1.0 - own) * C
    for p in range(len(C)):
        V[p, :, p] = C[p, :, p]
    return V.reshape(C[:, :, 0, 0].size, -1)


def root_of(P: FloatArray) -> FloatArray:
    """Return a (d, d) root of a covariance: the symmetric root of its correlations, scaled.

    Zero variances are replaced by tiny ones, so that it has an inverse.
    """
    scale = np.sqrt(np.maximum(np.diagonal(P), 1e-24))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    return scale[:, None] * (vectors * np.sqrt(np.maximum(values, _SINGULAR))) @ vectors.T
