"""The executable where ROS is missing."""

import subprocess
import sys


def test_without_ros_it_says_what_to_do():
    code = ('import sys; sys.modules["rclpy"] = sys.modules["diagnostic_msgs"] = None\n'
            'from trajectory_calibration.ros.executable import main; sys.exit(main())')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith('error: the node needs ROS 2 Jazzy, found no ')
    assert done.stderr.count('\n') == 1
    assert 'source /opt/ros/jazzy/setup.bash' in done.stderr
