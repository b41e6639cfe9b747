# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Solvers: relative motions of two sensors -> the extrinsic between them; one paper a module."""

from trajectory_calibration.solvers.registry import (
    DEFAULT_SOLVER,
    load_solver,
    noise_identifier,
    solver_info,
    SOLVER_NAMES,
    SolverInfo,
    solvers,
    solvers_that_estimate,
)

__all__ = [
    'DEFAULT_SOLVER',
    'SOLVER_NAMES',
    'SolverInfo',
    'load_solver',
    'noise_identifier',
    'solver_info',
    'solvers',
    'solvers_that_estimate',
]
