# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Start one calibration node for each sensor of a rig, all against its base.

RIG.yaml names the sensors, each with a topic or tf; one parameter file serves all nodes::

    ros2 launch trajectory_calibration rig.launch.py rig:=RIG.yaml result_directory:=results
    ros2 run trajectory_calibration trajectory_calibration rig RIG.yaml --from-results results
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from trajectory_calibration.rig.nodes import nodes_of

# Name, default and meaning of the arguments of the launch file.
ARGUMENTS = (
    ('rig', '', 'RIG.yaml: the base and the sensors, each with a topic or tf'),
    ('params_file', '', 'file with the parameters of all nodes; empty: all defaults'),
    ('result_directory', '', 'folder in which every node saves its results'),
    ('namespace', 'rig', 'namespace of the nodes'),
    ('use_sim_time', 'false', 'whether a bag or a simulator publishes /clock'),
    ('log_level', 'info', 'debug, info, warn, error or fatal'),
)


def _start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    nodes = nodes_of(Path(given['rig']), given['result_directory'],
                     sim_time=given['use_sim_time'].lower() == 'true')
    return [
        Node(
            package='trajectory_calibration',
            executable='calibration_node',
            name=node.name,
            namespace=given['namespace'],
            # Later ones win: RIG.yaml beats the file. Typed: a frame named "off" stays a text.
            parameters=[
                *filter(None, [given['params_file']]),
                {name: ParameterValue(value, value_type=type(value))
                 for name, value in node.parameters.items()}],
            arguments=['--ros-args', '--log-level', given['log_level']],
            output='screen',
        )
        for node in nodes]


def generate_launch_description():
    """Return the arguments and the nodes."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, default, text in ARGUMENTS),
        OpaqueFunction(function=_start),
    ])
