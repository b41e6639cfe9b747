# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The answers of pairs become one rig: Gauss-Newton on the graph of sensors.

The unknowns are the poses of all sensors but the base. Every loop closes exactly, because every
transform is read off these poses.

The pairs are weighted with their stated covariances P, ``min sum r^T P^-1 r``; the covariance of
the outcome is the sandwich ``G A^T P^-1 C P^-1 A G`` with ``G = (A^T P^-1 A)^-1``, which knows
from C that the pairs share noise (``shared_noise.py``). Weights from C itself are better by a
percent or two where C is exact, and worse by more where it is not: loops close so well that
generalised least squares divides by what is hardly known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.observed import limits_of, misfit, whitener
from trajectory_calibration.rig.shared_noise import regular, with_own_share

_MAX_STEPS = 50
_SETTLED = 1e-13

# What is fixed by a prior of no width has this one, metres and radians.
_FIXED = 1e-7

# Share of a pair's variance that no other pair has part in, when a loop is judged: interpolation,
# another choice of jumps. Loops that are sound close better than this has it.
_OWN_SHARE = 0.15

# Root of the weight of a pair that is not trusted.
_DOUBTED = 1e-4


@dataclass(frozen=True, eq=False)
class Fused:
    """Consistent poses of (S,) sensors.

    Attributes
    ----------
    X : (S, 4, 4), each sensor in the base.
    covariance : (6 (S - 1), 6 (S - 1)), of the sensors but the base in their order, each as in
        ``CalibrationResult``.
    residuals : (P, 6), what each pair answered less what the rig has.
    pair_chi_squared, pair_degrees : (P,), of these residuals along what both the pair and the
        others observe; NaN of a pair that no other pair checks.
    chi_squared, degrees : of all loops together, along what is observed.

    """

    X: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    pair_chi_squared: FloatArray
    pair_degrees: FloatArray
    chi_squared: float
    degrees: int


def fuse(
    start: FloatArray,
    pairs: Sequence[tuple[int, int]],
    answers: FloatArray,
    C: FloatArray,
    *,
    priors: Mapping[int, Prior] | None = None,
    trusted: NDArray[np.bool_] | None = None,
    limits: FloatArray | None = None,
) -> Fused:
    """Return the rig that is closest to the answers of its pairs.

    Parameters
    ----------
    start : (S, 4, 4)
        Sensors in the base, roughly; the first is the base.
    pairs : (P,) of parent and child
        The graph is connected.
    answers : (P, 4, 4)
        Pose of the child in the parent, metres of the base.
    C : (P, 6, P, 6)
        Their joint covariance.
    priors : mapping of int to Prior, optional
        Of the poses in the base, by sensor.
    trusted : (P,) bool, optional
        The others have hardly any weight: they tell only what nothing else does.
    limits : (6,), optional
        Deviations from which a direction is open (``observed.py``) and no loop is judged by it.

    Raises
    ------
    SolverError
        No convergence: the answers contradict each other by far.

    """
    columns = {s: slice(6 * s - 6, 6 * s) for s in range(1, len(start))}
    limits = limits_of(CalibrationConfig()) if limits is None else limits
    trust = np.ones(len(pairs), dtype=np.bool_) if trusted is None else trusted
    doubt = np.where(trust, 1.0, 1.0 / _DOUBTED)
    whitening = np.linalg.inv(np.linalg.cholesky(np.stack([
        regular(C[p, :, p]) * doubt[p]**2 for p in range(len(pairs))])))
    X, step, left = start.copy(), np.full(1, np.inf), np.inf
    for _ in range(_MAX_STEPS):
        residual, A = _linearise(X, pairs, answers, columns)
        known, expected = _prior_rows(X, priors or {}, columns)
        rows = np.concatenate([_times(whitening, A), known])
        sides = np.concatenate([_times(whitening, residual), expected])
        Q, triangle = np.linalg.qr(rows)
        step = np.linalg.solve(triangle, Q.T @ sides)
        # In deviations: rounding moves what is open by more than what is known.
        left = float(np.linalg.norm(triangle @ step))
        for s, k in columns.items():
            X[s] = se3.moved(X[s], step[k])
        if np.abs(step).max() < _SETTLED:
            break
    if np.abs(step).max() > 1e-6 and left > 1e-3:
        raise SolverError(
            f'the poses of {len(start)} sensors do not settle in {_MAX_STEPS} steps: the answers '
            'of their pairs contradict each other; leave a sensor out')
    residual, A = _linearise(X, pairs, answers, columns)
    known = _prior_rows(X, priors or {}, columns)[0]
    triangle = np.linalg.qr(np.concatenate([_times(whitening, A), known]))[1]
    inverse = np.linalg.inv(triangle)
    G = inverse @ inverse.T
    # How the answer moves with the answers of the pairs.
    weights = G @ _times(whitening.swapaxes(1, 2), _times(whitening, A)).T
    from_pairs = weights @ C.reshape(len(residual), -1) @ weights.T
    from_priors = G @ known.T
    covariance = from_pairs + from_priors @ from_priors.T
    of_pairs, of_loops = _misclosure(residual, A, weights, C, trust, limits)
    return Fused(X, 0.5 * (covariance + covariance.T), residual.reshape(-1, 6), *of_pairs,
                 *of_loops)


def _misclosure(
    residual: FloatArray, A: FloatArray, weights: FloatArray, C: FloatArray,
    trusted: NDArray[np.bool_], limits: FloatArray,
) -> tuple[tuple[FloatArray, FloatArray], tuple[float, int]]:
    """Return chi-squared and degrees of each pair, and of the loops of the trusted ones."""
    pairs = C.shape[0]
    V = with_own_share(C, _OWN_SHARE)
    unit = np.tile(limits, pairs)
    rows = np.repeat(trusted, 6)
    U, values, _ = np.linalg.svd(A[rows] / unit[rows, None])
    loops = (U[:, np.count_nonzero(values > 1e-9 * values.max(initial=1.0)):] / unit[rows, None]).T
    of_loops = misfit(loops @ residual[rows], loops @ V[np.ix_(rows, rows)] @ loops.T, np.ones(1))
    left = np.eye(len(residual)) - A @ weights
    each, degrees = np.full(pairs, np.nan), np.zeros(pairs)
    for p in range(pairs):
        part = slice(6 * p, 6 * p + 6)
        own, P = left[part] @ V @ left[part].T, C[p, :, p]
        if np.trace(np.linalg.solve(regular(P), own)) > 1e-6:
            # What the pair leaves open counts as open, whatever the others know.
            K = whitener(P, limits)
            found, degrees[p] = K @ residual[part], len(K)
            each[p] = found @ np.linalg.solve(K @ own @ K.T + 1e-4 * np.eye(len(K)), found)
    return (each, degrees), of_loops


def _times(blocks: FloatArray, rows: FloatArray) -> FloatArray:
    """Return (6 P, ...) rows, those of each pair multiplied by its (6, 6) block."""
    found: FloatArray = (blocks @ rows.reshape(len(blocks), 6, -1)).reshape(rows.shape)
    return found


def spanning_start(
    sensors: int, pairs: Sequence[tuple[int, int]], answers: FloatArray, stated: FloatArray,
) -> FloatArray:
    """Return (S, 4, 4) sensors in the first along the surest pairs; NaN where none leads."""
    X = np.full((sensors, 4, 4), np.nan)
    X[0] = np.eye(4)
    reached = {0}
    size = [float(np.trace(regular(P))) for P in stated]
    while True:
        edges = [p for p, (i, j) in enumerate(pairs) if (i in reached) != (j in reached)]
        if not edges:
            return X
        i, j = pairs[p := min(edges, key=size.__getitem__)]
        if i in reached:
            X[j] = X[i] @ answers[p]
        else:
            i, j = j, i
            X[j] = X[i] @ se3.inverse(answers[p])
        reached.add(j)


def fuse_numbers(
    sensors: int, pairs: Sequence[tuple[int, int]], values: FloatArray, V: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (S,) numbers, zero of the first, and their deviations from (P,) differences.

    ``V`` (P, P) is the covariance of the differences ``child - parent``.
    """
    A = np.zeros((len(pairs), sensors))
    for p, (i, j) in enumerate(pairs):
        A[p, i], A[p, j] = -1.0, 1.0
    A = A[:, 1:]
    weight = 1.0 / np.maximum(np.diagonal(V), 1e-24)
    normal = (A.T * weight) @ A
    weights = np.linalg.solve(normal, A.T * weight)
    found = weights @ values
    deviations = np.sqrt(np.maximum(np.diagonal(weights @ V @ weights.T), 0.0))
    return np.insert(found, 0, 0.0), np.insert(deviations, 0, 0.0)


def _linearise(
    X: FloatArray, pairs: Sequence[tuple[int, int]], answers: FloatArray,
    columns: Mapping[int, slice],
) -> tuple[FloatArray, FloatArray]:
    """Return (6 P,) steps from the rig to the answers, and how they grow with the poses."""
    residual = np.empty((len(pairs), 6))
    A = np.zeros((len(pairs), 6, 6 * len(columns)))
    for p, (i, j) in enumerate(pairs):
        residual[p] = se3.step_between(se3.inverse(X[i]) @ X[j], answers[p])
        of_i, of_j = pair_jacobian(X[i], X[j])
        if i in columns:
            A[p, :, columns[i]] = of_i
        if j in columns:
            A[p, :, columns[j]] = of_j
    return residual.ravel(), A.reshape(-1, A.shape[2])


def pair_jacobian(X_i: FloatArray, X_j: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two (6, 6): the step of the pose of j in i by steps of i and of j in the base."""
    Rt = X_i[:3, :3].T
    of_j = np.zeros((6, 6))
    of_j[:3, :3] = of_j[3:, 3:] = Rt
    of_i = -of_j
    of_i[:3, 3:] = Rt @ se3.skew(X_j[:3, 3] - X_i[:3, 3])
    return of_i, of_j


def _prior_rows(
    X: FloatArray, priors: Mapping[int, Prior], columns: Mapping[int, slice],
) -> tuple[FloatArray, FloatArray]:
    """Return whitened rows and sides of what is known of the poses beforehand."""
    rows, sides = [np.zeros((0, 6 * len(columns)))], [np.zeros(0)]
    for s, prior in priors.items():
        if s not in columns:
            continue
        known = np.isfinite(prior.std)
        std = np.maximum(prior.std[known], _FIXED)
        row = np.zeros((len(std), 6 * len(columns)))
        row[:, columns[s]] = np.eye(6)[known] / std[:, None]
        rows.append(row)
        sides.append(prior.deviation(X[s])[known] / std)
    return np.concatenate(rows), np.concatenate(sides)
