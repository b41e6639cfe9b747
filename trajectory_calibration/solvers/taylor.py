"""Taylor: Kabsch's rotation, then the translation by linear least squares.

Z. Taylor, J. Nieto, "Motion-based calibration of multimodal sensor arrays", IEEE International
Conference on Robotics and Automation (ICRA), 2015, pp. 4843-4850,
doi:10.1109/ICRA.2015.7139872, section III-B; as replicated in doi:10.3390/s23073740, section
III-C: every motion with the same weight, because a trajectory file carries no covariance.
"""

from __future__ import annotations

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.solvers.separable import solve_separable
from trajectory_calibration.solvers.solution import Solution


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic; raises MotionError for rotation about fewer than two axes."""
    return solve_separable(motions, config)
