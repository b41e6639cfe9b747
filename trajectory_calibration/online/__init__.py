# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Online calibration without ROS: pose buffers, advice, session, store and solver process."""
