"""The executable ``calibration_node``: the node, or what to do where ROS is missing."""

from __future__ import annotations

import sys

from trajectory_calibration.ros.signals import StopSignals


def main() -> int:
    """Run the node; return its exit status, 2 where ROS cannot be imported."""
    # Before the imports, which take longer than everything else up to the first pose.
    stop = StopSignals()
    try:
        return _run(stop)
    finally:
        stop.ignore()


def _run(stop: StopSignals) -> int:
    try:
        from trajectory_calibration.ros.node import main as run
    except ModuleNotFoundError as error:
        if (error.name or '').startswith('trajectory_calibration'):
            raise
        sys.stderr.write(
            f'error: the node needs ROS 2 Jazzy, found no {error.name}; source '
            '/opt/ros/jazzy/setup.bash, or on a machine without ROS pip install '
            'ros-jazzy-common-interfaces "ros-jazzy-rclpy[fastrtps]"\n')
        return 2
    return 0 if stop.received else run(stop=stop)


if __name__ == '__main__':
    sys.exit(main())
