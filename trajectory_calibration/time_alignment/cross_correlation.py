# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Offsets between two clocks at which two sensors turned alike, on a grid of cells.

The rotations of both in every cell are compared at every offset by the largest correlation that
any rotation between the sensors allows: the nuclear norm of the cross-covariance, Kabsch's gain.
One fast Fourier transform gives it for all offsets.

For one axis and known mounting this is the usual correlation of angular rates: J. Kelly, G. S.
Sukhatme, "A general framework for temporal calibration of multiple proprioceptive and
exteroceptive sensors", ISER 2010, doi:10.1007/978-3-642-28572-1_14.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.rotation_increments import largest_gain

# Cells of the grid, at the most.
_MAX_CELLS = 2**18

# The shortest cell, nanoseconds: faster turning is vibration.
_LEAST_CELL_NS = 5_000_000

# An offset must leave this share of what is known of the shorter trajectory in common.
_LEAST_OVERLAP = 0.3

# An offset is told from another by so many standard deviations of how much the two disagree there.
_TOLD_APART = 5.0
# Of what a disagreement rises by to the next cells, this much is not known of its least.
_BOTTOM_SHARE = 0.1


class CoarseOffset(NamedTuple):
    """Where two sensors turned alike.

    Attributes
    ----------
    correlation : of the rotations at the best offset, 0 to 1.
    cell_ns : of the grid.
    starts_ns : multiples of it: the best offset, then others that chance leaves possible, the
        nearest to zero first.

    """

    correlation: float
    cell_ns: int
    starts_ns: list[int]


class Lags(NamedTuple):
    """How two sensors compare at (K,) lags, int64, in cells of ``cell_ns`` nanoseconds.

    (K,) correlations, 0 where too little is known of both; mean squared differences of their turns
    in a cell, squared radians; numbers of cells in which both are known.
    """

    cell_ns: int
    lags: NDArray[np.int64]
    correlation: FloatArray
    apart: FloatArray
    known: FloatArray


def correlate(
    a: Trajectory, b: Trajectory, reach_s: float, least_cell_ns: float = _LEAST_CELL_NS,
) -> Lags:
    """Compare the turns of both with b later by all lags of at most ``reach_s``, and a few more.

    The cells of the grid are at least ``least_cell_ns`` and half a step of either.
    """
    times_a, times_b = _without_pauses(a, b, reach_s)
    span = max(int(times_a[-1]), int(times_b[-1]))
    cell_ns = int(max(a.usual_step_ns / 2, b.usual_step_ns / 2, least_cell_ns, span / _MAX_CELLS))
    reach_ns = round(reach_s * 1e9)
    return _correlate(
        *_turned_in_cells(a, times_a, cell_ns, _reached(times_b, reach_ns)),
        *_turned_in_cells(b, times_b, cell_ns, _reached(times_a, reach_ns)),
        # One lag beyond the allowed ones on either side, to compare those with.
        int(reach_s * 1e9 / cell_ns) + 3, cell_ns)


def find_coarse_offset(a: Trajectory, b: Trajectory, max_offset_s: float) -> CoarseOffset | None:
    """Return the offset of b within ``max_offset_s`` of the largest correlation, and its rivals.

    None where nothing correlates.
    """
    found = correlate(a, b, max_offset_s)
    cell_ns = found.cell_ns
    # One lag beyond the limit on either side, or an offset at the limit could not be refined.
    allowed = np.abs(found.lags) * cell_ns <= max_offset_s * 1e9 + cell_ns
    if not (found.correlation[allowed] > 0).any():
        return None
    best = int(np.argmax(np.where(allowed, found.correlation, -1.0)))
    # Cells shorter than a step share its noise.
    samples = min(1.0, cell_ns / max(a.usual_step_ns, b.usual_step_ns)) * found.known
    places = [best, *_rivals(found, allowed, samples, best)]
    return CoarseOffset(
        float(found.correlation[best]), cell_ns, (found.lags[places] * cell_ns).tolist())


def chance_factor(samples: FloatArray, other: float) -> FloatArray:
    """Return by what factor mean squares of so many (K,) and ``other`` turns differ by chance.

    Their logarithms scatter by ``sqrt(2 / (3 n))``.
    """
    variance = 2 / 3 * (1 / np.maximum(samples - 1, 1.0) + 1 / max(other - 1, 1.0))
    factor: FloatArray = np.exp(_TOLD_APART * np.sqrt(variance))
    return factor


def _rivals(
    lags: Lags, allowed: NDArray[np.bool_], samples: FloatArray, best: int,
) -> list[int]:
    """Return where else the two may be apart as little as at the ``best`` of the (K,) lags.

    Those are local minima where it is ``allowed``, the nearest to lag zero first; ``samples``
    (K,) is the number of independent turns behind each.
    """
    apart = lags.apart
    before, after = np.roll(apart, 1), np.roll(apart, -1)
    minima = (apart <= before) & (apart < after) & np.isfinite(np.maximum(before, after))
    places = np.concatenate([[best], np.flatnonzero(allowed & minima)])
    # Beside the best one may be what is no candidate.
    before, after = (
        np.where(np.isfinite(values), values, apart)[places] for values in (before, after))
    rise, slope = np.maximum(0.5 * (before + after) - apart[places], 0.0), after - before
    # Between the cells, by a parabola; and how far that may be off.
    least = apart[places] - slope**2 / (16 * np.maximum(rise, np.finfo(float).tiny))
    limit = max(float(least[0]), 0.0) + _BOTTOM_SHARE * float(rise[0])
    near = least - _BOTTOM_SHARE * rise <= limit * chance_factor(samples[places], samples[best])
    found = places[near & (places != best)]
    return found[np.argsort(np.abs(lags.lags[found]), kind='stable')][:6].tolist()


def _without_pauses(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the stamps of both, from 0 on, with the pauses that both make cut short.

    Between two bags lie days, and before a clock is set decades: cells that filled them would be
    too long to tell anything. What is left of a pause is a gap of both, longer than any offset, so
    that nothing is compared across it.
    """
    longest_ns = 2 * int(max(max_offset_s * 1e9, a.longest_step_ns, b.longest_step_ns))
    # Two ascending runs: a stable sort merges them. Stamps that both have do no harm.
    both = np.sort(np.concatenate([a.stamps_ns, b.stamps_ns]), kind='stable')
    cut = np.concatenate([[0], np.cumsum(np.maximum(np.diff(both) - longest_ns, 0))]) + both[0]
    times_a, times_b = (
        trajectory.stamps_ns - cut[np.searchsorted(both, trajectory.stamps_ns)]
        for trajectory in (a, b))
    return times_a, times_b


def _reached(times: NDArray[np.int64], reach_ns: int) -> tuple[int, int]:
    """Return the time in which the other sensor may have turned with this one."""
    return int(times[0]) - reach_ns, int(times[-1]) + reach_ns


def _turned_in_cells(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], cell_ns: int, common: tuple[int, int],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (K, 3) rotation in each cell, about the axes of the sensor, and which are known.

    ``stamps_ns`` are those of the trajectory, counted from the first cell; what lies outside of
    the ``common`` time does not count.
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
    """Compare ``a[k + lag]`` with ``b[k]`` at all lags of at most ``reach`` cells."""
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
    gain = largest_gain(covariance)
    energy = np.sqrt(np.maximum(energy_a * energy_b, 0.0))
    enough = overlap > max(_LEAST_OVERLAP * min(known_a.sum(), known_b.sum()), 1.0)
    usable = enough & (energy > 1e-9 * max(float(energy.max()), np.finfo(float).tiny))
    correlation = np.where(usable, gain / np.where(usable, energy, 1.0), 0.0)
    known = np.maximum(overlap, 1.0)
    # Rounding may leave less than nothing; what goes against each other is no candidate.
    apart = np.where(
        correlation > 0, np.maximum((energy_a + energy_b - 2 * gain) / known, 0.0), np.inf)
    return Lags(cell_ns, lags, correlation, apart, known)
