# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a solver that identifies the noise says of a pair of trajectories, as plain data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Jump:
    """A step in which the two trajectories part: a loop closure or a lost track.

    Attributes
    ----------
    stamp_ns : time of the pose after it.
    translation_m, rotation_rad : its size.

    """

    stamp_ns: int
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Diagnosis:
    """The noise of a pair of trajectories, both sensors taken as equally noisy.

    Attributes
    ----------
    white_m, white_rad : standard deviation of the white noise of a pose, for each sensor.
    walk_m, walk_rad : of what both drift apart in a metre; it grows with the root of the way.
    jumps : steps in which the trajectories part, the largest first.
    scale, scale_deviation : metres of a per metre of b; the deviation is None where the scale
        was fixed. Likewise the following.
    time_offset_s, time_offset_deviation_s : added to the stamps of b, on top of the setting.
    systematic_drift, systematic_drift_deviation : metres per metre along x, y, z of b.
    latency_s, latency_deviation_s : by which the position of b is older than its attitude; below
        zero where that of a is.
    saturation : rho, the correlation of the noise at short times with the motion.

    """

    white_m: float
    white_rad: float
    walk_m: float
    walk_rad: float
    jumps: tuple[Jump, ...]
    scale: float
    scale_deviation: float | None
    time_offset_s: float
    time_offset_deviation_s: float | None
    systematic_drift: tuple[float, ...]
    systematic_drift_deviation: tuple[float, ...] | None
    latency_s: float
    latency_deviation_s: float
    saturation: float
