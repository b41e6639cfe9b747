"""Park: rotation vectors aligned, then the translation by linear least squares.

C. Park, P. Moghadam, S. Kim, S. Sridharan, C. Fookes, "Spatiotemporal Camera-LiDAR Calibration:
A Targetless and Structureless Approach", IEEE Robotics and Automation Letters 5(2), 2020,
doi:10.1109/LRA.2020.2969164, coarse alignment; as replicated in doi:10.3390/s23073740, section
III-C. With ``M = sum phi_B phi_A^T`` the rotation is ``R = (M^T M)^(1/2) M^-1``, which in
singular vectors is Kabsch's solution, the one of ``taylor``: the two papers differ in what they
do with the alignment afterwards, which needs the sensors' own measurements.
"""

from __future__ import annotations

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.solvers.separable import solve_separable
from trajectory_calibration.solvers.solution import Solution


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic; raises MotionError for rotation about fewer than two axes."""
    return solve_separable(motions, config)
