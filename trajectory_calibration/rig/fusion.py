# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fusion of the answers of pairs to one rig: Gauss-Newton on the graph of sensors.

The unknowns are the poses of all sensors except the base, so every loop closes exactly.

Pairs are weighted with their own covariances P, ``min sum r^T P^-1 r``. The covariance of the
poses is the sandwich ``G A^T P^-1 C P^-1 A G`` with ``G = (A^T P^-1 A)^-1``, in which C has the
correlation of pairs (``shared_noise.py``). Weights from C itself are better by a percent or two if
C is exact, and worse by more if it is not: loops close so well that generalised least squares
divides by badly known small variances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.errors import SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.observed import misfit, whitener
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.shared_noise import (
    half_shared,
    incidence,
    root_of,
    with_own_share,
)

_MAX_STEPS = 50
_CONVERGED = 1e-13

# Standard deviation of a prior with a standard deviation of zero, metres and radians.
_FIXED = 1e-7

# Share of a pair's variance that is independent of other pairs in tests of loops: interpolation,
# other detected jumps. This is conservative: loops without a fault close better.
_OWN_SHARE = 0.15

# Root of the weight of a pair that is not trusted.
_UNTRUSTED = 1e-4


@dataclass(frozen=True, eq=False)
class Fused:
    """Consistent poses of (S,) sensors.

    Attributes
    ----------
    X : (S, 4, 4), each sensor in the base.
    covariance : (6 (S - 1), 6 (S - 1)), of the sensors without the base in their order, each as
        in ``CalibrationResult``.
    residuals : (P, 6), steps from the rig to the answer of each pair.
    pair_chi_squared, pair_degrees : (P,), of these residuals along directions that both the pair
        and the others observe; NaN for a pair that no other pair checks.
    chi_squared, degrees : of all loops together, along observed directions.

    """

    X: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    pair_chi_squared: FloatArray
    pair_degrees: FloatArray
    chi_squared: float
    degrees: int

    def of(self, k: int) -> FloatArray:
        """Return the (6, 6) covariance of sensor k; zero for the base."""
        part = slice(6 * k - 6, 6 * k)
        return self.covariance[part, part] if k else np.zeros((6, 6))


def fuse(
    start: FloatArray,
    pairs: Sequence[tuple[int, int]],
    answers: FloatArray,
    C: FloatArray,
    *,
    limits: FloatArray,
    priors: Mapping[int, Prior] | None = None,
    trusted: NDArray[np.bool_] | None = None,
) -> Fused:
    """Return the least-squares rig from the answers of its pairs.

    ``start`` (S, 4, 4) are approximate poses in the base, which is the first sensor; ``pairs``
    (P,) are indices of parent and child, in a connected graph; ``answers`` (P, 4, 4) are child in
    parent, metres of the base; ``C`` (P, 6, P, 6) is their joint covariance. Directions with
    standard deviations above ``limits`` (6,) are unobservable, and not tested. ``priors`` are of
    poses in the base, by sensor index. Pairs that are not ``trusted`` (P,) have a tiny weight:
    they determine only what no other pair does.

    Raises
    ------
    SolverError
        No convergence: the answers contradict each other.

    """
    trust = np.ones(len(pairs), dtype=np.bool_) if trusted is None else trusted
    whitening: FloatArray = np.linalg.inv(np.stack(
        [root_of(C[p, :, p]) for p in range(len(pairs))]))
    whitening[~trust] *= _UNTRUSTED
    X = start.copy()
    for _ in range(_MAX_STEPS):
        residual, A = _linearise(X, pairs, answers)
        known, expected = _prior_rows(X, priors or {})
        Q, triangle = np.linalg.qr(np.concatenate([_times(whitening, A), known]))
        step = np.linalg.solve(
            triangle, Q.T @ np.concatenate([_times(whitening, residual), expected]))
        if np.abs(step).max() < _CONVERGED:
            break
        X[1:] = se3.moved(X[1:], step.reshape(-1, 6))
    # Also in standard deviations, because rounding is larger along unobservable directions.
    if np.abs(step).max() > 1e-6 and np.linalg.norm(triangle @ step) > 1e-3:
        raise SolverError(
            f'the poses of {len(start)} sensors do not converge in {_MAX_STEPS} steps: the '
            'answers of their pairs contradict each other; leave a sensor out')
    inverse = np.linalg.inv(triangle)
    G = inverse @ inverse.T
    # Jacobian of the poses by the answers of the pairs.
    weights = G @ _times(whitening.swapaxes(1, 2), _times(whitening, A)).T
    from_pairs = weights @ C.reshape(len(residual), -1) @ weights.T
    from_priors = G @ known.T
    covariance = from_pairs + from_priors @ from_priors.T
    return Fused(X, 0.5 * (covariance + covariance.T), residual.reshape(-1, 6),
                 *_pair_misfits(residual, A, weights, C, limits),
                 *_loop_misfit(residual, A, C, trust, limits))


def _loop_misfit(
    residual: FloatArray, A: FloatArray, C: FloatArray, trusted: NDArray[np.bool_],
    limits: FloatArray,
) -> tuple[float, int]:
    """Return chi-squared and degrees of freedom of the loops of trusted pairs."""
    rows = np.repeat(trusted, 6)
    unit = np.tile(limits, len(C))[rows, None]
    U, values, _ = np.linalg.svd(A[rows] / unit)
    loops = (U[:, np.count_nonzero(values > 1e-9 * values.max(initial=1.0)):] / unit).T
    V = with_own_share(C, _OWN_SHARE)[np.ix_(rows, rows)]
    return misfit(loops @ residual[rows], loops @ V @ loops.T, np.ones(1))


def _pair_misfits(
    residual: FloatArray, A: FloatArray, weights: FloatArray, C: FloatArray, limits: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (P,) chi-squared and degrees of freedom; NaN for a pair that no other checks."""
    V = with_own_share(C, _OWN_SHARE)
    to_residuals = np.eye(len(residual)) - A @ weights
    each, degrees = np.full(len(C), np.nan), np.zeros(len(C))
    for p in range(len(C)):
        part = slice(6 * p, 6 * p + 6)
        own, P = to_residuals[part] @ V @ to_residuals[part].T, C[p, :, p]
        if (np.diagonal(own) > 1e-6 * np.diagonal(P)).any():
            # Only along directions that the pair observes.
            K = whitener(P, limits)
            whitened, degrees[p] = K @ residual[part], len(K)
            each[p] = whitened @ np.linalg.solve(
                K @ own @ K.T + 1e-4 * np.eye(len(K)), whitened)
    return each, degrees


def _times(blocks: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the (6 P, ...) product of a block diagonal matrix, (P, 6, 6) blocks, and rows."""
    product: FloatArray = (blocks @ rows.reshape(len(blocks), 6, -1)).reshape(rows.shape)
    return product


def spanning_start(
    sensors: int, pairs: Sequence[tuple[int, int]], answers: FloatArray, stated: FloatArray,
) -> FloatArray:
    """Return (S, 4, 4) poses in the first sensor along the most certain pairs; NaN without one."""
    X = np.full((sensors, 4, 4), np.nan)
    X[0] = np.eye(4)
    known = {0}
    size = np.trace(stated, axis1=1, axis2=2)
    while edges := [p for p, (i, j) in enumerate(pairs) if (i in known) != (j in known)]:
        i, j = pairs[p := min(edges, key=lambda p: size[p])]
        if i in known:
            X[j] = X[i] @ answers[p]
        else:
            X[i] = X[j] @ se3.inverse(answers[p])
        known |= {i, j}
    return X


def fuse_numbers(
    sensors: int, pairs: Sequence[tuple[int, int]], values: FloatArray, stds: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (S,) numbers, zero for the base, and standard deviations, from (P,) differences.

    ``values`` are ``child - parent``, ``stds`` (P,) their standard deviations. The noise of the
    base is in every pair, so no result is more certain than the pair of its sensor with the base.
    """
    A = incidence(sensors, pairs).T[:, 1:]
    weights = np.linalg.pinv(A / stds[:, None]) / stds
    rows = weights * stds
    result_stds = np.insert(np.sqrt(np.einsum(
        'sp,pq,sq->s', rows, half_shared(sensors, pairs), rows)), 0, 0.0)
    for pair, std in zip(pairs, stds, strict=True):
        if 0 in pair:
            result_stds[max(pair)] = max(result_stds[max(pair)], std)
    return np.insert(weights @ values, 0, 0.0), result_stds


def _linearise(
    X: FloatArray, pairs: Sequence[tuple[int, int]], answers: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (6 P,) residuals, steps from the rig to the answers, and their design matrix."""
    i, j = np.array(pairs, dtype=np.intp).T
    residual = se3.step_between(se3.inverse(X[i]) @ X[j], answers)
    A = np.zeros((len(pairs), 6, len(X), 6))
    for p, (one, other) in enumerate(pairs):
        A[p, :, one], A[p, :, other] = pair_jacobian(X[one], X[other])
    return residual.ravel(), A[:, :, 1:].reshape(6 * len(pairs), -1)


def pair_jacobian(X_i: FloatArray, X_j: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two (6, 6) Jacobians: a step of T_i_j by steps of i and of j in the base."""
    of_j = np.kron(np.eye(2), X_i[:3, :3].T)
    of_i = -of_j
    of_i[:3, 3:] = X_i[:3, :3].T @ se3.skew(X_j[:3, 3] - X_i[:3, 3])
    return of_i, of_j


def _prior_rows(X: FloatArray, priors: Mapping[int, Prior]) -> tuple[FloatArray, FloatArray]:
    """Return whitened rows and right-hand sides of the priors."""
    width = 6 * len(X) - 6
    rows, sides = [np.zeros((0, width))], [np.zeros(0)]
    for s, prior in priors.items():
        known = np.flatnonzero(np.isfinite(prior.std))
        std = np.maximum(prior.std[known], _FIXED)
        rows.append(np.eye(width)[6 * s - 6 + known] / std[:, None])
        sides.append(prior.step_from(X[s])[known] / std)
    return np.concatenate(rows), np.concatenate(sides)
