# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether two trajectories were measured apart, or one was computed from the other.

Two sensors never turn alike to the last digit. Where they do and their positions differ, one is a
smoothed or filtered copy of the other, or both took their orientation from one sensor. What their
positions differ by then follows the motion, as no noise does, and no standard deviation holds.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.motion_equations import linearised
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

_MOTIONS, _FEWEST = 2000, 20
# Radians of a step that are digits of a file, and metres that are none.
_DIGITS, _APART = 1e-7, 1e-5
# A steady drift leaves less than this share of what they differ by.
_NO_DRIFT = 0.3
# Steps turn by so many times more, or they say nothing.
_TURNED = 100.0


def one_orientation(
    T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding where both sensors have the orientation of one, and other positions.

    ``pairs`` have the scale of b corrected. Jumps and a steady drift are no reason: simulated
    trajectories have nothing else.
    """
    motions = select_motions(pairs, 'B1', _MOTIONS)
    if len(motions) < _FEWEST:
        return ()
    turns, ways = linearised(T_a_b, motions)
    parted = float(np.median(np.linalg.norm(turns.left, axis=1)))
    turned = float(np.median(se3.rotation_angle(motions.A[:, :3, :3])))
    if parted > _DIGITS or turned < _TURNED * _DIGITS:
        return ()
    rest, length = ways.left, np.linalg.norm(motions.B[:, :3, 3], axis=1)[:, None]
    drift = np.median(rest / np.maximum(length, np.finfo(float).tiny), axis=0)
    apart = float(np.median(np.linalg.norm(rest - drift * length, axis=1)))
    if apart < max(_APART, _NO_DRIFT * float(np.median(np.linalg.norm(rest, axis=1)))):
        return ()
    return (Finding(
        'orientations-identical',
        f'{frames[0]} and {frames[1]} turn alike to the last digit, but their positions differ: '
        'one was computed from the other, or both from one IMU? The standard deviations do not '
        'hold. Give trajectories that were measured apart', {'parted_rad': parted}),)
