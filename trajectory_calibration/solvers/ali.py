# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ali: the translation rows of ``A X = X B`` over unit quaternion and translation.

I. Ali, O. Suominen, A. Gotchev, E. R. Morales, "Methods for Simultaneous Robot-World-Hand-Eye
Calibration: A Comparative Study", Sensors 19(12):2837, 2019, doi:10.3390/s19122837, cost Xc1; as
replicated in doi:10.3390/s23073740, section III-C. There the norm of a unit quaternion stands
where the rotation rows would act, which is constant, so that the cost is

    sum |R_A t + t_A - (R t_B + t)|^2.

It is minimised over the rotation itself rather than over a quaternion's four numbers: the minimum
is the same, and there is no scale left free.
"""

from __future__ import annotations

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.solution import Solution


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic of lowest cost (m^2); raises MotionError where nothing moved."""
    quadratic.require_motion(motions.pairs)
    minimum = quadratic.minimise(quadratic.gram(motions, rotation=False), prior=config.prior)
    T_a_b = quadratic.polish(minimum.T_a_b, motions, rotation=False)
    return Solution(
        T_a_b, minimum.cost, minimum.iterations, linearise=linear.translation_only)
