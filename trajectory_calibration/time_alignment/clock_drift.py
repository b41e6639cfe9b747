# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much faster one clock runs than another, from when each sensor turned.

Oscillators of computers and sensors differ by some 1e-5: 20 ms in half an hour that no constant
offset removes. Where the clock of b is late by a little, the turns of a that belong to those of b
are those of a little later: to first order, the difference of the two grows with the angular
acceleration times that lateness, and lateness that grows evenly is one more column of a linear
regression.
"""

from __future__ import annotations

from typing import NamedTuple

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

# Half-width (s/s) of what oscillators of computers and sensors differ by, and the least odds for a
# drift: a crystal of ordinary tolerance needs about five of its deviations.
_USUAL, _ODDS = 2e-5, 1e4

# Parts of the drive over which scores are summed for their variance; the mean of both.
_BLOCKS = (20, 10)

# More than this (s/s) no clock differs from another: daemons that steer one stop at 5e-4.
_LARGEST = 1e-3


class ClockDrift(NamedTuple):
    """How much faster the clock of b must run to keep up with that of a.

    Its ``rate`` (s/s) and the standard deviation of that; by how much a quarter of the time is off
    this straight line, seconds, zero where that is not significant; the stamp of b, before any
    offset, in the middle of the time that both have in common.
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
    half_ns = half_width_ns(a, cell_ns)
    half_s = 0.5 * turning.duration_s
    line = np.column_stack([np.ones(len(turning)), _place(turning)])
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
    if not (is_significant(rate, std_rate, half_s) and _odds_of_drift(rate, std_rate) > _ODDS):
        return None
    apart = _regress(turning, shift, rate, half_ns, _quarters(turning))
    uneven_s = 0.0 if apart is None else max(
        (abs(float(value)) for value, its_std in zip(*apart, strict=True)
         if is_significant(value, np.hypot(its_std, floor))), default=0.0)
    return ClockDrift(float(rate), std_rate, uneven_s, turning.middle_ns - offset_ns)


def _odds_of_drift(rate: float, std: float) -> float:
    """Return how much more likely the data are with a drift of an ordinary clock than without.

    The Bayes factor of a Cauchy prior of the rate against zero, by Laplace's approximation: an
    oscillator that is off by 900 ppm needs better evidence than one that is off by 20.
    """
    prior = 1 / (np.pi * _USUAL * (1 + (rate / _USUAL)**2))
    exponent = min(0.5 * (rate / std)**2, 600.0)
    return float(np.sqrt(2 * np.pi) * std * prior * np.exp(exponent))


def half_width_ns(a: Trajectory, cell_ns: int) -> int:
    """Return the half-width of the difference quotient by time, whole steps of a, nanoseconds."""
    return round(a.usual_step_ns * max(1.0, np.ceil(_HALF_CELLS * cell_ns / a.usual_step_ns)))


def _regress(
    turning: Turning, shift: float, rate: float, half_ns: int, basis: FloatArray, *,
    gain: bool = False,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) further shifts (s) and their deviations, from windows moved already.

    They go with the (K, n) columns of the ``basis``; the rotation between the sensors takes part
    with three of its own, and a gain of the turning with one where it is asked for.
    """
    shift_ns = round(shift * 1e9)
    (of_a, later, earlier), _ = turning.of_a_with_noise(
        shift_ns + half_ns * np.array([0, 1, -1]), rate)
    slope = (later - earlier) / (2e-9 * half_ns)
    # Who turns at a constant rate agrees at any offset, but for rounding.
    if np.sum(slope**2) * (half_ns * 1e-9)**2 <= ROUNDING * np.sum(of_a**2):
        return None
    known = turning.known(shift_ns, rate, half_ns)
    if known.sum() < _LEAST_WINDOWS:
        return None
    R = se3.nearest_rotation(of_a[known].T @ turning.of_b[known])
    residual = turning.of_b @ R.T - of_a
    others = [-se3.skew(of_a), of_a[:, :, None]][:1 + gain]
    J, J_quarters = (
        np.concatenate([slope[:, :, None] * columns[:, None, :], *others], axis=2)
        for columns in (basis, _quarters(turning)))
    size = np.linalg.norm(residual, axis=1)
    usual = max(float(np.median(size[known])), np.finfo(float).tiny)
    weights = known / (1 + (size / (_TAIL * usual))**2)
    step, inverse = _fit(J, weights, residual)
    rest = residual - J @ step
    variance = (np.sum(weights[:, None] * rest**2) / (3 * weights.sum()) * turning.overlapping)
    weighted = weights[:, None, None] * J
    white = variance * inverse @ _gram(weighted, weighted) @ inverse
    # Beside what a clock that was set does: that is no noise, but for find_clock_drift to say.
    beside, _ = _fit(J_quarters, weights, rest)
    scores = np.einsum('kij,ki->kj', weighted, rest - J_quarters @ beside) @ inverse
    n = basis.shape[1]
    squares = np.diag(white)[:n]
    # Quarters of the time are themselves what the blocks are compared within.
    if n < 4:
        squares = np.maximum(squares, _squares_of_blocks(scores)[:n])
    return step[:n], np.sqrt(np.maximum(squares, 0.0))


def shifts_along(
    turning: Turning, half_ns: int, basis: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) shifts (s) that go with (K, n) columns, and their deviations, without a drift.

    Also of wheels, which turn by a gain more; None where the rotation does not tell.
    """
    return _regress(turning, 0.0, 0.0, half_ns, basis, gain=True)


def _fit(
    J: FloatArray, weights: FloatArray, residual: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) least squares for (K, 3, n) J, (K, 3) residuals, and the inverse normal."""
    weighted = weights[:, None, None] * J
    # About an axis that nothing turned about, the rotation is open: no part of the answer.
    inverse = np.asarray(
        np.linalg.pinv(_gram(weighted, J), rcond=ROUNDING, hermitian=True), dtype=np.float64)
    return inverse @ _gram(weighted, residual), inverse


def _gram(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (n, m) or (n,): products of (K, 3, n) and (K, 3, m) or (K, 3), summed over K."""
    rows = left.reshape(-1, left.shape[2]).T
    result: FloatArray = rows @ right.reshape(rows.shape[1], *right.shape[2:])
    return result


def _place(turning: Turning) -> FloatArray:
    """Return (K,) where each window lies in the common time, from -1 to 1."""
    since_middle = (turning.starts_ns - turning.middle_ns) + (turning.ends_ns - turning.middle_ns)
    return since_middle.astype(np.float64) * (1e-9 / turning.duration_s)


def _quarters(turning: Turning) -> FloatArray:
    """Return (K, 4), 1 in the column of the quarter of the time in which a window lies."""
    quarter = np.floor(2 * np.clip(_place(turning), -0.999, 0.999))
    columns: FloatArray = (quarter[:, None] == np.arange(-2, 2)).astype(np.float64)
    return columns


def offset_deviation(turning: Turning, shift: float, half_ns: int) -> float:
    """Return the standard deviation of a shift (s) of least disagreement, by the same regression.

    Zero where the rotation does not tell.
    """
    found = _regress(turning, shift, 0.0, half_ns, np.ones((len(turning), 1)))
    return 0.0 if found is None else float(found[1][0])


def _squares_of_blocks(scores: FloatArray) -> FloatArray:
    """Return (n,) variances of the sum of (K, n) scores, from how sums over long blocks scatter.

    The errors of a SLAM go on for seconds: windows beside each other share them, and their own
    scatter is too little (the sandwich over clusters).
    """
    found = []
    for count in _BLOCKS:
        if len(scores) >= 2 * count:
            edges = np.linspace(0, len(scores), count + 1).astype(int)[:-1]
            sums = np.add.reduceat(scores, edges, axis=0)
            found.append(np.sum(sums**2, axis=0) * count / (count - 1))
    squares: FloatArray = np.mean(found, axis=0) if found else np.zeros(scores.shape[1])
    return squares
