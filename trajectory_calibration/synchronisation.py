"""The offset between the clocks of two sensors, from when each of them turned.

Both sensors turn by the same angles about axes that differ by one constant rotation, wherever
they are mounted, so that the times of turning tell the offset before anything else is known. The
integrated rotations are compared at every offset by the largest correlation that any rotation
between the sensors allows: the nuclear norm of the cross-covariance, Kabsch's gain. One fast
Fourier transform gives it for all offsets; the best is then refined between the samples.

For one axis and known mounting this is the usual correlation of angular rates: J. Kelly, G. S.
Sukhatme, "A general framework for temporal calibration of multiple proprioceptive and
exteroceptive sensors", ISER 2010, doi:10.1007/978-3-642-28572-1_14.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.clock_drift import find_clock_drift
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.trajectory import Trajectory
from trajectory_calibration.turning import (
    is_significant,
    longest_step_ns,
    ROUNDING,
    STEP_SHARE,
    Turning,
)

# Cells of the grid on which rotations are correlated, at the most.
_MAX_CELLS = 2**18

# The shortest cell, nanoseconds: faster turning is vibration.
_LEAST_CELL_NS = 5_000_000

# An offset must leave this share of the shorter trajectory in common.
_LEAST_OVERLAP = 0.3

# The parabolas that refine the offset go through this many points. The first ones reach over this
# many cells to either side; the last ones less, but not much less than a step of a: a narrower
# one would follow the noise, which interpolation halves between two samples, and find a hill
# where the stamps coincide.
_POINTS = 7
_REACH_CELLS, _LAST_REACH_CELLS, _LAST_REACH_STEPS = 1.5, 0.3, 0.75
_PARABOLAS = 2

# Correlation below which the two did not turn together.
_LEAST_CORRELATION = 0.3


@dataclass(frozen=True)
class ClockOffset:
    """The offset of the clock of b, as its turning tells it.

    Attributes
    ----------
    seconds : to be added to the stamps of b.
    std : its standard deviation, seconds, from the scatter of the motions.
    correlation : of the rotations at that offset, 0 to 1.
    cell_ns : of the grid on which they were compared.

    """

    seconds: float
    std: float
    correlation: float
    cell_ns: int

    @property
    def significant(self) -> bool:
        """Tell whether the sensors turned together, and zero is out of the question."""
        return self.correlation >= _LEAST_CORRELATION and is_significant(self.seconds, self.std)


@dataclass(frozen=True)
class Clock:
    """What takes the stamps of b into the clock of a.

    Attributes
    ----------
    offset_s : seconds to add to the stamps of b, ``retimed`` by the drift.
    drift : seconds a second by which the clock of b must run faster (``Trajectory.retimed``).
    drift_from_ns : stamp of b at which that adds nothing.
    drift_std : standard deviation of the drift.
    uneven_s : by how much the clock of b is off these at some time, seconds.

    """

    offset_s: float
    drift: float = 0.0
    drift_from_ns: int = 0
    drift_std: float = 0.0
    uneven_s: float = 0.0


def synchronise(
    a: Trajectory, b: Trajectory, time_offset_s: float, mode: str, max_offset_s: float,
) -> Clock:
    """Return what to do with the stamps of b.

    ``mode`` is 'fixed': ``time_offset_s`` as given; 'estimate': what the turning tells, within
    ``max_offset_s`` of it; 'auto': the same where it is significantly different. Unless the mode
    is fixed, a drift of the clock is told where it is significant.

    Raises
    ------
    AssociationError
        'estimate' was asked for, and the turning does not tell.

    """
    if mode == 'fixed' or max_offset_s == 0:
        return Clock(time_offset_s)
    shift_ns = round(time_offset_s * 1e9)
    shifted = b if shift_ns == 0 else replace(b, stamps_ns=b.stamps_ns + shift_ns)
    found = find_clock_offset(a, shifted, max_offset_s)
    if found is None or found.correlation < _LEAST_CORRELATION:
        if mode == 'auto':
            return Clock(time_offset_s)
        raise AssociationError(
            f'the clock offset within {max_offset_s:g} s cannot be told: {a.sensor_frame} and '
            f'{b.sensor_frame} did not turn together; set time_offset_mode to fixed, or '
            'raise max_time_offset')
    drift = find_clock_drift(a, shifted, round(found.seconds * 1e9), found.cell_ns)
    if drift is not None:
        retimed = find_clock_offset(
            a, shifted.retimed(drift.rate, drift.from_ns), max_offset_s)
        # An offset of the drifting clock is none of the other one.
        if retimed is not None:
            return Clock(time_offset_s + retimed.seconds, drift.rate,
                         drift.from_ns - shift_ns, drift.std, drift.uneven_s)
    if mode == 'estimate' or found.significant:
        return Clock(time_offset_s + found.seconds)
    return Clock(time_offset_s)


def find_clock_offset(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> ClockOffset | None:
    """Return the offset within ``max_offset_s`` at which b turned with a.

    None where the trajectories have too little time in common or did not turn, or agree best at
    the limit or beyond it: an offset cannot be told then, which is no error as long as the clocks
    agree.
    """
    times_a, times_b = _without_pauses(a, b, max_offset_s)
    usual = max(a.usual_step_ns, b.usual_step_ns)
    span = max(int(times_a[-1]), int(times_b[-1]))
    cell_ns = int(max(usual / 2, _LEAST_CELL_NS, span / _MAX_CELLS))
    turned_a, known_a = _turned_in_cells(a, times_a, cell_ns)
    turned_b, known_b = _turned_in_cells(b, times_b, cell_ns)
    lags, correlation = _correlate(turned_a, known_a, turned_b, known_b)
    # One lag beyond the limit on either side, or an offset at the limit could not be refined.
    allowed = np.abs(lags) * cell_ns <= max_offset_s * 1e9 + cell_ns
    if not (correlation[allowed] > 0).any():
        return None
    best = int(np.argmax(np.where(allowed, correlation, -1.0)))
    start_ns = int(lags[best]) * cell_ns
    turning = Turning.over_windows(a, b, start_ns, cell_ns)
    refined = None if turning is None else _refine(turning, cell_ns * 1e-9)
    if refined is None:
        return None
    shift, std = refined
    seconds = start_ns * 1e-9 + shift
    # Beyond the limit it is the foot of a hill whose top was not looked at.
    if abs(seconds) > max_offset_s:
        return None
    return ClockOffset(seconds, std, float(correlation[best]), cell_ns)


def _without_pauses(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the stamps of both, from 0 on, with the pauses that both make cut short.

    Between two bags lie days, and before a clock is set decades: cells that filled them would be
    too long to tell anything. What is left of a pause is a gap of both, longer than any offset, so
    that nothing is compared across it.
    """
    longest_ns = 2 * int(max(max_offset_s * 1e9, longest_step_ns(a), longest_step_ns(b)))
    both = np.union1d(a.stamps_ns, b.stamps_ns)
    cut = np.concatenate([[0], np.cumsum(np.maximum(np.diff(both) - longest_ns, 0))]) + both[0]
    times_a, times_b = (
        trajectory.stamps_ns - cut[np.searchsorted(both, trajectory.stamps_ns)]
        for trajectory in (a, b))
    return times_a, times_b


def _turned_in_cells(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], cell_ns: int,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (K, 3) rotation in each cell, about the axes of the sensor, and which are known.

    ``stamps_ns`` are those of the trajectory, counted from the first cell.
    """
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(trajectory.turns, axis=0)])
    edges = np.arange(0, int(stamps_ns[-1]) + cell_ns, cell_ns)
    at_edges = np.column_stack([np.interp(edges, stamps_ns, axis) for axis in total.T])
    inside = (edges[:-1] >= stamps_ns[0]) & (edges[1:] <= stamps_ns[-1])
    left = np.clip(np.searchsorted(stamps_ns, edges, side='right') - 1, 0, len(stamps_ns) - 2)
    gap = np.diff(stamps_ns) > longest_step_ns(trajectory)
    known = inside & ~gap[left[:-1]] & ~gap[left[1:]]
    return np.diff(at_edges, axis=0) * known[:, None], known


def _correlate(
    a: FloatArray, known_a: NDArray[np.bool_], b: FloatArray, known_b: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the lags in cells, ``a[k + lag]`` against ``b[k]``, and the correlation at each."""
    size = 1 << (len(a) + len(b) - 1).bit_length()

    def transform(values: FloatArray) -> NDArray[np.complex128]:
        return np.fft.rfft(values, size, axis=0)

    def products(left: FloatArray, right: FloatArray) -> FloatArray:
        spectrum = transform(left)[:, :, None] * transform(right).conj()[:, None, :]
        return np.fft.irfft(spectrum, size, axis=0)

    covariance = products(a, b)
    square_a, square_b = (np.sum(v**2, axis=1, keepdims=True) for v in (a, b))
    weight_a, weight_b = (k.astype(np.float64)[:, None] for k in (known_a, known_b))
    energy_a = products(square_a, weight_b)[:, 0, 0]
    energy_b = products(weight_a, square_b)[:, 0, 0]
    overlap = products(weight_a, weight_b)[:, 0, 0]
    singular = np.linalg.svd(covariance, compute_uv=False)
    # A mirror image is no rotation: with a negative determinant the least one counts against.
    gain = singular.sum(axis=1) - 2 * singular[:, 2] * (np.linalg.det(covariance) < 0)
    energy = np.sqrt(np.maximum(energy_a * energy_b, 0.0))
    enough = overlap > max(_LEAST_OVERLAP * min(known_a.sum(), known_b.sum()), 1.0)
    usable = enough & (energy > 1e-9 * max(float(energy.max()), np.finfo(float).tiny))
    correlation = np.where(usable, gain / np.where(usable, energy, 1.0), 0.0)
    index = np.arange(size, dtype=np.int64)
    return np.where(index < size // 2, index, index - size), correlation


def _refine(turning: Turning, cell_s: float) -> tuple[float, float] | None:
    """Return the shift (seconds) of least disagreement near zero, and its standard deviation."""
    turned = float(np.sum(turning.of_b**2))
    step_a_s = turning.a.usual_step_ns * 1e-9

    def disagreement(shift_s: float) -> float:
        turned_a = turning.of_a(round(shift_s * 1e9))
        M = turned_a.T @ turning.of_b
        singular = np.linalg.svd(M, compute_uv=False)
        gain = singular.sum() - 2 * singular[2] * (np.linalg.det(M) < 0)
        return float(np.sum(turned_a**2) + turned - 2 * gain)

    widest = _REACH_CELLS * cell_s
    last = min(max(_LAST_REACH_STEPS * step_a_s, _LAST_REACH_CELLS * cell_s), widest)
    shift, curvature = 0.0, 0.0
    for reach_s in [widest] * _PARABOLAS + [last] * _PARABOLAS:
        around = np.linspace(-reach_s, reach_s, _POINTS)
        square, slope, _ = np.polyfit(around, [disagreement(shift + d) for d in around], 2)
        curvature = 2 * float(square)
        # Who turns at a constant rate agrees at any offset, but for rounding.
        if curvature * reach_s**2 <= ROUNDING * turned:
            return None
        # The start is within a cell of the best offset.
        shift = float(np.clip(shift - float(slope) / curvature, -widest, widest))
    # Without noise the disagreement is rounding, which may fall below zero.
    variance = max(disagreement(shift), 0.0) / (3 * len(turning)) * turning.overlapping
    std = np.hypot(np.sqrt(2 * variance / curvature), STEP_SHARE * step_a_s)
    return shift, float(std)
