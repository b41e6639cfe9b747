# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether one clock offset holds along a whole drive, as it does for sensors of one vehicle.

Two cars on one road turn at the same places, so that some offset makes their turns agree. But
the distance between them changes, and the offset with it, by far more than clocks do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.clock_offset import Clock
from trajectory_calibration.time_alignment.rotation_increments import Turning

# The drive is cut into parts of equal turning.
_PARTS = 12
_LEAST_WINDOWS = 10
_ROUNDS = 3
_LEAST_CELL_NS = 5_000_000


class Steadiness(NamedTuple):
    """How an offset varies along a drive.

    Attributes
    ----------
    scatter_s : root mean square over the parts of the drive, seconds, off a straight line.
    chi_squared : the same relative to its errors, per degree of freedom; one where it is steady.

    """

    scatter_s: float
    chi_squared: float


def offset_steadiness(a: Trajectory, b: Trajectory, clock: Clock) -> Steadiness | None:
    """Return how steady the offset of b is; None where the turning does not tell."""
    b = b.retimed(clock.drift, clock.drift_from_ns)
    cell_ns = round(max(a.usual_step_ns / 2, b.usual_step_ns / 2, _LEAST_CELL_NS))
    turning = Turning.over_windows(a, b, round(clock.offset_s * 1e9), cell_ns)
    if turning is None:
        return None
    half_ns = round(a.usual_step_ns)
    known = turning.known(0, 0.0, half_ns)
    if known.sum() < _PARTS * _LEAST_WINDOWS:
        return None
    of_a, of_b = turning.of_a()[known], turning.of_b[known]
    slope = (turning.of_a(half_ns) - turning.of_a(-half_ns))[known] / (2e-9 * half_ns)
    # Not of equal time: who stands still for half of it says nothing of clocks then.
    energy = np.cumsum(np.sum(slope**2, axis=1))
    if not energy[-1] > 0:
        return None
    part = np.minimum((_PARTS * energy / energy[-1]).astype(int), _PARTS - 1)
    shifts, stds = _shifts(of_a, of_b, slope, part, turning.overlapping)
    middle = np.array([np.median(turning.starts_ns[known][part == k] - turning.middle_ns)
                       if (part == k).any() else np.nan for k in range(_PARTS)])
    good = np.isfinite(middle) & (stds > 0)
    if good.sum() < _PARTS // 2:
        return None
    weights, middle, shifts = 1 / stds[good]**2, middle[good], shifts[good]
    columns = np.column_stack([np.ones(len(middle)), middle / np.abs(middle).max()])
    H = columns.T @ (weights[:, None] * columns)
    left = shifts - columns @ (np.linalg.pinv(H) @ (columns.T @ (weights * shifts)))
    squares = float(np.sum(weights * left**2))
    return Steadiness(np.sqrt(squares / float(np.sum(weights))), squares / (len(middle) - 2))


def _shifts(
    of_a: FloatArray, of_b: FloatArray, slope: FloatArray, part: FloatArray, overlapping: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the shift of each part, seconds, and its standard deviation.

    A linear regression of what (K, 3) turns of a and b differ by; the rotation between the
    sensors and a gain of the turning take part with columns of their own.
    """
    basis = (part[:, None] == np.arange(_PARTS)).astype(np.float64)
    R = se3.nearest_rotation(of_a.T @ of_b)
    residual = of_b @ R.T - of_a
    J = np.concatenate([
        slope[:, :, None] * basis[:, None, :], -se3.skew(of_a), of_a[:, :, None]], axis=2)
    weights = np.ones(len(of_a))
    solved, inverse, left = np.zeros(J.shape[2]), np.eye(J.shape[2]), residual
    for _ in range(_ROUNDS):
        weighted = weights[:, None, None] * J
        inverse = np.linalg.pinv(
            np.einsum('kij,kil->jl', weighted, J), rcond=1e-12, hermitian=True)
        solved = inverse @ np.einsum('kij,ki->j', weighted, residual)
        left = residual - J @ solved
        size = np.sum(left**2, axis=1)
        weights = 1 / (size + 9 * np.median(size) + np.finfo(float).tiny)
    noise = overlapping * weights**2 * np.mean(left**2, axis=1)
    variance = np.einsum('k,kij,kil->jl', noise, J, J)
    covariance = inverse @ variance @ inverse
    return solved[:_PARTS], np.sqrt(np.maximum(np.diag(covariance)[:_PARTS], 0.0))
