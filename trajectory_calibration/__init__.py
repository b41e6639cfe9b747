# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Extrinsic calibration of two sensors from their trajectories.

``calibrate(trajectory_a, trajectory_b)`` finds the pose of sensor b in sensor a. This import
needs NumPy only; CasADi and ROS are imported where they are used.
"""

from typing import Any, TYPE_CHECKING

from trajectory_calibration.assessment.metrics import AbsoluteErrors, RelativeErrors
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import (
    AssociationError,
    CalibrationError,
    ConfigError,
    MotionError,
    ResultError,
    SolverError,
    SourceError,
    TopicError,
    TrajectoryError,
)
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.version import __version__

if TYPE_CHECKING:
    from trajectory_calibration.rig.calibration import calibrate_rig

__all__ = [
    'AbsoluteErrors',
    'AssociationError',
    'CalibrationConfig',
    'CalibrationError',
    'CalibrationResult',
    'ConfigError',
    'MotionError',
    'RelativeErrors',
    'ResultError',
    'SolverError',
    'SourceError',
    'TopicError',
    'Trajectory',
    'TrajectoryError',
    '__version__',
    'calibrate',
    'calibrate_rig',
]


def __getattr__(name: str) -> Any:
    # Importing the rig takes a tenth of a second, which a calibration of two sensors saves.
    if name == 'calibrate_rig':
        from trajectory_calibration.rig.calibration import calibrate_rig
        return calibrate_rig
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
