# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Several sensors of one vehicle: answers of pairs become one consistent rig."""

from trajectory_calibration.rig.calibration import calibrate_rig, fuse_results
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.rig.settings import RigConfig, SensorSettings

__all__ = ['RigConfig', 'RigResult', 'SensorSettings', 'calibrate_rig', 'fuse_results']
