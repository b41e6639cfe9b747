# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS where it is installed: ``ros`` holds the helpers, ``needs_ros`` skips tests where it is not.

A mark, not a skip of the module: with launch_testing installed, a module that skips itself makes
pytest collect nothing of the whole folder.
"""

from importlib.util import find_spec

import pytest

needs_ros = pytest.mark.skipif(
    find_spec('rclpy') is None,
    reason='rclpy is missing: source ROS 2 Jazzy or install ros-jazzy-rclpy')
if find_spec('rclpy') is None:
    ros = None
else:
    import ros_helpers as ros

__all__ = ['needs_ros', 'ros']
