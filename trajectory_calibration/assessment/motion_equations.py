# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The hand-eye equations of motions over one lag, for the checks of the input and of an answer.

Rotation: ``phi_A = R phi_B``. Translation: ``t_A + (R_A - I) t = s R t_B``, with the scale s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.motion_pairs import lag_grid, MotionPairs, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray

# Motions that start within one lag.
_OVERLAPPING = 4
# Motions that last longer than this many medians span gaps.
_LONG = 2.5
# Larger rotations (radians) are excluded: the axis of a rotation by 180 deg has no sign.
LARGEST_ROTATION = 2.6
# Degrees of freedom of Student's distribution, and the median of chi-squared of three.
_FREEDOM, _MEDIAN = 4.0, quantile(3, 0.5)


class MotionVectors(NamedTuple):
    """Rotation vectors phi and translations t of a and b, (K, 3), and (K, 3, 3) ``R_A - I``."""

    phi_a: FloatArray
    phi_b: FloatArray
    t_a: FloatArray
    t_b: FloatArray
    R_a_minus_I: FloatArray

    @classmethod
    def by(cls, A: FloatArray, B: FloatArray) -> MotionVectors:
        """Return the vectors of (K, 4, 4) motions."""
        R_A = A[:, :3, :3]
        return cls(se3.log_so3(R_A), se3.log_so3(B[:, :3, :3]), A[:, :3, 3], B[:, :3, 3],
                   R_A - np.eye(3))

    def residuals(self, T_a_b: FloatArray, scale: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return the (K, 3) residuals of both equations: rotation (rad), translation (m)."""
        R = T_a_b[:3, :3]
        return (self.phi_a - self.phi_b @ R.T,
                self.t_a + self.R_a_minus_I @ T_a_b[:3, 3] - scale * self.t_b @ R.T)

    def jacobians(self, T_a_b: FloatArray, scale: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return the (K, 3, 7) negative Jacobians of both residuals.

        The columns are the rotation (left perturbation), the translation and the log scale.
        """
        R = T_a_b[:3, :3]
        phi_b, t_b = self.phi_b @ R.T, scale * self.t_b @ R.T
        return (np.concatenate([-se3.skew(phi_b), np.zeros((len(phi_b), 3, 4))], axis=2),
                np.concatenate([-se3.skew(t_b), -self.R_a_minus_I, t_b[:, :, None]], axis=2))


def motions_over(
    pairs: PosePairs, lag_s: float, *, fewest: int, at_most: int,
) -> MotionPairs | None:
    """Return at most ``at_most`` motions over ``lag_s``, without gaps and half turns.

    None if there are fewer than ``fewest``.
    """
    (lag,) = lag_grid(pairs.stamps_ns, (lag_s,), 1.0)
    count = min(at_most, _OVERLAPPING * len(pairs) // lag)
    if count < fewest:
        return None
    motions = select_motions(pairs, f'B{lag}', count)
    time_ns = pairs.stamps_ns[motions.j] - pairs.stamps_ns[motions.i]
    turn = np.maximum(*(se3.rotation_angle(poses[:, :3, :3]) for poses in (motions.A, motions.B)))
    motions = motions.picked((time_ns < _LONG * np.median(time_ns)) & (turn < LARGEST_ROTATION))
    return None if len(motions) < fewest else motions


def student_weights(residuals: FloatArray) -> FloatArray:
    """Return the (K,) weights (inverse variances) of (K, 3) residuals with Student's t."""
    square = np.sum(residuals**2, axis=1)
    variance = max(float(np.median(square)) / _MEDIAN, np.finfo(float).tiny)
    weights: FloatArray = (_FREEDOM + 3) / (_FREEDOM + square / variance) / variance
    return weights
