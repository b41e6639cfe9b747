# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The version of the package; setup.py reads it here, a test compares package.xml."""

__version__ = '0.2.0'
