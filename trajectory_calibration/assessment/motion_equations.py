# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motions over one lag and their equations, for the checks of an answer.

Of turns ``log A = R log B`` and of ways ``v_a + (R_A - I) t = s R v_b``, which jumps hardly move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.motion_pairs import lag_grid, MotionPairs, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Motions that begin within one lag.
_OVERLAPPING = 4
# Longer ones, in terms of the usual, reach across gaps; larger turns (radians) flip their axis.
_LONG, _LARGEST_TURN = 2.5, 2.6
# Degrees of freedom of Student's distribution, and the median of chi-squared of three.
_FREEDOM, _MEDIAN = 4.0, 2.37


class Equations(NamedTuple):
    """(K, 3, 7) derivatives in rotation, translation and log scale; (K, 3) what is left."""

    J: FloatArray
    left: FloatArray


def motions_over(
    pairs: PosePairs, lag_s: float, *, fewest: int, at_most: int,
) -> MotionPairs | None:
    """Return motions of so many seconds without gaps and half turns; None for too few."""
    (lag,) = lag_grid(pairs.stamps_ns, (lag_s,), 1.0)
    count = min(at_most, _OVERLAPPING * len(pairs) // lag)
    if count < fewest:
        return None
    motions = select_motions(pairs, f'B{lag}', count)
    time_ns = pairs.stamps_ns[motions.j] - pairs.stamps_ns[motions.i]
    turn = np.maximum(*(se3.rotation_angle(poses[:, :3, :3]) for poses in (motions.A, motions.B)))
    motions = motions.picked((time_ns < _LONG * np.median(time_ns)) & (turn < _LARGEST_TURN))
    return None if len(motions) < fewest else motions


def linearised(
    T_a_b: FloatArray, motions: MotionPairs, scale: float = 1.0,
) -> tuple[Equations, Equations]:
    """Return the equations of the turns and of the ways about an extrinsic and a scale of b."""
    A, B, R = motions.A, motions.B, T_a_b[:3, :3]
    turn_b, way_b = se3.log_so3(B[:, :3, :3]) @ R.T, scale * B[:, :3, 3] @ R.T
    lever = A[:, :3, :3] - np.eye(3)
    return (
        Equations(np.concatenate([-se3.skew(turn_b), np.zeros((len(A), 3, 4))], axis=2),
                  se3.log_so3(A[:, :3, :3]) - turn_b),
        Equations(np.concatenate([-se3.skew(way_b), -lever, way_b[:, :, None]], axis=2),
                  A[:, :3, 3] + lever @ T_a_b[:3, 3] - way_b))


def weights_of(left: FloatArray) -> FloatArray:
    """Return (K,) weights, inverse variances, of (K, 3) residuals by Student's distribution."""
    square = np.sum(left**2, axis=1)
    variance = max(float(np.median(square)) / _MEDIAN, np.finfo(float).tiny)
    weights: FloatArray = (_FREEDOM + 3) / (_FREEDOM + square / variance) / variance
    return weights
