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

from trajectory_calibration import se3
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.trajectory import Trajectory

# Cells of the grid on which rotations are correlated, at the most.
_MAX_CELLS = 2**18

# The shortest cell, nanoseconds: faster turning is vibration.
_LEAST_CELL_NS = 5_000_000

# A step longer than this many usual ones (and half a second) is a gap, in which nothing is known.
_GAP_FACTOR = 5.0
_GAP_NS = 500_000_000

# An offset must leave this share of the shorter trajectory in common.
_LEAST_OVERLAP = 0.3

# Length of the motions that refine the offset, in cells and nanoseconds, and how many are used.
_WINDOW_CELLS = 2
_WINDOW_NS = 300_000_000
_MAX_WINDOWS = 5_000

# Larger rotations (radians) are left out: half a turn one way is half a turn the other way.
_MAX_ANGLE = 2.5

# The parabolas that refine the offset go through this many points. The first ones reach over this
# many cells to either side; the last ones less, but not much less than a step of a: a narrower
# one would follow the noise, which interpolation halves between two samples, and find a hill
# where the stamps coincide.
_POINTS = 7
_REACH_CELLS, _LAST_REACH_CELLS, _LAST_REACH_STEPS = 1.5, 0.3, 0.75
_PARABOLAS = 2

# Of sums of squares, that leaves nothing but rounding of their difference.
_ROUNDING = 1e-12

# Motion between the poses of a is not known; this share of their usual step is uncertain.
_STEP_SHARE = 0.005

# An offset is told from zero where it exceeds this many standard deviations, and this time.
_SIGNIFICANT = 5.0
_NEGLIGIBLE_S = 1e-3

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

    """

    seconds: float
    std: float
    correlation: float

    @property
    def significant(self) -> bool:
        """Tell whether the sensors turned together, and zero is out of the question."""
        return (self.correlation >= _LEAST_CORRELATION
                and abs(self.seconds) > max(_SIGNIFICANT * self.std, _NEGLIGIBLE_S))


def synchronise(
    a: Trajectory, b: Trajectory, time_offset_s: float, mode: str, max_offset_s: float,
) -> float:
    """Return the seconds to add to the stamps of b.

    ``mode`` is 'fixed': ``time_offset_s`` as given; 'estimate': what the turning tells, within
    ``max_offset_s`` of it; 'auto': the same where it is significantly different.

    Raises
    ------
    AssociationError
        'estimate' was asked for, and the turning does not tell.

    """
    if mode == 'fixed' or max_offset_s == 0:
        return time_offset_s
    shift_ns = round(time_offset_s * 1e9)
    shifted = b if shift_ns == 0 else replace(b, stamps_ns=b.stamps_ns + shift_ns)
    found = find_clock_offset(a, shifted, max_offset_s)
    if mode == 'estimate':
        if found is None or found.correlation < _LEAST_CORRELATION:
            raise AssociationError(
                f'the clock offset within {max_offset_s:g} s cannot be told: {a.sensor_frame} and '
                f'{b.sensor_frame} did not turn together; set time_offset_mode to fixed, or '
                'raise max_time_offset')
        return time_offset_s + found.seconds
    return time_offset_s + (found.seconds if found is not None and found.significant else 0.0)


def find_clock_offset(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> ClockOffset | None:
    """Return the offset within ``max_offset_s`` at which b turned with a.

    None where the trajectories have too little time in common or did not turn, or agree best at
    the limit or beyond it: an offset cannot be told then, which is no error as long as the clocks
    agree.
    """
    cell_ns = _cell_ns(a, b)
    start_ns = min(int(a.stamps_ns[0]), int(b.stamps_ns[0]))
    turns_a = _turns(a)
    turned_a, known_a = _turned_in_cells(a, turns_a, start_ns, cell_ns)
    turned_b, known_b = _turned_in_cells(b, _turns(b), start_ns, cell_ns)
    lags, correlation = _correlate(turned_a, known_a, turned_b, known_b)
    # One lag beyond the limit on either side, or an offset at the limit could not be refined.
    allowed = np.abs(lags) * cell_ns <= max_offset_s * 1e9 + cell_ns
    if not (correlation[allowed] > 0).any():
        return None
    best = int(np.argmax(np.where(allowed, correlation, -1.0)))
    refined = _refine(a, turns_a, b, int(lags[best]) * cell_ns, cell_ns)
    # Beyond the limit it is the foot of a hill whose top was not looked at.
    if refined is None or abs(refined[0]) > max_offset_s:
        return None
    seconds, std = refined
    return ClockOffset(seconds, std, float(correlation[best]))


def _cell_ns(a: Trajectory, b: Trajectory) -> int:
    usual = max(float(np.median(np.diff(t.stamps_ns))) for t in (a, b))
    span = max(int(a.stamps_ns[-1]), int(b.stamps_ns[-1])) - min(
        int(a.stamps_ns[0]), int(b.stamps_ns[0]))
    return int(max(usual / 2, _LEAST_CELL_NS, span / _MAX_CELLS))


def _turned_in_cells(
    trajectory: Trajectory, turns: FloatArray, start_ns: int, cell_ns: int,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (K, 3) rotation in each cell, about the axes of the sensor, and which are known."""
    stamps_ns = trajectory.stamps_ns - start_ns
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    edges = np.arange(0, int(stamps_ns[-1]) + cell_ns, cell_ns)
    at_edges = np.column_stack([np.interp(edges, stamps_ns, axis) for axis in total.T])
    inside = (edges[:-1] >= stamps_ns[0]) & (edges[1:] <= stamps_ns[-1])
    left = np.clip(np.searchsorted(stamps_ns, edges, side='right') - 1, 0, len(turns) - 1)
    gap = np.diff(stamps_ns) > _longest_step_ns(trajectory)
    known = inside & ~gap[left[:-1]] & ~gap[left[1:]]
    return np.diff(at_edges, axis=0) * known[:, None], known


def _longest_step_ns(trajectory: Trajectory) -> float:
    return max(_GAP_FACTOR * float(np.median(np.diff(trajectory.stamps_ns))), _GAP_NS)


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


def _refine(
    a: Trajectory, turns_a: FloatArray, b: Trajectory, offset_ns: int, cell_ns: int,
) -> tuple[float, float] | None:
    """Return offset and standard deviation (seconds) at the least disagreement near a start."""
    step = max(1, round(max(_WINDOW_CELLS * cell_ns, _WINDOW_NS)
                        / float(np.median(np.diff(b.stamps_ns)))))
    if len(b) <= step:
        return None
    i = np.arange(0, len(b) - step, max(1, (len(b) - step) // _MAX_WINDOWS))
    j = i + step
    times = b.stamps_ns
    reach = int(2 * _REACH_CELLS * cell_ns)
    usable = (_covered(a, times[i] + offset_ns, reach) & _covered(a, times[j] + offset_ns, reach)
              & (times[j] - times[i] <= 2 * step * float(np.median(np.diff(times)))))
    turned_b = se3.log_so3(np.swapaxes(b.rotations[i], 1, 2) @ b.rotations[j])
    usable &= np.linalg.norm(turned_b, axis=1) < _MAX_ANGLE
    i, j, turned_b = i[usable], j[usable], turned_b[usable]
    if len(i) < 3 * step:
        return None
    turned = float(np.sum(turned_b**2))

    def disagreement(shift_s: float) -> float:
        at = offset_ns + round(shift_s * 1e9)
        turned_a = se3.log_so3(np.swapaxes(_rotation_at(a, turns_a, times[i] + at), 1, 2)
                               @ _rotation_at(a, turns_a, times[j] + at))
        M = turned_a.T @ turned_b
        singular = np.linalg.svd(M, compute_uv=False)
        gain = singular.sum() - 2 * singular[2] * (np.linalg.det(M) < 0)
        return float(np.sum(turned_a**2) + np.sum(turned_b**2) - 2 * gain)

    widest = _REACH_CELLS * cell_ns * 1e-9
    step_a = float(np.median(np.diff(a.stamps_ns))) * 1e-9
    last = min(max(_LAST_REACH_STEPS * step_a, _LAST_REACH_CELLS * cell_ns * 1e-9), widest)
    shift, curvature = 0.0, 0.0
    for reach_s in [widest] * _PARABOLAS + [last] * _PARABOLAS:
        around = np.linspace(-reach_s, reach_s, _POINTS)
        square, slope, _ = np.polyfit(around, [disagreement(shift + d) for d in around], 2)
        curvature = 2 * float(square)
        # Who turns at a constant rate agrees at any offset, but for rounding.
        if curvature * reach_s**2 <= _ROUNDING * turned:
            return None
        # The start is within a cell of the best offset.
        shift = float(np.clip(shift - float(slope) / curvature, -widest, widest))
    # Motions that overlap share their noise: each counts as one of ``step``.
    # Without noise the disagreement is rounding, which may fall below zero.
    variance = max(disagreement(shift), 0.0) / (3 * len(i)) * min(step, len(i))
    std = np.hypot(np.sqrt(2 * variance / curvature), _STEP_SHARE * step_a)
    return offset_ns * 1e-9 + shift, float(std)


def _covered(a: Trajectory, times: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Tell at which times a is known, ``reach`` before and after included."""
    stamps = a.stamps_ns
    inside = (times - reach >= stamps[0]) & (times + reach <= stamps[-1])
    left = np.clip(np.searchsorted(stamps, times, side='right') - 1, 0, len(stamps) - 2)
    return inside & (stamps[left + 1] - stamps[left] <= _longest_step_ns(a))


def _turns(trajectory: Trajectory) -> FloatArray:
    """Return (N - 1, 3) rotation vectors from each pose to the next."""
    R = trajectory.rotations
    return se3.log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:])


def _rotation_at(a: Trajectory, turns: FloatArray, times: NDArray[np.int64]) -> FloatArray:
    right = np.clip(np.searchsorted(a.stamps_ns, times), 1, len(a) - 1)
    left = right - 1
    fraction = (times - a.stamps_ns[left]) / (a.stamps_ns[right] - a.stamps_ns[left])
    return a.rotations[left] @ se3.exp_so3(fraction[:, None] * turns[left])
