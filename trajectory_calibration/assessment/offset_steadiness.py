# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the clock offset is constant along a drive, as it is for two sensors of one vehicle.

Two cars on one road turn at the same places, so some clock offset fits both. But the distance
between the cars changes, and the offset with it, by far more than clocks drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.time_alignment.clock_drift import (
    fit_offsets,
    half_width_ns,
    LEAST_WINDOWS,
)
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection
from trajectory_calibration.time_alignment.cross_correlation import cell_between
from trajectory_calibration.time_alignment.rotation_increments import RotationIncrements

# The drive is split into parts with the same angular acceleration energy.
_PARTS = 12


class Steadiness(NamedTuple):
    """How the clock offset varies along a drive.

    Attributes
    ----------
    scatter_s : root mean square deviation from a straight line over the parts, seconds.
    unsteady : whether that is no chance: beyond the quantile of chi-squared at the one false-alarm
        probability.

    """

    scatter_s: float
    unsteady: bool


def offset_steadiness(a: Trajectory, b: Trajectory, clock: ClockCorrection) -> Steadiness | None:
    """Return how steady the clock offset of b is; None if the rotations do not determine it."""
    b = b.retimed(clock.drift, clock.drift_from_ns)
    cell_ns = cell_between(a, b)
    increments = RotationIncrements.over_windows(a, b, round(clock.offset_s * 1e9), cell_ns)
    if increments is None or len(increments) < _PARTS * LEAST_WINDOWS:
        return None
    half_ns = half_width_ns(a, cell_ns)
    # Not parts of equal time: a stationary vehicle gives no information on clocks.
    change = increments.rotations_a(half_ns) - increments.rotations_a(-half_ns)
    energy = np.cumsum(np.sum(change**2, axis=1))
    part = np.minimum((_PARTS * energy / max(energy[-1], 1e-300)).astype(int), _PARTS - 1)
    found = fit_offsets(increments, half_ns, part[:, None] == np.arange(_PARTS))
    if found is None:
        return None
    shifts, stds = found
    middle = np.array([np.median(increments.starts_ns[part == k] - increments.middle_ns)
                       if (part == k).any() else np.nan for k in range(_PARTS)])
    good = np.isfinite(middle) & (stds > 0)
    if good.sum() < _PARTS // 2:
        return None
    weights, middle, shifts = 1 / stds[good]**2, middle[good], shifts[good]
    line = np.polyfit(middle, shifts, 1, w=np.sqrt(weights))
    left = shifts - np.polyval(line, middle)
    squares = float(np.sum(weights * left**2))
    return Steadiness(np.sqrt(squares / float(np.sum(weights))),
                      squares > quantile(len(middle) - 2))
