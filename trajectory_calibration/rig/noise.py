# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise of each sensor, from the differences of pairs.

The mean square of the difference of two sensors is the sum of their variances. With three sensors
or more the variances follow from these sums (variance components; in metrology the "three-cornered
hat": J. E. Gray, D. W. Allan, 28th Frequency Control Symposium, 1974). With two sensors each has
half of the sum.

The noise from the solvers of the pairs is not used: not every solver estimates it, and pairs with
the base do not separate a sensor from the base. With it, 1 of 20 rigs without a change was
reported as moved (docs/rig.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.windows import WindowLevel

# Median of chi-squared with three degrees of freedom, and the limit above which values are cut.
_MEDIAN, _CUT = quantile(3, 0.5), quantile(3)

# Smallest variance of a sensor, relative to the smallest sum with another sensor.
_FLOOR = 0.03

_REFITS = 5

# Smallest standard deviation, metres and radians: a nanosecond at 10 m/s.
_LEAST = 1e-8


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one sensor: standard deviations per axis.

    Attributes
    ----------
    white_m, white_rad : of one pose.
    drift_m, drift_rad : of the random walk after one metre.

    """

    white_m: float
    white_rad: float
    drift_m: float
    drift_rad: float


def sensor_variances(levels: Sequence[WindowLevel], X: FloatArray) -> FloatArray:
    """Return the (T, S, 2) variances per axis of the differences, translation and rotation.

    ``X`` (S, 4, 4) are the sensors in the base: rotation noise of a sensor moves the base by the
    distance times the angle. Where a length has no windows, the variance is that of the shorter
    length.
    """
    lever = np.linalg.norm(X[:, :3, 3], axis=1)
    rows = np.array([np.sum(np.eye(len(X))[list(pair)], axis=0)
                     for pair in combinations(range(len(X)), 2)])
    found = np.zeros((len(levels) + 1, len(X), 2))
    for level, before, variances in zip(levels, found, found[1:], strict=False):
        (t_squares, R_squares), counts = _pair_squares(level)
        variances[:, 1] = _components(rows, R_squares, counts, before[:, 1])
        from_rotation = rows @ (2 / 3 * lever**2 * variances[:, 1])
        variances[:, 0] = _components(
            rows, np.maximum(t_squares - from_rotation, _FLOOR * t_squares), counts, before[:, 0])
    return found[1:]


def _pair_squares(level: WindowLevel) -> tuple[FloatArray, FloatArray]:
    """Return (2, P) mean squares per axis of the differences of pairs, and (P,) window counts.

    Jumps are cut.
    """
    pairs = list(combinations(range(len(level.known)), 2))
    squares, counts = np.zeros((2, len(pairs))), np.zeros(len(pairs))
    for p, (i, j) in enumerate(pairs):
        both = level.known[i] & level.known[j]
        counts[p] = np.count_nonzero(both)
        if counts[p]:
            residuals = (level.differences[j, both] - level.differences[i, both]).reshape(-1, 2, 3)
            lengths = np.sum(residuals**2, axis=2)
            variance = np.maximum(np.median(lengths, axis=0) / _MEDIAN, _LEAST**2)
            squares[:, p] = np.minimum(lengths, _CUT * variance).mean(axis=0) / 3
    return squares, counts


def covariances(variances: FloatArray, X: FloatArray) -> FloatArray:
    """Return the (T, S, 6, 6) covariances of the differences, about the base.

    ``variances`` (T, S, 2) are those of ``sensor_variances``, ``X`` (S, 4, 4) the sensors in the
    base. The noise is isotropic about the origin of each sensor.
    """
    own = np.zeros((*variances.shape[:2], 6, 6))
    k = np.arange(3)
    own[..., k, k] = variances[..., :1]
    own[..., k + 3, k + 3] = variances[..., 1:]
    Ad = se3.adjoint(X)
    return Ad @ own @ np.swapaxes(Ad, 1, 2)


def white_and_drift(levels: Sequence[WindowLevel], variances: FloatArray) -> list[SensorNoise]:
    """Return white noise and random walk of every sensor, fitted to (T, S, 2) variances.

    Each half of a window of 2 h samples is the mean of h poses: white noise of variance w gives
    2 w / h. A random walk of variance q per metre gives 2/3 q times the distance of the halves.
    """
    columns = np.array([
        (2.0 / level.samples, 2 / 3 * max(level.metres, 1e-9)) for level in levels])
    weight = np.sqrt([len(level.jacobian) for level in levels])
    found = []
    for of_sensor in variances.swapaxes(0, 1):
        metres, radians = (_fitted(columns, values, weight) for values in of_sensor.T)
        found.append(SensorNoise(metres[0], radians[0], metres[1], radians[1]))
    return found


def _fitted(columns: FloatArray, values: FloatArray, weight: FloatArray) -> list[float]:
    """Return standard deviations of white noise and random walk, fitted to (T,) variances."""
    expected = values
    for _ in range(_REFITS):
        root = weight / expected
        fit = _nonnegative(columns * root[:, None], values * root)
        expected = np.maximum(columns @ fit, 1e-3 * values)
    found: list[float] = np.sqrt(fit).tolist()
    return found


def _components(
    rows: FloatArray, sums: FloatArray, counts: FloatArray, before: FloatArray,
) -> FloatArray:
    """Return (S,) variances > 0 whose sums by the (P, S) rows are closest to (P,) ``sums``.

    A variance without a sum is that of ``before``; variances that the sums do not separate are
    equal.
    """
    y = np.maximum(sums, _LEAST**2)
    # The standard deviation of a mean square is proportional to it.
    root = np.sqrt(counts) / y
    A = rows * root[:, None]
    weak = 1e-3 * np.sqrt(np.sum(A**2) / A.shape[1])
    found = _nonnegative(np.concatenate([A, weak * np.eye(A.shape[1])]),
                         np.concatenate([y * root, weak * before]))
    least = np.min(np.where(A > 0, y[:, None], np.inf), axis=0)
    return np.where(np.isfinite(least), np.maximum(found, _FLOOR * least),
                    np.maximum(before, _LEAST**2))


def _nonnegative(A: FloatArray, y: FloatArray) -> FloatArray:
    """Return the least-squares solution of ``A v = y``, with 0 for negative elements."""
    v, used = np.full(A.shape[1], -1.0), np.ones(A.shape[1], dtype=np.bool_)
    while (v < 0).any():
        v = np.zeros(A.shape[1])
        v[used] = np.linalg.lstsq(A[:, used], y, rcond=None)[0]
        used &= v > 0
    return v
