# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many recordings of the same sensors: whether an extrinsic holds, and when a sensor moved."""

from trajectory_calibration.fleet.comparison import compare, Comparison, Entry
from trajectory_calibration.fleet.verification import Verification, verify

__all__ = ['Comparison', 'Entry', 'Verification', 'compare', 'verify']
