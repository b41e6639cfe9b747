# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Coarse clock offset: cross-correlation of the rotations of two sensors on a grid of cells.

For each offset the correlation is the largest that any rotation between the two sensors allows
(the nuclear norm of the cross-covariance, ``kabsch_gain``). One fast Fourier transform gives the
cross-covariances of all offsets.

For one axis and a known mounting this is the usual correlation of angular rates: J. Kelly, G. S.
Sukhatme, "A general framework for temporal calibration of multiple proprioceptive and
exteroceptive sensors", ISER 2010, doi:10.1007/978-3-642-28572-1_14.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.rotation_increments import kabsch_gain, SIGNIFICANT

# The shortest cell, nanoseconds: faster rotation is vibration.
_LEAST_CELL_NS = 5_000_000


class CoarseOffset(NamedTuple):
    """The best offset on the grid, and others that fit as well.

    Attributes
    ----------
    correlation : of the rotations at the best offset, 0 to 1.
    cell_ns : length of a cell.
    starts_ns : multiples of ``cell_ns``: the best offset, then those that are not significantly
        worse, the smallest first.

    """

    correlation: float
    cell_ns: int
    starts_ns: list[int]


class Lags(NamedTuple):
    """Comparison of two sensors at K offsets.

    Attributes
    ----------
    cell_ns : length of a cell.
    lags : (K,) int64 offsets in cells.
    correlation : (K,) of the rotations, 0 where too few cells overlap.
    apart : (K,) mean squared difference of the rotations in a cell, squared radians.
    known : (K,) number of overlapping cells.

    """

    cell_ns: int
    lags: NDArray[np.int64]
    correlation: FloatArray
    apart: FloatArray
    known: FloatArray


def cell_between(a: Trajectory, b: Trajectory, least_ns: float = _LEAST_CELL_NS) -> int:
    """Return the cell, nanoseconds, that resolves the rotation of both: half a step of either."""
    return int(max(a.usual_step_ns / 2, b.usual_step_ns / 2, least_ns))


def correlate(
    a: Trajectory, b: Trajectory, reach_s: float, least_cell_ns: float = _LEAST_CELL_NS,
) -> Lags:
    """Compare the rotations of a and b for all offsets of b within ``reach_s``, and a few more.

    A cell is at least ``least_cell_ns`` and at least half a step of either trajectory.
    """
    times_a, times_b = _without_pauses(a, b, reach_s)
    span = max(int(times_a[-1]), int(times_b[-1]))
    cell_ns = max(cell_between(a, b, least_cell_ns), span >> 18)
    reach_ns = round(reach_s * 1e9)
    return _correlate(
        *_rotation_per_cell(a, times_a, cell_ns, _reached(times_b, reach_ns)),
        *_rotation_per_cell(b, times_b, cell_ns, _reached(times_a, reach_ns)),
        # One more lag on either side: a minimum is recognised by its neighbours.
        int(reach_s * 1e9 / cell_ns) + 3, cell_ns)


def find_coarse_offset(a: Trajectory, b: Trajectory, max_offset_s: float) -> CoarseOffset | None:
    """Return the offset of b within ``max_offset_s`` with the largest correlation.

    None if nothing correlates.
    """
    found = correlate(a, b, max_offset_s)
    cell_ns = found.cell_ns
    # One lag beyond the limit on either side: an offset at the limit must be refinable.
    allowed = np.abs(found.lags) * cell_ns <= max_offset_s * 1e9 + cell_ns
    if not (found.correlation[allowed] > 0).any():
        return None
    best = int(np.argmax(np.where(allowed, found.correlation, -1.0)))
    # Cells shorter than a step share noise.
    samples = min(1.0, cell_ns / max(a.usual_step_ns, b.usual_step_ns)) * found.known
    places = [best, *_alternatives(found, allowed, samples, best)]
    return CoarseOffset(
        float(found.correlation[best]), cell_ns, (found.lags[places] * cell_ns).tolist())


def chance_ratio(samples: FloatArray, other: float) -> FloatArray:
    """Return the (K,) ratios of two mean squares that chance does not exceed.

    ``samples`` (K,) and ``other`` are the numbers of independent rotations behind the two. The
    logarithm of a mean square of n of them has the standard deviation ``sqrt(2 / (3 n))``.
    """
    variance = 2 / 3 * (1 / np.maximum(samples - 1, 1.0) + 1 / max(other - 1, 1.0))
    factor: FloatArray = np.exp(SIGNIFICANT * np.sqrt(variance))
    return factor


def _alternatives(
    lags: Lags, allowed: NDArray[np.bool_], samples: FloatArray, best: int,
) -> list[int]:
    """Return the indices of local minima that are not significantly worse than the ``best`` one.

    Only where ``allowed`` (K,) is true, the smallest offset first. ``samples`` (K,) are the
    numbers of independent rotations.
    """
    apart = lags.apart
    before, after = np.roll(apart, 1), np.roll(apart, -1)
    minima = (apart <= before) & (apart < after) & np.isfinite(np.maximum(before, after))
    places = np.concatenate([[best], np.flatnonzero(allowed & minima)])
    # A neighbour of the best one may have too little overlap.
    before, after = (
        np.where(np.isfinite(values), values, apart)[places] for values in (before, after))
    rise, slope = np.maximum(0.5 * (before + after) - apart[places], 0.0), after - before
    # The minimum between the cells, by a parabola, and its uncertainty.
    least = apart[places] - slope**2 / (16 * np.maximum(rise, np.finfo(float).tiny))
    # A minimum between two cells is uncertain by a tenth of the rise to the next cells.
    limit = max(float(least[0]), 0.0) + 0.1 * float(rise[0])
    near = least - 0.1 * rise <= limit * chance_ratio(samples[places], samples[best])
    found = places[near & (places != best)]
    return found[np.argsort(np.abs(lags.lags[found]), kind='stable')][:6].tolist()


def _without_pauses(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the stamps of both from 0 on, with common pauses shortened.

    Days between two bags, or decades before a clock is set, would make the cells too long. A
    shortened pause is still longer than any offset, so nothing is compared across it.
    """
    longest_ns = 2 * int(max(max_offset_s * 1e9, a.longest_step_ns, b.longest_step_ns))
    # Two sorted runs: a stable sort merges them. Equal stamps do no harm.
    both = np.sort(np.concatenate([a.stamps_ns, b.stamps_ns]), kind='stable')
    cut = np.concatenate([[0], np.cumsum(np.maximum(np.diff(both) - longest_ns, 0))]) + both[0]
    times_a, times_b = (
        trajectory.stamps_ns - cut[np.searchsorted(both, trajectory.stamps_ns)]
        for trajectory in (a, b))
    return times_a, times_b


def _reached(times: NDArray[np.int64], reach_ns: int) -> tuple[int, int]:
    """Return the time span in which the other sensor can overlap with this one."""
    return int(times[0]) - reach_ns, int(times[-1]) + reach_ns


def _rotation_per_cell(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], cell_ns: int, common: tuple[int, int],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the (K, 3) rotation in each cell, in the axes of the sensor, and a (K,) valid mask.

    ``stamps_ns`` are those of the trajectory, counted from the first cell. Cells outside the
    ``common`` time span are not valid.
    """
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(trajectory.turns, axis=0)])
    edges = np.arange(0, int(stamps_ns[-1]) + cell_ns, cell_ns)
    at_edges = np.column_stack([np.interp(edges, stamps_ns, axis) for axis in total.T])
    inside = ((edges[:-1] >= max(int(stamps_ns[0]), common[0]))
              & (edges[1:] <= min(int(stamps_ns[-1]), common[1])))
    left = np.clip(np.searchsorted(stamps_ns, edges, side='right') - 1, 0, len(stamps_ns) - 2)
    known = inside & ~trajectory.gaps[left[:-1]] & ~trajectory.gaps[left[1:]]
    return np.diff(at_edges, axis=0) * known[:, None], known


def _correlate(
    a: FloatArray, known_a: NDArray[np.bool_], b: FloatArray, known_b: NDArray[np.bool_],
    reach: int, cell_ns: int,
) -> Lags:
    """Compare ``a[k + lag]`` with ``b[k]`` for all lags up to ``reach`` cells."""
    size = 1 << (len(a) + len(b) - 1).bit_length()

    def transform(values: FloatArray) -> NDArray[np.complex128]:
        return np.fft.rfft(values, size, axis=0)

    def products(left: FloatArray, right: FloatArray) -> FloatArray:
        spectrum = transform(left)[:, :, None] * transform(right).conj()[:, None, :]
        return np.fft.irfft(spectrum, size, axis=0)[lags]

    reach = min(reach, size // 2 - 1)
    lags = np.arange(-reach, reach + 1, dtype=np.int64)
    covariance = products(a, b)
    square_a, square_b = (np.sum(v**2, axis=1, keepdims=True) for v in (a, b))
    weight_a, weight_b = (k.astype(np.float64)[:, None] for k in (known_a, known_b))
    energy_a = products(square_a, weight_b)[:, 0, 0]
    energy_b = products(weight_a, square_b)[:, 0, 0]
    overlap = products(weight_a, weight_b)[:, 0, 0]
    gain = kabsch_gain(covariance)
    energy = np.sqrt(np.maximum(energy_a * energy_b, 0.0))
    # A candidate has at least 30 % of the cells of the shorter trajectory in common.
    enough = overlap > max(0.3 * min(known_a.sum(), known_b.sum()), 1.0)
    usable = enough & (energy > 1e-9 * max(float(energy.max()), np.finfo(float).tiny))
    correlation = np.where(usable, gain / np.where(usable, energy, 1.0), 0.0)
    known = np.maximum(overlap, 1.0)
    # Rounding may give a negative square; a negative correlation is no candidate.
    apart = np.where(
        correlation > 0, np.maximum((energy_a + energy_b - 2 * gain) / known, 0.0), np.inf)
    return Lags(cell_ns, lags, correlation, apart, known)
