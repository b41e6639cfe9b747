# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock drift between two sensors, from their rotations.

Oscillators of computers and sensors differ by some 1e-5: 20 ms in half an hour, which no constant
offset corrects. A small delay of the clock of b changes the difference of the rotations of a and b
by the angular acceleration times the delay, to first order. A delay that grows at a constant rate
is therefore one more regressor of a linear regression.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.trajectory import LARGEST_DRIFT, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.rotation_increments import (
    is_significant,
    RotationIncrements,
    STEP_SHARE,
)

# Half-width of the difference quotient in time, in cells, rounded up to whole steps of a. Over a
# part of a step the noise of the quotient is correlated with that of the rotation itself: for
# sensors that hardly rotate, the beat of their two rates would appear as a significant drift.
_HALF_CELLS = 0.3

# Fewer windows are too few equations for seven unknowns.
LEAST_WINDOWS = 10

# Half-width (s/s) of the prior of the drift, and the odds from which a drift is accepted: with
# the tolerance of an ordinary crystal this is about five standard deviations.
_USUAL, _ODDS = 2e-5, 1e4


class ClockDrift(NamedTuple):
    """Clock drift of b.

    Attributes
    ----------
    rate : correction of the rate of the clock of b, s/s.
    std : standard deviation of the rate, s/s.
    uneven_s : largest deviation of a quarter of the drive from a constant drift, seconds; zero if
        not significant.
    from_ns : stamp of b, before any offset, in the middle of the common time span.

    """

    rate: float
    std: float
    uneven_s: float
    from_ns: int


def find_clock_drift(
    a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
) -> ClockDrift | None:
    """Return the clock drift of b, given the best constant offset of its stamps.

    None if the drift is not significant, not shown by the rotations, or implausibly large.
    For a clock that was stepped it is the best straight line, and ``uneven_s`` is not zero.
    """
    increments = RotationIncrements.over_windows(a, b, offset_ns, cell_ns)
    if increments is None:
        return None
    half_ns = half_width_ns(a, cell_ns)
    half_s = 0.5 * increments.duration_s
    line = np.column_stack([np.ones(len(increments)), _place(increments)])
    shift, rate = 0.0, 0.0
    for _ in range(10):
        found = _regress(increments, shift, rate, half_ns, line)
        if found is None:
            return None
        (shift_step, by_half), (_, std) = found
        shift, rate = shift + shift_step, rate + by_half / half_s
        if abs(rate) > LARGEST_DRIFT:
            return None
        # Iterated until a step is below a tenth of its standard deviation.
        if abs(by_half) <= 0.1 * std:
            break
    else:
        return None
    floor = STEP_SHARE * a.usual_step_ns * 1e-9
    std_rate = float(np.hypot(std, floor)) / half_s
    if not (is_significant(rate, std_rate, half_s) and _odds_of_drift(rate, std_rate) > _ODDS):
        return None
    by_quarter = _regress(increments, shift, rate, half_ns, _quarters(increments))
    uneven_s = 0.0 if by_quarter is None else max(
        (abs(float(value)) for value, its_std in zip(*by_quarter, strict=True)
         if is_significant(value, np.hypot(its_std, floor))), default=0.0)
    return ClockDrift(float(rate), std_rate, uneven_s, increments.middle_ns - offset_ns)


def _odds_of_drift(rate: float, std: float) -> float:
    """Return the Bayes factor of a drift with a Cauchy prior against no drift.

    By Laplace's approximation. A drift of 900 ppm needs better evidence than one of 20 ppm.
    """
    prior = 1 / (np.pi * _USUAL * (1 + (rate / _USUAL)**2))
    exponent = min(0.5 * (rate / std)**2, 600.0)
    return float(np.sqrt(2 * np.pi) * std * prior * np.exp(exponent))


def half_width_ns(a: Trajectory, cell_ns: int) -> int:
    """Return the half-width of the difference quotient in time, whole steps of a, nanoseconds."""
    return round(a.usual_step_ns * max(1.0, np.ceil(_HALF_CELLS * cell_ns / a.usual_step_ns)))


def _regress(
    increments: RotationIncrements, shift: float, rate: float, half_ns: int, basis: FloatArray, *,
    gain: bool = False,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) corrections of the shift (s) and their standard deviations.

    They are the coefficients of the (K, n) columns of the ``basis``, about the given ``shift`` and
    ``rate``. The rotation between the sensors is estimated with them, and with ``gain`` also a
    scale factor of the rotations.
    """
    shift_ns = round(shift * 1e9)
    (rotations_a, later, earlier), _ = increments.rotations_a_with_noise(
        shift_ns + half_ns * np.array([0, 1, -1]), rate)
    slope = (later - earlier) / (2e-9 * half_ns)
    # Rotation at a constant rate fits at any offset, but for rounding.
    if np.sum(slope**2) * (half_ns * 1e-9)**2 <= se3.ROUNDING * np.sum(rotations_a**2):
        return None
    known = increments.known(shift_ns, rate, half_ns)
    if known.sum() < LEAST_WINDOWS:
        return None
    R = se3.nearest_rotation(rotations_a[known].T @ increments.rotations_b[known])
    residual = increments.rotations_b @ R.T - rotations_a
    others = [-se3.skew(rotations_a), rotations_a[:, :, None]][:1 + gain]
    J, J_quarters = (
        np.concatenate([slope[:, :, None] * columns[:, None, :], *others], axis=2)
        for columns in (basis, _quarters(increments)))
    size = np.linalg.norm(residual, axis=1)
    usual = max(float(np.median(size[known])), np.finfo(float).tiny)
    # Residuals beyond three medians get less weight: SLAM jumps.
    weights = known / (1 + (size / (3 * usual))**2)
    step, inverse = _fit(J, weights, residual)
    rest = residual - J @ step
    variance = (np.sum(weights[:, None] * rest**2) / (3 * weights.sum()) * increments.overlapping)
    weighted = weights[:, None, None] * J
    white = variance * inverse @ _gram(weighted, weighted) @ inverse
    # Without the effect of a stepped clock, which is no noise: find_clock_drift reports it.
    beside, _ = _fit(J_quarters, weights, rest)
    scores = np.einsum('kij,ki->kj', weighted, rest - J_quarters @ beside) @ inverse
    n = basis.shape[1]
    squares = np.diag(white)[:n]
    # The blocks are compared within the quarters, so they say nothing about the quarters.
    if n < 4:
        squares = np.maximum(squares, _squares_of_blocks(scores)[:n])
    return step[:n], np.sqrt(np.maximum(squares, 0.0))


def fit_offsets(
    increments: RotationIncrements, half_ns: int, basis: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (n,) clock offsets (s) of (K, n) basis columns, and their standard deviations.

    A scale factor of the rotations is estimated too (wheel odometry). None if the rotations do not
    determine the offsets.
    """
    return _regress(increments, 0.0, 0.0, half_ns, basis, gain=True)


def _fit(
    J: FloatArray, weights: FloatArray, residual: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) weighted least-squares solution and the (n, n) inverse normal matrix.

    ``J`` is (K, 3, n), ``weights`` (K,), ``residual`` (K, 3).
    """
    weighted = weights[:, None, None] * J
    # A pseudo-inverse, because the rotation about an unused axis is unobserved.
    inverse = np.asarray(
        np.linalg.pinv(_gram(weighted, J), rcond=se3.ROUNDING, hermitian=True), dtype=np.float64)
    return inverse @ _gram(weighted, residual), inverse


def _gram(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the (n, m) or (n,) sum over K of (K, 3, n) times (K, 3, m) or (K, 3)."""
    rows = left.reshape(-1, left.shape[2]).T
    result: FloatArray = rows @ right.reshape(rows.shape[1], *right.shape[2:])
    return result


def _place(increments: RotationIncrements) -> FloatArray:
    """Return the (K,) position of each window in the common time span, from -1 to 1."""
    starts, ends = (stamps - increments.middle_ns
                    for stamps in (increments.starts_ns, increments.ends_ns))
    return (starts + ends).astype(np.float64) * (1e-9 / increments.duration_s)


def _quarters(increments: RotationIncrements) -> FloatArray:
    """Return (K, 4) indicators of the quarter of the time span in which a window lies."""
    quarter = np.floor(2 * np.clip(_place(increments), -0.999, 0.999))
    columns: FloatArray = (quarter[:, None] == np.arange(-2, 2)).astype(np.float64)
    return columns


def offset_deviation(increments: RotationIncrements, shift: float, half_ns: int) -> float:
    """Return the standard deviation of a shift (s), from the same regression.

    Zero if the rotations do not determine it.
    """
    found = _regress(increments, shift, 0.0, half_ns, np.ones((len(increments), 1)))
    return 0.0 if found is None else float(found[1][0])


def _squares_of_blocks(scores: FloatArray) -> FloatArray:
    """Return the (n,) variances of the sum of (K, n) scores, from sums over long blocks.

    SLAM errors are correlated over seconds, so neighbouring windows share them (cluster sandwich).
    """
    found = []
    for count in (20, 10):
        if len(scores) >= 2 * count:
            edges = np.linspace(0, len(scores), count + 1).astype(int)[:-1]
            sums = np.add.reduceat(scores, edges, axis=0)
            found.append(np.sum(sums**2, axis=0) * count / (count - 1))
    squares: FloatArray = np.mean(found, axis=0) if found else np.zeros(scores.shape[1])
    return squares
