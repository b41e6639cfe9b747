# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node: rclpy alone; everything that can be tested without ROS is in ``online``."""
