# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise of each sensor, from what pairs of them differ by.

The mean square of the difference of two sensors is the sum of what each contributes. With three
sensors or more these sums are more than the unknowns (variance components; in metrology the
"three-cornered hat": J. E. Gray, D. W. Allan, 28th Frequency Control Symposium, 1974). With two
the noise is halved between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.windows import WindowLevel

# The median of a chi-squared variable of three degrees of freedom, and where its tail is cut.
_MEDIAN, _CUT = quantile(3, 0.5), quantile(3)

# A sensor without noise still has this share of the smallest sum that it is part of.
_FLOOR = 0.03

# Windows that tell a variance without rounding to nothing.
_FEWEST_WINDOWS = 6

_SWEEPS, _REFITS = 500, 5

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


def sensor_variances(levels: Sequence[WindowLevel], X: FloatArray) -> FloatArray:
    """Return the (T, S, 2) variances of one axis of the differences, translation and rotation.

    ``X`` (S, 4, 4) are the sensors in the base: a rotation of a sensor moves the base by its
    distance times the angle.
    """
    lever = np.linalg.norm(X[:, :3, 3], axis=1)
    found = np.empty((len(levels), len(X), 2))
    for level, variances in zip(levels, found, strict=True):
        (apart, turned), counts = _pair_squares(level)
        variances[:, 1] = _components(turned, counts)
        swung = 2 / 3 * lever**2 * np.nan_to_num(variances[:, 1])
        sums = np.maximum(apart - swung[:, None] - swung, _FLOOR * apart)
        variances[:, 0] = _components(sums, counts)
    return _continued(found)


def _pair_squares(level: WindowLevel) -> tuple[FloatArray, FloatArray]:
    """Return (2, S, S) mean squares of one axis of what two sensors differ by, and windows."""
    sensors = len(level.known)
    squares, counts = np.full((2, sensors, sensors), np.nan), np.zeros((sensors, sensors))
    for i, j in combinations(range(sensors), 2):
        both = level.known[i] & level.known[j]
        counts[i, j] = np.count_nonzero(both)
        if counts[i, j] >= 2:
            apart = level.differences[j, both] - level.differences[i, both]
            squares[:, i, j] = [
                _variance(np.sum(part**2, axis=1)) for part in np.split(apart, 2, axis=1)]
    return squares, counts


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


def white_and_drift(levels: list[WindowLevel], variances: FloatArray) -> list[SensorNoise]:
    """Return white noise and random walk of every sensor, fitted to (T, S, 2) variances.

    The halves of a window of 2 h samples average h poses each: white noise of variance w leaves
    2 w / h. A random walk of q a metre leaves two thirds of q times the way between the halves.
    """
    columns = np.array([
        (2.0 / level.samples, 2 / 3 * max(level.metres, 1e-9)) for level in levels])
    weight = np.sqrt([len(level.jacobian) for level in levels])
    found = []
    for of_sensor in variances.swapaxes(0, 1):
        (white_m, drift_m), (white_rad, drift_rad) = (
            _fitted(columns, values, weight) for values in of_sensor.T)
        found.append(SensorNoise(white_m, white_rad, drift_m, drift_rad))
    return found


def _fitted(columns: FloatArray, values: FloatArray, weight: FloatArray) -> list[float]:
    """Return the deviations of white noise and random walk that explain (T,) variances best."""
    usable = np.isfinite(values)
    X, y = columns[usable], np.maximum(values[usable], _LEAST**2)
    expected, fit = y, np.zeros(2)
    for _ in range(_REFITS if usable.any() else 0):
        root = weight[usable] / expected
        fit = _nonnegative(X * root[:, None], y * root)
        expected = np.maximum(X @ fit, 1e-3 * y)
    found: list[float] = np.sqrt(fit).tolist()
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
    i, j = np.nonzero(np.isfinite(sums))
    if not len(i):
        return np.full(sensors, np.nan)
    y = np.maximum(sums[i, j], _LEAST**2)
    rows = np.eye(sensors)[i] + np.eye(sensors)[j]
    # A mean square of n windows is known to a share of it.
    root = np.sqrt(counts[i, j]) / y
    # What no sum tells apart is shared equally.
    faint = 1e-3 * np.sqrt(np.sum((rows * root[:, None])**2, axis=0).mean())
    A = np.concatenate([rows * root[:, None], faint * np.eye(sensors)])
    found = _nonnegative(
        A, np.concatenate([y * root, np.full(sensors, faint * np.median(y) / 2)]))
    least = np.min(np.where(rows > 0, y[:, None], np.inf), axis=0)
    return np.where(np.isfinite(least), np.maximum(found, _FLOOR * least), np.nan)


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
    for ordered in (filled, filled[::-1]):
        for before, values in pairwise(ordered):
            np.copyto(values, before, where=~np.isfinite(values))
    return filled
