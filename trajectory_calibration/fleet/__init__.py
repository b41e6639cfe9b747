# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many recordings of the same sensors: does an extrinsic hold, and when did a sensor move."""

from trajectory_calibration.fleet.comparison import compare, Comparison, Entry
from trajectory_calibration.fleet.verification import Verification, verify

__all__ = ['Comparison', 'Entry', 'Verification', 'compare', 'verify']
