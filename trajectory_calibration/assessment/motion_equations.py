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

# Number of motions that is enough for a check.
ENOUGH = 2000


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
    pairs: PosePairs, lag_s: float, *, fewest: int,
) -> MotionPairs | None:
    """Return at most ``ENOUGH`` motions over ``lag_s``, without gaps and half turns.

    None if there are fewer than ``fewest``.
    """
    (lag,) = lag_grid(pairs.stamps_ns, (lag_s,), 1.0)
    # Four start within one lag: more would share most of their noise.
    count = min(ENOUGH, 4 * len(pairs) // lag)
    if count < fewest:
        return None
    motions = select_motions(pairs, f'B{lag}', count)
    time_ns = pairs.stamps_ns[motions.j] - pairs.stamps_ns[motions.i]
    turn = np.maximum(*(se3.rotation_angle(poses[:, :3, :3]) for poses in (motions.A, motions.B)))
    # Motions that last much longer than the median span gaps.
    motions = motions.picked(
        (time_ns < 2.5 * np.median(time_ns)) & (turn < se3.LARGEST_ROTATION))
    return None if len(motions) < fewest else motions


def student_weights(residuals: FloatArray) -> FloatArray:
    """Return the (K,) weights (inverse variances) of (K, 3) residuals by Student's t_4."""
    square = np.sum(residuals**2, axis=1)
    variance = max(float(np.median(square)) / quantile(3, 0.5), np.finfo(float).tiny)
    weights: FloatArray = (4 + 3) / (4 + square / variance) / variance
    return weights
