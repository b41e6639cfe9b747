"""How much faster one clock runs than another, from when each sensor turned.

Oscillators of computers and sensors differ by some 1e-5: 20 ms in half an hour that no constant
offset removes. Where the clock of b is late by a little, the turns of a that belong to those of b
are those of a little later: to first order, the difference of the two grows with the angular
acceleration times that lateness, and lateness that grows evenly is one more column of a linear
regression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration import se3
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.trajectory import Trajectory
from trajectory_calibration.turning import ROUNDING, STEP_SHARE, Turning, turns

# Half-width of the difference quotient by time, in usual steps of a and in cells.
_HALF_STEPS, _HALF_CELLS = 0.5, 0.3

# Turns farther off than this many times the median count less and less: jumps of a SLAM.
_TAIL = 3.0

# The regression is repeated, from where it led, until it moves by this share of its deviation.
_SETTLED = 0.1
_MAX_ROUNDS = 10

# More than this (s/s) no clock differs from another: daemons that steer one stop at 5e-4.
_LARGEST = 1e-3


@dataclass(frozen=True)
class ClockDrift:
    """How much faster the clock of b must run to keep up with that of a.

    Attributes
    ----------
    rate : seconds per second.
    std : its standard deviation.

    """

    rate: float
    std: float


def find_clock_drift(
    a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
) -> ClockDrift | None:
    """Return the drift of the clock of b, its stamps given the best constant offset.

    None where the turning is too little or too even to tell, or tells of what is no drift.
    """
    turning = Turning.over_windows(a, turns(a), b, offset_ns, cell_ns)
    if turning is None:
        return None
    step_a_ns = float(np.median(np.diff(a.stamps_ns)))
    half_ns = round(max(_HALF_STEPS * step_a_ns, _HALF_CELLS * cell_ns))
    shift, rate = 0.0, 0.0
    for _ in range(_MAX_ROUNDS):
        found = _regress(turning, shift, rate, half_ns)
        if found is None:
            return None
        (shift_step, rate_step), std = found
        shift, rate = shift + shift_step, rate + rate_step
        if abs(rate) > _LARGEST:
            return None
        if abs(rate_step) <= _SETTLED * std:
            floor = STEP_SHARE * step_a_ns * 1e-9 / (0.5 * b.duration_s)
            return ClockDrift(float(rate), float(np.hypot(std, floor)))
    return None


def _regress(
    turning: Turning, shift: float, rate: float, half_ns: int,
) -> tuple[FloatArray, float] | None:
    """Return the (2,) change of shift (s) and rate (s/s), and the deviation of the rate.

    The rotation between the sensors takes part with three columns of its own.
    """
    shift_ns = round(shift * 1e9)
    of_a = turning.of_a(shift_ns, rate)
    slope = (turning.of_a(shift_ns + half_ns, rate)
             - turning.of_a(shift_ns - half_ns, rate)) / (2e-9 * half_ns)
    # Who turns at a constant rate agrees at any offset, but for rounding.
    if np.sum(slope**2) * (half_ns * 1e-9)**2 <= ROUNDING * np.sum(of_a**2):
        return None
    R = se3.nearest_rotation(of_a.T @ turning.of_b)
    residual = turning.of_b @ R.T - of_a
    since_middle = 0.5e-9 * (
        (turning.starts_ns - turning.middle_ns) + (turning.ends_ns - turning.middle_ns))
    # In units of half the time, so that both columns have one size.
    unit = max(float(np.abs(since_middle).max()), np.finfo(float).tiny)
    by_rate = slope * (since_middle / unit)[:, None]
    J = np.concatenate([np.stack([slope, by_rate], axis=2), -se3.skew(of_a)], axis=2)
    size = np.linalg.norm(residual, axis=1)
    usual = max(float(np.median(size)), np.finfo(float).tiny)
    weights = 1 / (1 + (size / (_TAIL * usual))**2)
    weighted = weights[:, None, None] * J
    # About an axis that nothing turned about, the rotation is open: no part of the answer.
    inverse = np.linalg.pinv(np.einsum('kij,kil->jl', weighted, J), rcond=ROUNDING, hermitian=True)
    step = inverse @ np.einsum('kij,ki->j', weighted, residual)
    rest = residual - J @ step
    variance = (np.sum(weights[:, None] * rest**2) / (3 * weights.sum()) * turning.overlapping)
    covariance = variance * inverse @ np.einsum('kij,kil->jl', weighted, weighted) @ inverse
    return step[:2] / [1.0, unit], float(np.sqrt(covariance[1, 1]) / unit)
