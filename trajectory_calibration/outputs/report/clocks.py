# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Angular rates, their correlation by clock offset, and gaps: the data of the clock figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.cross_correlation import correlate

# Length of the part that is drawn, seconds, and its number of points.
_PART_S, _POINTS = 30.0, 300
# Lags of the correlation on either side.
_LAGS = 60
# Smallest range of lags on either side, and smallest window of an angular rate, seconds.
_REACH_S, _WINDOW_S = 0.5, 0.2


@dataclass(frozen=True, eq=False)
class Clocks:
    """Angular rates, correlation and gaps of two sensors; times are seconds from the start.

    ``rates`` (2, P) of a and b, deg/s, NaN in gaps, at ``seconds`` (P,): the part with the most
    rotation. ``correlation`` (L,) of the rotations with ``offsets_s`` (L,) added to the corrected
    stamps of b. ``spans`` of a and b: (S, 2) start and end of each stretch without a gap.
    """

    seconds: FloatArray
    rates: FloatArray
    offsets_s: FloatArray
    correlation: FloatArray
    spans: list[FloatArray]
    duration_s: float


def compare_clocks(a: Trajectory, b: Trajectory) -> Clocks:
    """Compare two trajectories with stamps of one clock."""
    both = a, b
    start = int(min(a.stamps_ns[0], b.stamps_ns[0]))
    times = [(item.stamps_ns - start).astype(np.float64) * 1e-9 for item in both]
    step_s = max(a.usual_step_ns, b.usual_step_ns) * 1e-9
    seconds = _busiest(both, times)
    return Clocks(
        seconds, np.array([_rate(item, own, seconds, max(_WINDOW_S, 2 * step_s))
                           for item, own in zip(both, times, strict=True)]),
        *_correlate(a, b, step_s),
        # From the first to the last pose of each stretch without a gap.
        [np.column_stack([own[np.append(True, item.gaps)], own[np.append(item.gaps, True)]])
         for item, own in zip(both, times, strict=True)], max(own[-1] for own in times))


def _busiest(both: tuple[Trajectory, Trajectory], times: list[FloatArray]) -> FloatArray:
    """Return (P,) times of the part of the common time in which both rotated most."""
    low, high = max(own[0] for own in times), min(own[-1] for own in times)
    if high <= low:
        low, high = times[0][0], times[0][-1]
    length = min(_PART_S, high - low)
    starts = np.linspace(low, high - length, 200)
    angles = []
    for trajectory, own in zip(both, times, strict=True):
        # A rotation in a gap cannot be compared.
        angle = np.where(trajectory.gaps, 0.0, np.linalg.norm(trajectory.turns, axis=1))
        total = np.concatenate([[0.0], np.cumsum(angle)])
        angles.append(np.interp(starts + length, own, total) - np.interp(starts, own, total))
    start = starts[np.argmax(np.minimum(*angles))]
    return np.linspace(start, start + length, _POINTS)


def _rate(
    trajectory: Trajectory, times: FloatArray, seconds: FloatArray, window_s: float,
) -> FloatArray:
    """Return (P,) angular rates, deg/s, over a window around each time; NaN in gaps."""
    first = np.clip(np.searchsorted(times, seconds - window_s / 2), 0, len(times) - 2)
    last = np.clip(np.searchsorted(times, seconds + window_s / 2), first + 1, len(times) - 1)
    R, duration = trajectory.rotations, times[last] - times[first]
    angle = se3.rotation_angle(np.swapaxes(R[first], 1, 2) @ R[last])
    known = (seconds >= times[0]) & (seconds <= times[-1]) & (
        duration < trajectory.longest_step_ns * 1e-9 + window_s)
    return np.where(known, np.rad2deg(angle) / duration, np.nan)


def _correlate(a: Trajectory, b: Trajectory, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return (L,) clock offsets, seconds, and correlations; empty for a short common time."""
    common_ns = min(a.stamps_ns[-1], b.stamps_ns[-1]) - max(a.stamps_ns[0], b.stamps_ns[0])
    reach_s = max(_REACH_S, 8 * step_s)
    if common_ns < 3e9 * reach_s:
        return np.zeros(0), np.zeros(0)
    found = correlate(a, b, reach_s, 1e9 * reach_s / _LAGS)
    return found.lags.astype(np.float64) * (found.cell_ns * 1e-9), found.correlation
