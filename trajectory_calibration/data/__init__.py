# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What flows: trajectories, pairs of poses at common times, relative motions."""
