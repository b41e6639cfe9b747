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

    ``rates`` of a and b, (2, P) degrees a second, NaN in gaps, at ``seconds`` from the start, of
    the part with the most turning; ``correlation``, (L,), of the rotations with ``offsets_s``
    added to the stamps of b on top of the answer; ``spans`` of a and b, (S, 2) seconds from the
    start with poses and no gap.
    """

    seconds: FloatArray
    rates: FloatArray
    offsets_s: FloatArray
    correlation: FloatArray
    spans: list[FloatArray]
    duration_s: float


def compare_clocks(a: Trajectory, b: Trajectory) -> Clocks:
    """Compare two trajectories whose stamps are in one clock."""
    both = a, b
    start = int(min(a.stamps_ns[0], b.stamps_ns[0]))
    times = [(item.stamps_ns - start).astype(np.float64) * 1e-9 for item in both]
    usual_s = max(a.usual_step_ns, b.usual_step_ns) * 1e-9
    seconds = _busiest(both, times)
    return Clocks(
        seconds, np.array([_rate(item, own, seconds, max(_WINDOW_S, 2 * usual_s))
                           for item, own in zip(both, times, strict=True)]),
        *_correlate(a, b, usual_s),
        # From the first pose of each stretch without a gap to its last.
        [np.column_stack([own[np.append(True, item.gaps)], own[np.append(item.gaps, True)]])
         for item, own in zip(both, times, strict=True)], max(own[-1] for own in times))


def _busiest(both: tuple[Trajectory, Trajectory], times: list[FloatArray]) -> FloatArray:
    """Return times of the part of the common time in which both turned most."""
    low, high = max(own[0] for own in times), min(own[-1] for own in times)
    if high <= low:
        low, high = times[0][0], times[0][-1]
    length = min(_PART_S, high - low)
    begins = np.linspace(low, high - length, 200)
    turned = []
    for trajectory, own in zip(both, times, strict=True):
        # A rotation in a gap of one cannot be compared.
        angle = np.where(trajectory.gaps, 0.0, np.linalg.norm(trajectory.turns, axis=1))
        total = np.concatenate([[0.0], np.cumsum(angle)])
        turned.append(np.interp(begins + length, own, total) - np.interp(begins, own, total))
    begin = begins[np.argmax(np.minimum(*turned))]
    return np.linspace(begin, begin + length, _POINTS)


def _rate(
    trajectory: Trajectory, times: FloatArray, seconds: FloatArray, window_s: float,
) -> FloatArray:
    """Return (P,) degrees a second, by the angle over a window around each time."""
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
