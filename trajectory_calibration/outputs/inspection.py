# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inspection of one trajectory: rate, gaps, motion, and whether it suffices to calibrate."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import axis_name, translation_gain
from trajectory_calibration.assessment.orientation_checks import order_doubts
from trajectory_calibration.data.findings import texts, worst_first
from trajectory_calibration.data.plausibility import position_doubts, time_doubts
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Duration of the motions, about that of a turn at a crossing: over longer ones a SLAM drifts, over
# shorter ones noise dominates.
_WINDOW_NS = 2_000_000_000

# Residual per metre of translation error, over motions of that duration. Below the first limit
# the rotation is as small as the noise of a SLAM; below the second, the standard deviation of the
# translation is decimetres at best.
_INSUFFICIENT_GAIN = 0.02
_WEAK_GAIN = 0.1


def inspect_trajectory(trajectory: Trajectory, name: str, kind: str) -> dict[str, Any]:
    """Describe a trajectory and whether its motion determines an extrinsic.

    ``name`` is its file or topic, ``kind`` the format or message type. Returns plain data for
    JSON, with the unit in each name.
    """
    steps_s = np.diff(trajectory.stamps_ns) * 1e-9
    rotations = _window_rotations(trajectory)
    rotation_rms = np.sqrt(np.mean(se3.log_so3(rotations) ** 2, axis=0))
    motion, advice = _judge(*translation_gain(rotations))
    findings = worst_first((
        *trajectory.findings, *time_doubts(trajectory), *position_doubts(trajectory),
        *order_doubts(trajectory)))
    return {
        'name': name,
        'kind': kind,
        'sensor_frame': trajectory.sensor_frame,
        'world_frame': trajectory.world_frame,
        'poses': len(trajectory),
        'start_s': float(trajectory.stamps_ns[0]) * 1e-9,
        'duration_s': trajectory.duration_s,
        'rate_hz': 1e9 / trajectory.usual_step_ns,
        'gaps': int(np.count_nonzero(trajectory.gaps)),
        'longest_gap_s': float(steps_s.max()),
        # Includes noise.
        'path_length_m': float(
            np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1).sum()),
        # Root mean square of rotation vectors over the window, in the axes of the sensor.
        'turned_deg': np.rad2deg(rotation_rms).tolist(),
        'motion': motion,
        'advice': advice,
        'findings': [found.to_dict() for found in findings],
        'warnings': list(texts(findings)),
    }


def _window_rotations(trajectory: Trajectory) -> FloatArray:
    """Return the (M, 3, 3) rotations of the sensor over the window, in its own axes."""
    stamps_ns = trajectory.stamps_ns
    window_ns = min(_WINDOW_NS, int(stamps_ns[-1] - stamps_ns[0]))
    end = np.searchsorted(stamps_ns, stamps_ns + window_ns)
    start = np.flatnonzero(end < len(stamps_ns))
    R = trajectory.rotations
    return np.swapaxes(R[start], 1, 2) @ R[end[start]]


def _judge(gain: FloatArray, axes: FloatArray) -> tuple[str, str]:
    """Return status and advice from ascending gains (3,) and their axes, the rows of (3, 3)."""
    # Rotations about one axis do not determine the translation along it: the weakest direction
    # of the translation is the axis of rotation.
    axis = axis_name(axes[0])
    if gain[1] < _INSUFFICIENT_GAIN:
        return 'insufficient', (
            'it hardly turned: neither the rotation nor the translation can be determined; drive '
            'curves, and a ramp or a bank')
    if gain[0] < _INSUFFICIENT_GAIN:
        return 'insufficient', (
            f'it turned about {axis} only: the translation along {axis} will not be determined; '
            'drive a ramp or a bank')
    if gain[0] < _WEAK_GAIN:
        return 'weak', (
            f'it turned mostly about {axis}: the translation along {axis} will be uncertain; '
            'drive steeper ramps or banks, or longer')
    return 'sufficient', 'it turned about enough axes to determine rotation and translation'
