# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The four error measures of the paper (doi:10.3390/s23073740, section III-E)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray


class RelativeErrors(NamedTuple):
    """How well an extrinsic explains the relative motions; means over the motions.

    Small values do not prove a good extrinsic: short motions fit any one well.

    Attributes
    ----------
    e_rt : metres, mean of ``|R_A t + t_A - (R t_B + t)|``. The paper prints ``+ t`` outside the
        bracket, a slip of sign: the true extrinsic would not have error zero.
    e_rR : radians, mean angle of ``R_A R (R R_B)^-1``.

    """

    e_rt: float
    e_rR: float


class AbsoluteErrors(NamedTuple):
    """How far an extrinsic is from a known truth.

    Attributes
    ----------
    e_at : metres, ``|t - t_true|``.
    e_aR : radians, angle of ``R^-1 R_true``.

    """

    e_at: float
    e_aR: float


def relative_errors(T_a_b: FloatArray, motions: MotionPairs) -> RelativeErrors:
    """Return the mean errors of ``A T_a_b = T_a_b B`` over the motions."""
    left, right = motions.A @ T_a_b, T_a_b @ motions.B
    distance = np.linalg.norm(left[:, :3, 3] - right[:, :3, 3], axis=1)
    angle = se3.rotation_angle(left[:, :3, :3] @ np.swapaxes(right[:, :3, :3], 1, 2))
    return RelativeErrors(float(distance.mean()), float(angle.mean()))


def absolute_errors(T_a_b: FloatArray, T_a_b_true: FloatArray) -> AbsoluteErrors:
    """Return the distance and the angle between an extrinsic and the truth."""
    distance = np.linalg.norm(T_a_b[:3, 3] - T_a_b_true[:3, 3])
    angle = se3.rotation_angle(T_a_b[:3, :3].T @ T_a_b_true[:3, :3])
    return AbsoluteErrors(float(distance), float(angle))
