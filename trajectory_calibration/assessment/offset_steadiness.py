# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether one clock offset holds along a whole drive, as it does for sensors of one vehicle.

Two cars on one road turn at the same places, so that some offset makes their turns agree. But
the distance between them changes, and the offset with it, by far more than clocks do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.time_alignment.clock_drift import half_width_ns, shifts_along
from trajectory_calibration.time_alignment.clock_offset import Clock
from trajectory_calibration.time_alignment.rotation_increments import Turning

# The drive is cut into parts of equal turning.
_PARTS = 12
_LEAST_WINDOWS = 10
_LEAST_CELL_NS = 5_000_000


class Steadiness(NamedTuple):
    """How an offset varies along a drive.

    Attributes
    ----------
    scatter_s : root mean square over the parts of the drive, seconds, off a straight line.
    chi_squared : the same relative to its errors, per degree of freedom; one where it is steady.

    """

    scatter_s: float
    chi_squared: float


def offset_steadiness(a: Trajectory, b: Trajectory, clock: Clock) -> Steadiness | None:
    """Return how steady the offset of b is; None where the turning does not tell."""
    b = b.retimed(clock.drift, clock.drift_from_ns)
    cell_ns = round(max(a.usual_step_ns / 2, b.usual_step_ns / 2, _LEAST_CELL_NS))
    turning = Turning.over_windows(a, b, round(clock.offset_s * 1e9), cell_ns)
    if turning is None or len(turning) < _PARTS * _LEAST_WINDOWS:
        return None
    half_ns = half_width_ns(a, cell_ns)
    # Not of equal time: who stands still for half of it says nothing of clocks then.
    energy = np.cumsum(np.sum((turning.of_a(half_ns) - turning.of_a(-half_ns))**2, axis=1))
    part = np.minimum((_PARTS * energy / max(energy[-1], 1e-300)).astype(int), _PARTS - 1)
    found = shifts_along(turning, half_ns, part[:, None] == np.arange(_PARTS))
    if found is None:
        return None
    shifts, stds = found
    middle = np.array([np.median(turning.starts_ns[part == k] - turning.middle_ns)
                       if (part == k).any() else np.nan for k in range(_PARTS)])
    good = np.isfinite(middle) & (stds > 0)
    if good.sum() < _PARTS // 2:
        return None
    weights, middle, shifts = 1 / stds[good]**2, middle[good], shifts[good]
    line = np.polyfit(middle, shifts, 1, w=np.sqrt(weights))
    left = shifts - np.polyval(line, middle)
    squares = float(np.sum(weights * left**2))
    return Steadiness(np.sqrt(squares / float(np.sum(weights))), squares / (len(middle) - 2))
