# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motions over one lag and their equations, for the checks of the input and of an answer.

Of turns ``log A = R log B`` and of ways ``v_a + (R_A - I) t = s R v_b``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.motion_pairs import lag_grid, MotionPairs, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray

# Motions that begin within one lag.
_OVERLAPPING = 4
# Longer ones, in terms of the usual, reach across gaps.
_LONG = 2.5
# Larger turns (radians) are left out: half a turn one way is half a turn the other way.
LARGEST_TURN = 2.6
# Degrees of freedom of Student's distribution, and the median of chi-squared of three.
_FREEDOM, _MEDIAN = 4.0, quantile(3, 0.5)


class Moved(NamedTuple):
    """(K, 3) turns and ways of a and b, and (K, 3, 3) ``R_A - I``, of K motions."""

    turn_a: FloatArray
    turn_b: FloatArray
    way_a: FloatArray
    way_b: FloatArray
    lever: FloatArray

    @classmethod
    def by(cls, A: FloatArray, B: FloatArray) -> Moved:
        """Return them for (K, 4, 4) motions."""
        R_A = A[:, :3, :3]
        return cls(se3.log_so3(R_A), se3.log_so3(B[:, :3, :3]), A[:, :3, 3], B[:, :3, 3],
                   R_A - np.eye(3))

    def left(self, T_a_b: FloatArray, scale: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return (K, 3) what an extrinsic and a scale of b leave of the turns and of the ways."""
        R = T_a_b[:3, :3]
        return (self.turn_a - self.turn_b @ R.T,
                self.way_a + self.lever @ T_a_b[:3, 3] - scale * self.way_b @ R.T)

    def slopes(self, T_a_b: FloatArray, scale: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return (K, 3, 7) by how much rotation, translation and log scale lessen what is left."""
        R = T_a_b[:3, :3]
        turn_b, way_b = self.turn_b @ R.T, scale * self.way_b @ R.T
        return (np.concatenate([-se3.skew(turn_b), np.zeros((len(turn_b), 3, 4))], axis=2),
                np.concatenate([-se3.skew(way_b), -self.lever, way_b[:, :, None]], axis=2))


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
    motions = motions.picked((time_ns < _LONG * np.median(time_ns)) & (turn < LARGEST_TURN))
    return None if len(motions) < fewest else motions


def weights_of(left: FloatArray) -> FloatArray:
    """Return (K,) weights, inverse variances, of (K, 3) residuals by Student's distribution."""
    square = np.sum(left**2, axis=1)
    variance = max(float(np.median(square)) / _MEDIAN, np.finfo(float).tiny)
    weights: FloatArray = (_FREEDOM + 3) / (_FREEDOM + square / variance) / variance
    return weights
