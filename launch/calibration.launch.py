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
    settings = launch_settings({
        name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS})
    # Typed: as text of YAML, a frame named "off" would become False.
    overrides = {name: ParameterValue(value, value_type=type(value))
                 for name, value in settings.parameters.items()}
    return [Node(
        package='trajectory_calibration',
        executable='calibration_node',
        name=settings.name,
        namespace=settings.namespace,
        # Later ones win: an argument beats the file.
        parameters=[*filter(None, [settings.params_file]), overrides],
        arguments=['--ros-args', '--log-level', settings.log_level],
        respawn=settings.respawn,
        respawn_delay=2.0,
        output='screen',
    )]


def generate_launch_description():
    """Return the arguments and the node."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in ARGUMENTS),
        OpaqueFunction(function=_start),
    ])
