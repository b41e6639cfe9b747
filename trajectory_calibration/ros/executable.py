# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The executable ``calibration_node``: runs the node, or prints its usage or that ROS is missing.

ROS and other slow imports are loaded only after the signal handlers are installed.
"""

from __future__ import annotations

from collections.abc import Sequence
import signal
import sys
import textwrap
from types import FrameType

from trajectory_calibration.version import __version__

_USAGE = """\
usage: ros2 run trajectory_calibration calibration_node [--help] [--version]
           [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]

Estimate the pose of sensor b in sensor a from their two trajectories, while the vehicle drives.

  ros2 run trajectory_calibration calibration_node --ros-args \\
      -p topic_a:=/lidar/odometry -p topic_b:=/camera/odometry
  ros2 service call /trajectory_calibration/calibrate std_srvs/srv/Trigger
  ros2 topic echo --once /trajectory_calibration/extrinsic

services    ~/calibrate  ~/reset  ~/save        (std_srvs/srv/Trigger)
publishes   ~/extrinsic  ~/extrinsic_with_covariance  ~/result  /diagnostics, and more
"""


class StopSignals:
    """Converts SIGINT, SIGTERM and SIGHUP (closed terminal) into a flag.

    The handlers of rclpy race with the executor: some runs hang, some end in a traceback. A flag
    that the loop checks always ends the same way.
    """

    def __init__(self) -> None:
        self.received = False
        self._numbers = [signal.SIGINT, signal.SIGTERM]
        # Under nohup it is ignored, so that the node survives its terminal.
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            self._numbers.append(signal.SIGHUP)
        for number in self._numbers:
            signal.signal(number, self._on_signal)

    def ignore(self) -> None:
        """Ignore the signals from now on, while the process exits.

        Python removes its handlers before it has exited. A second Ctrl-C at that time would kill
        the process, and its exit status would be lost.
        """
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.received = True


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return its exit status, 2 if ROS cannot be imported."""
    # Before the imports, which take most of the startup time.
    stop = StopSignals()
    try:
        return _run(stop, sys.argv[1:] if argv is None else argv)
    finally:
        stop.ignore()


def _run(stop: StopSignals, argv: Sequence[str]) -> int:
    if any(word in ('-h', '--help') for word in argv):
        sys.stdout.write(_usage())
        return 0
    if '--version' in argv:
        sys.stdout.write(f'trajectory_calibration {__version__}\n')
        return 0
    try:
        from trajectory_calibration.ros.run import main as run
    except ModuleNotFoundError as error:
        name = error.name or ''
        if name.startswith('trajectory_calibration'):
            raise
        sys.stderr.write(
            f'error: the node needs ROS 2 Jazzy, found no {name}; source '
            '/opt/ros/jazzy/setup.bash, or on a machine without ROS pip install '
            'ros-jazzy-common-interfaces "ros-jazzy-rclpy[fastrtps]"\n')
        return 2
    return 0 if stop.received else run(lambda: stop.received)


def _usage() -> str:
    """Return the usage with every parameter, its default and its meaning."""
    from trajectory_calibration.online.options import OPTIONS, parameter_text
    lines = []
    for name, option in OPTIONS.items():
        lines.append(f'  {name}: {parameter_text(option.default)}')
        lines += textwrap.wrap(
            option.help, 78, initial_indent='      ', subsequent_indent='      ')
    return '\n'.join([_USAGE, 'parameters with their defaults (as in config/calibration.yaml):',
                      *lines, ''])


if __name__ == '__main__':
    sys.exit(main())
