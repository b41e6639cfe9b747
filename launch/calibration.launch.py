# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Start the calibration node.

Two topics are all it needs::

    ros2 launch trajectory_calibration calibration.launch.py \
        topic_a:=/lidar_slam/odometry topic_b:=/visual_slam/odometry

``ros2 launch trajectory_calibration calibration.launch.py --show-args`` lists the arguments.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from trajectory_calibration.online.launch_arguments import ARGUMENTS, launch_settings


def _start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    return [Node(**launch_settings(given).of_node(ParameterValue))]


def generate_launch_description():
    """Return the arguments and the node."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in ARGUMENTS),
        OpaqueFunction(function=_start),
    ])
