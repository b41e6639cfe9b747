# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Start one calibration node for each sensor of a rig, all against its base.

RIG.yaml names the sensors, each with a topic or tf; one parameter file serves all nodes::

    ros2 launch trajectory_calibration rig.launch.py rig:=RIG.yaml result_directory:=results
    ros2 run trajectory_calibration trajectory_calibration rig RIG.yaml --from-results results
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from trajectory_calibration.online.launch_arguments import RIG_ARGUMENTS, rig_settings


def _start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in RIG_ARGUMENTS}
    return [Node(**settings.of_node(ParameterValue)) for settings in rig_settings(given)]


def generate_launch_description():
    """Return the arguments and the nodes."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in RIG_ARGUMENTS),
        OpaqueFunction(function=_start),
    ])
