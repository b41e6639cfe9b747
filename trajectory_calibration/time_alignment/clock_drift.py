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

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.rotation_increments import (
    is_significant,
    ROUNDING,
    STEP_SHARE,
    Turning,
)

# Half-width of the difference quotient by time, in cells, and then the next whole number of steps
# of a. Over a part of a step the quotient has noise in common with the turn itself, which draws
# the windows half-way between two poses: of sensors that hardly turn, the beat of their two rates
# would be found for a drift, with certainty. Over whole steps the two are uncorrelated.
_HALF_CELLS = 0.3

# Turns farther off than this many times the median count less and less: jumps of a SLAM.
_TAIL = 3.0

# Seven unknowns want more equations than these windows have.
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
    uneven_s : by how much a quarter of the time is off this straight line, seconds; zero where
        that is not significant.
    from_ns : stamp of b, before any offset, in the middle of the time that both have in common.

    """

    rate: float
    std: float
    uneven_s: float
    from_ns: int


def find_clock_drift(
    a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
) -> ClockDrift | None:
    """Return the drift of the clock of b, given the best constant offset of its stamps.

    None where it is not significant, the turning is too little or too even to tell, or no clock
    drifts so much. Of a clock that was set on the way it is the straight line through what it did,
    and uneven.
    """
    turning = Turning.over_windows(a, b, offset_ns, cell_ns)
    if turning is None:
        return None
    half_ns = round(
        a.usual_step_ns * max(1.0, np.ceil(_HALF_CELLS * cell_ns / a.usual_step_ns)))
    # From -1 to 1, so that both columns of the line have one size.
    half_s = 0.5 * turning.duration_s
    since_middle = (turning.starts_ns - turning.middle_ns) + (turning.ends_ns - turning.middle_ns)
    place = 0.5e-9 * since_middle / half_s
    line = np.column_stack([np.ones(len(turning)), place])
    shift, rate = 0.0, 0.0
    for _ in range(_MAX_ROUNDS):
        found = _regress(turning, shift, rate, half_ns, line)
        if found is None:
            return None
        (shift_step, by_half), (_, std) = found
        shift, rate = shift + shift_step, rate + by_half / half_s
        if abs(rate) > _LARGEST:
            return None
        if abs(by_half) <= _SETTLED * std:
            break
    else:
        return None
    floor = STEP_SHARE * a.usual_step_ns * 1e-9
    std_rate = float(np.hypot(std, floor)) / half_s
    if not is_significant(rate, std_rate, half_s):
        return None
    quarters = np.floor(2 * np.clip(place, -0.999, 0.999))[:, None] == np.arange(-2, 2)
    apart = _regress(turning, shift, rate, half_ns, quarters.astype(np.float64))
    uneven_s = 0.0 if apart is None else max(
        (abs(float(value)) for value, its_std in zip(*apart, strict=True)
         if is_significant(value, np.hypot(its_std, floor))), default=0.0)
    return ClockDrift(float(rate), std_rate, uneven_s, turning.middle_ns - offset_ns)


def _regress(
    turning: Turning, shift: float, rate: float, half_ns: int, basis: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) further shifts (s) and their deviations, from windows moved already.

    They go with the (K, n) columns of the ``basis``; the rotation between the sensors takes part
    with three of its own.
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
    J = np.concatenate([slope[:, :, None] * basis[:, None, :], -se3.skew(of_a)], axis=2)
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
    n = basis.shape[1]
    return step[:n], np.sqrt(np.maximum(np.diag(covariance)[:n], 0.0))
