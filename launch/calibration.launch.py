"""Start the calibration node.

Two topics are all it needs::

    ros2 launch trajectory_calibration calibration.launch.py \
        topic_a:=/lidar_slam/odometry topic_b:=/visual_slam/odometry
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    """Return one node with the parameter file and the two topics as arguments."""
    share = Path(get_package_share_directory('trajectory_calibration'))
    return LaunchDescription([
        DeclareLaunchArgument(
            'config', default_value=str(share / 'config' / 'calibration.yaml'),
            description='file with the parameters of the node'),
        DeclareLaunchArgument(
            'topic_a', default_value='trajectory_a',
            description='topic with the trajectory of the parent sensor a'),
        DeclareLaunchArgument(
            'topic_b', default_value='trajectory_b',
            description='topic with the trajectory of the child sensor b'),
        DeclareLaunchArgument(
            'namespace', default_value='',
            description='namespace of the node: one for each pair of sensors'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false',
            description='whether a bag or a simulator publishes /clock'),
        Node(
            package='trajectory_calibration',
            executable='calibration_node',
            namespace=LaunchConfiguration('namespace'),
            parameters=[
                LaunchConfiguration('config'),
                {'use_sim_time': LaunchConfiguration('use_sim_time')},
            ],
            remappings=[
                ('trajectory_a', LaunchConfiguration('topic_a')),
                ('trajectory_b', LaunchConfiguration('topic_b')),
            ],
            output='screen',
        ),
    ])
