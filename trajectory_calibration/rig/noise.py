# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise of each sensor, from what pairs of them differ by.

The mean square of the difference of two sensors is the sum of what each contributes. With three
sensors or more these sums are more than the unknowns (variance components; in metrology the
"three-cornered hat": J. E. Gray, D. W. Allan, 28th Frequency Control Symposium, 1974). With two
the noise is halved between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.windows import Level

# The median of a chi-squared variable of three degrees of freedom, and where its tail is cut.
_MEDIAN, _CUT = 2.366, 16.27

# A sensor without noise still has this share of the smallest sum that it is part of.
_FLOOR = 0.03

# Windows that tell a variance without rounding to nothing.
_FEWEST_WINDOWS = 6

_SWEEPS = 500

# Metres and radians that are rounding: a nanosecond at 10 m/s.
_LEAST = 1e-8


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of one axis of one sensor.

    Attributes
    ----------
    white_m, white_rad : of one pose.
    drift_m, drift_rad : of the random walk after one metre.

    """

    white_m: float
    white_rad: float
    drift_m: float
    drift_rad: float


def pair_squares(levels: list[Level]) -> tuple[FloatArray, FloatArray]:
    """Return what every two sensors differ by, and how many windows say so.

    Returns
    -------
    squares : (T, 2, S, S)
        Mean square of one axis of a difference, translation and rotation; NaN where unknown.
    counts : (T, S, S)
        Windows.

    """
    sensors = levels[0].differences.shape[0]
    squares = np.full((len(levels), 2, sensors, sensors), np.nan)
    counts = np.zeros((len(levels), sensors, sensors))
    for level, square, count in zip(levels, squares, counts, strict=True):
        for i in range(sensors):
            for j in range(i + 1, sensors):
                both = level.known[i] & level.known[j]
                count[i, j] = count[j, i] = n = np.count_nonzero(both)
                if n < 2:
                    continue
                apart = level.differences[j, both] - level.differences[i, both]
                for part, values in enumerate((apart[:, :3], apart[:, 3:])):
                    square[part, i, j] = square[part, j, i] = _variance(np.sum(values**2, axis=1))
    return squares, counts


def sensor_variances(
    squares: FloatArray, counts: FloatArray, lever: FloatArray,
) -> FloatArray:
    """Return the (T, S, 2) variances of one axis of the differences of each sensor.

    ``lever`` (S,) are the distances of the sensors from the base, metres: a rotation of a sensor
    moves the base by as much times its angle.
    """
    levels, _, sensors, _ = squares.shape
    found = np.full((levels, sensors, 2), np.nan)
    for t in range(levels):
        rotation = _components(squares[t, 1], counts[t])
        swung = 2 / 3 * lever**2 * rotation
        sums = squares[t, 0] - np.nan_to_num(swung)[:, None] - np.nan_to_num(swung)
        translation = _components(np.maximum(sums, _FLOOR * squares[t, 0]), counts[t])
        found[t] = np.column_stack([translation, rotation])
    return _continued(found)


def covariances(variances: FloatArray, X: FloatArray) -> FloatArray:
    """Return the (T, S, 6, 6) covariances of the differences, about the base.

    ``variances`` (T, S, 2) are those of ``sensor_variances``, ``X`` (S, 4, 4) the sensors in the
    base: noise is the same along all axes of its own sensor.
    """
    own = np.zeros((*variances.shape[:2], 6, 6))
    k = np.arange(3)
    own[..., k, k] = variances[..., :1]
    own[..., k + 3, k + 3] = variances[..., 1:]
    Ad = se3.adjoint(X)
    return Ad @ own @ np.swapaxes(Ad, 1, 2)


def white_and_drift(
    levels: list[Level], variances: FloatArray, step_s: float,
) -> list[SensorNoise]:
    """Return white noise and random walk of every sensor, fitted to (T, S, 2) variances.

    The halves of a window of 2 h samples average h poses each: white noise of variance w leaves
    2 w / h. A random walk of q a metre leaves two thirds of q times the way between the halves.
    """
    half = np.array([level.seconds for level in levels]) / step_s
    metres = np.array([level.metres for level in levels])
    weight = np.sqrt([level.jacobian.shape[0] for level in levels])
    columns = np.column_stack([2.0 / half, 2 / 3 * np.maximum(metres, 1e-9)])
    found = []
    for s in range(variances.shape[1]):
        fitted = []
        for part in range(2):
            values = variances[:, s, part]
            usable = np.isfinite(values)
            if not usable.any():
                fitted.append((0.0, 0.0))
                continue
            X, y = columns[usable], np.maximum(values[usable], _LEAST**2)
            expected = y
            fit = np.zeros(2)
            for _ in range(5):
                root = weight[usable] / expected
                fit = _nonnegative(X * root[:, None], y * root)
                expected = np.maximum(X @ fit, 1e-3 * y)
            fitted.append((float(np.sqrt(fit[0])), float(np.sqrt(fit[1]))))
        (white_m, drift_m), (white_rad, drift_rad) = fitted
        found.append(SensorNoise(white_m, white_rad, drift_m, drift_rad))
    return found


def _variance(squares: FloatArray) -> float:
    """Return the variance of one of three axes of (W,) squared lengths; jumps do not count."""
    if len(squares) < _FEWEST_WINDOWS:
        return float(np.mean(squares)) / 3
    usual = float(np.median(squares)) / _MEDIAN
    return float(np.mean(np.minimum(squares, _CUT * max(usual, _LEAST**2)))) / 3


def _components(sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return (S,) variances >= 0 whose sums i + j are closest to (S, S) ``sums``; NaN: unknown."""
    sensors = len(sums)
    i, j = np.triu_indices(sensors, 1)
    known = np.isfinite(sums[i, j]) & (counts[i, j] > 0)
    i, j = i[known], j[known]
    result = np.full(sensors, np.nan)
    if not len(i):
        return result
    y = np.maximum(sums[i, j], _LEAST**2)
    rows = np.zeros((len(y), sensors))
    rows[np.arange(len(y)), i] = rows[np.arange(len(y)), j] = 1.0
    involved = rows.any(axis=0)
    # A mean square of n windows is known to a share of it.
    root = np.sqrt(counts[i, j]) / y
    # What no sum tells apart is shared equally.
    faint = 1e-3 * np.sqrt(np.sum((rows * root[:, None])**2, axis=0).mean())
    middle = np.median(y) / 2
    A = np.concatenate([rows * root[:, None], faint * np.eye(sensors)])
    found = _nonnegative(A, np.concatenate([y * root, np.full(sensors, faint * middle)]))
    floor = np.array([_FLOOR * min(y[(i == s) | (j == s)], default=0.0) for s in range(sensors)])
    result[involved] = np.maximum(found, floor)[involved]
    return result


def _nonnegative(A: FloatArray, y: FloatArray) -> FloatArray:
    """Return the least-squares solution of ``A v = y`` with every element >= 0."""
    gram, right = A.T @ A, A.T @ y
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    gram, right = gram / np.outer(scale, scale), right / scale
    v = np.maximum(np.linalg.lstsq(gram, right, rcond=None)[0], 0.0)
    for _ in range(_SWEEPS):
        before = v.copy()
        for k in range(len(v)):
            v[k] = max(0.0, v[k] + (right[k] - gram[k] @ v) / gram[k, k])
        if np.abs(v - before).max() <= 1e-12 * max(np.abs(v).max(), 1e-300):
            break
    solution: FloatArray = v / scale
    return solution


def _continued(variances: FloatArray) -> FloatArray:
    """Fill what a length does not tell with the nearest shorter one, then the nearest longer."""
    filled = variances.copy()
    for t in range(1, len(filled)):
        filled[t] = np.where(np.isfinite(filled[t]), filled[t], filled[t - 1])
    for t in range(len(filled) - 2, -1, -1):
        filled[t] = np.where(np.isfinite(filled[t]), filled[t], filled[t + 1])
    return filled
