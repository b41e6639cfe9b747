# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outputs of results for people and other programs: text, reports, plots, exports."""
