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

# Half-width of the difference quotient by time, in cells, and then the next whole number of steps
# of a. Over a part of a step the quotient has noise in common with the turn itself, which draws
# the windows half-way between two poses: of sensors that hardly turn, the beat of their two rates
# would be found for a drift, with certainty. Over whole steps the two are uncorrelated.
_HALF_CELLS = 0.3

# Turns farther off than this many times the median count less and less: jumps of a SLAM.
_TAIL = 3.0

# Five unknowns want more equations than these windows have.
_LEAST_WINDOWS = 10

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
    from_ns : stamp of b, before any offset, in the middle of the time that both have in common.
    duration_s : that time.

    """

    rate: float
    std: float
    from_ns: int
    duration_s: float


def find_clock_drift(
    a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
) -> ClockDrift | None:
    """Return the drift of the clock of b, given the best constant offset of its stamps.

    None where the turning is too little or too even to tell, or no clock drifts so much. Of a
    clock that was set on the way it is the straight line through what it did.
    """
    turning = Turning.over_windows(a, turns(a), b, offset_ns, cell_ns)
    if turning is None:
        return None
    step_a_ns = float(np.median(np.diff(a.stamps_ns)))
    half_ns = round(step_a_ns * max(1.0, np.ceil(_HALF_CELLS * cell_ns / step_a_ns)))
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
            floor = STEP_SHARE * step_a_ns * 1e-9 / (0.5 * turning.duration_s)
            return ClockDrift(float(rate), float(np.hypot(std, floor)),
                              turning.middle_ns - offset_ns, turning.duration_s)
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
    known = turning.known(shift_ns, rate, half_ns)
    if known.sum() < _LEAST_WINDOWS:
        return None
    R = se3.nearest_rotation(of_a[known].T @ turning.of_b[known])
    residual = turning.of_b @ R.T - of_a
    since_middle = 0.5e-9 * (
        (turning.starts_ns - turning.middle_ns) + (turning.ends_ns - turning.middle_ns))
    # In units of half the time, so that both columns have one size.
    unit = max(float(np.abs(since_middle).max()), np.finfo(float).tiny)
    by_rate = slope * (since_middle / unit)[:, None]
    J = np.concatenate([np.stack([slope, by_rate], axis=2), -se3.skew(of_a)], axis=2)
    size = np.linalg.norm(residual, axis=1)
    usual = max(float(np.median(size[known])), np.finfo(float).tiny)
    weights = known / (1 + (size / (_TAIL * usual))**2)
    weighted = weights[:, None, None] * J
    # About an axis that nothing turned about, the rotation is open: no part of the answer.
    inverse = np.linalg.pinv(np.einsum('kij,kil->jl', weighted, J), rcond=ROUNDING, hermitian=True)
    step = inverse @ np.einsum('kij,ki->j', weighted, residual)
    rest = residual - J @ step
    variance = (np.sum(weights[:, None] * rest**2) / (3 * weights.sum()) * turning.overlapping)
    covariance = variance * inverse @ np.einsum('kij,kil->jl', weighted, weighted) @ inverse
    return step[:2] / [1.0, unit], float(np.sqrt(covariance[1, 1]) / unit)
