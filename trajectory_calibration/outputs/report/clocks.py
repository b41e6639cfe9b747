# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How fast each sensor turned and when: what the clocks and the gaps look like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.cross_correlation import correlate

# Seconds of the part that is drawn, and points in it.
_PART_S, _POINTS = 30.0, 300
# Lags of the comparison on either side.
_LAGS = 60
# Least seconds that are compared on either side, and least length of a window of rotation.
_REACH_S, _WINDOW_S = 0.5, 0.2


@dataclass(frozen=True, eq=False)
class Clocks:
    """When the two sensors turned, and when they have poses.

    Rates, (P,) degrees a second, NaN in gaps, at ``seconds`` from the start, of the part with the
    most turning; ``correlation``, (L,), of the rotations with ``offsets_s`` added to the stamps of
    b on top of the answer; spans, (S, 2) seconds from the start with poses and no gap.
    """

    seconds: FloatArray
    rate_a: FloatArray
    rate_b: FloatArray
    offsets_s: FloatArray
    correlation: FloatArray
    spans_a: FloatArray
    spans_b: FloatArray
    duration_s: float


def compare_clocks(a: Trajectory, b: Trajectory) -> Clocks:
    """Compare two trajectories whose stamps are in one clock."""
    start = int(min(a.stamps_ns[0], b.stamps_ns[0]))
    end = int(max(a.stamps_ns[-1], b.stamps_ns[-1]))
    usual_s = max(a.usual_step_ns, b.usual_step_ns) * 1e-9
    window_s = max(_WINDOW_S, 2 * usual_s)
    seconds = _busiest(a, b, start)
    return Clocks(
        seconds, _rate(a, seconds, start, window_s), _rate(b, seconds, start, window_s),
        *_correlate(a, b, usual_s), _spans(a, start), _spans(b, start), (end - start) * 1e-9)


def _seconds(trajectory: Trajectory, start: int) -> FloatArray:
    return (trajectory.stamps_ns - start).astype(np.float64) * 1e-9


def _busiest(a: Trajectory, b: Trajectory, start: int) -> FloatArray:
    """Return times of the part of the common time in which both turned most."""
    times_a, times_b = _seconds(a, start), _seconds(b, start)
    low, high = max(times_a[0], times_b[0]), min(times_a[-1], times_b[-1])
    if high <= low:
        low, high = times_a[0], times_a[-1]
    length = min(_PART_S, high - low)
    begins = np.linspace(low, high - length, 200)
    turned = []
    for trajectory, times in ((a, times_a), (b, times_b)):
        # A rotation in a gap of one cannot be compared.
        angle = np.where(trajectory.gaps, 0.0, np.linalg.norm(trajectory.turns, axis=1))
        total = np.concatenate([[0.0], np.cumsum(angle)])
        turned.append(np.interp(begins + length, times, total) - np.interp(begins, times, total))
    begin = begins[np.argmax(np.minimum(*turned))]
    return np.linspace(begin, begin + length, _POINTS)


def _rate(trajectory: Trajectory, seconds: FloatArray, start: int, window_s: float) -> FloatArray:
    """Return (P,) degrees a second, by the angle over a window around each time."""
    times = _seconds(trajectory, start)
    first = np.clip(np.searchsorted(times, seconds - window_s / 2), 0, len(times) - 2)
    last = np.clip(np.searchsorted(times, seconds + window_s / 2), first + 1, len(times) - 1)
    R, took = trajectory.rotations, times[last] - times[first]
    angle = se3.rotation_angle(np.swapaxes(R[first], 1, 2) @ R[last])
    known = (seconds >= times[0]) & (seconds <= times[-1]) & (
        took < trajectory.longest_step_ns * 1e-9 + window_s)
    return np.where(known, np.rad2deg(angle) / took, np.nan)


def _correlate(a: Trajectory, b: Trajectory, usual_s: float) -> tuple[FloatArray, FloatArray]:
    """Return offsets and the largest correlation that any rotation between both allows."""
    common_ns = min(a.stamps_ns[-1], b.stamps_ns[-1]) - max(a.stamps_ns[0], b.stamps_ns[0])
    reach_s = max(_REACH_S, 8 * usual_s)
    if common_ns < 3e9 * reach_s:
        return np.zeros(0), np.zeros(0)
    found = correlate(a, b, reach_s, 1e9 * reach_s / _LAGS)
    return found.lags.astype(np.float64) * (found.cell_ns * 1e-9), found.correlation


def _spans(trajectory: Trajectory, start: int) -> FloatArray:
    """Return (S, 2) seconds without a gap."""
    times, gaps = _seconds(trajectory, start), trajectory.gaps
    return np.column_stack([times[np.append(True, gaps)], times[np.append(gaps, True)]])
