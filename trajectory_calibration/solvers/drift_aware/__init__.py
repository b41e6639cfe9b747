# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Maximum likelihood with white noise, drift and jumps in one model."""

from trajectory_calibration.solvers.drift_aware.solver import solve, solve_pairs

__all__ = ['solve', 'solve_pairs']
