# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrays of SE(3) and how to interpolate them; it knows no sensor."""
