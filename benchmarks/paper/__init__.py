# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper, repeated: its conditions, its figures, its tables, its conclusions.

T. Valimaki, B. Garigipati, R. Ghabcheloo, "Motion-Based Extrinsic Sensor-to-Sensor Calibration:
Effect of Reference Frame Selection for New and Existing Methods", Sensors 23(7):3740, 2023,
doi:10.3390/s23073740, section IV.
"""
