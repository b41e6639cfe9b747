# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Both tracks in one world, so that a person sees whether they fit. Nothing here imports ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.tracks import registration
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.time_alignment.align import match_at
from trajectory_calibration.time_alignment.clock_offset import Clock

# More poses than a person can tell apart only slow the display down.
_MOST_POSES = 2000


@dataclass(frozen=True, eq=False)
class Overlay:
    """The (K, 4, 4) poses of sensor a in its world, as a and as b reported them.

    Those of b are ``Z B_k T_a_b^-1``: carried to a by the extrinsic, and into the world of a by
    the Z that fits all of them best.
    """

    world_frame: str
    stamps_ns: NDArray[np.int64]
    poses_a: FloatArray
    poses_b: FloatArray


def make_overlay(a: Trajectory, b: Trajectory, result: CalibrationResult) -> Overlay:
    """Lay the tracks of a calibration over each other."""
    clock = Clock(result.time_offset_s, result.clock_drift, result.clock_drift_from_ns)
    pairs = match_at(a, b, clock, result.config)
    chosen = slice(None, None, -(-len(pairs) // _MOST_POSES))
    poses_a, poses_b = pairs.poses_a[chosen], pairs.poses_b[chosen].copy()
    poses_b[:, :3, 3] *= result.scale
    poses_b = poses_b @ se3.inverse(result.T_a_b)
    return Overlay(a.world_frame, pairs.stamps_ns[chosen], poses_a,
                   registration(poses_a, poses_b) @ poses_b)
