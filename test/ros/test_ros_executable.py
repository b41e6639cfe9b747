# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The executable where ROS is missing, and where a signal comes before the node is there."""

import importlib.util
import signal
import subprocess
import sys

import pytest


def heed_hangup():
    """Undo what nohup does, under which tests may run: a child would ignore SIGHUP, too."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# Sends a signal to itself while ROS is imported.
SIGNALLED = """
import os, sys
from trajectory_calibration.ros.executable import main
class Finder:
    def find_spec(self, name, *rest):
        if name == 'rclpy.executors':
            os.kill(os.getpid(), {number})
            print('sent')
sys.meta_path.insert(0, Finder())
sys.exit(main())
"""


@pytest.mark.parametrize('argument, words', [
    ('--help', ['usage: ros2 run trajectory_calibration calibration_node', 'topic_a', '~/save']),
    ('-h', ['usage: ']), ('--version', ['trajectory_calibration '])])
def test_usage_is_printed_and_nothing_started(argument, words):
    code = ('import sys; sys.modules["rclpy"] = None\n'
            'from trajectory_calibration.ros.executable import main\n'
            f'sys.exit(main(["{argument}"]))')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, '')
    assert all(word in done.stdout for word in words)


def test_without_ros_it_says_what_to_do():
    code = ('import sys; sys.modules["rclpy"] = sys.modules["diagnostic_msgs"] = None\n'
            'from trajectory_calibration.ros.executable import main; sys.exit(main())')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith('error: the node needs ROS 2 Jazzy, found no ')
    assert done.stderr.count('\n') == 1
    assert 'source /opt/ros/jazzy/setup.bash' in done.stderr


@pytest.mark.skipif(importlib.util.find_spec('rclpy') is None, reason='rclpy is missing')
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_during_the_imports_is_a_clean_end(number):
    done = subprocess.run(
        [sys.executable, '-c', SIGNALLED.format(number=int(number))], capture_output=True,
        text=True, timeout=60, check=False, preexec_fn=heed_hangup)
    assert (done.returncode, done.stdout, done.stderr) == (0, 'sent\n', '')


@pytest.mark.skipif(importlib.util.find_spec('rclpy') is None, reason='rclpy is missing')
def test_the_end_of_the_interpreter_is_not_cut_short_by_more_signals():
    # The functions of atexit run before Python gives back the handlers of signals.
    code = ('import atexit, signal\n'
            'atexit.register(lambda: print(*(int(signal.getsignal(number)) for number in '
            '(signal.SIGINT, signal.SIGTERM, signal.SIGHUP))))\n') + SIGNALLED
    done = subprocess.run(
        [sys.executable, '-c', code.format(number=int(signal.SIGTERM))], capture_output=True,
        text=True, timeout=60, check=False, preexec_fn=heed_hangup)
    ignored = str(int(signal.SIG_IGN))
    assert (done.returncode, done.stdout.split()) == (0, ['sent', *[ignored] * 3])


def test_nohup_keeps_a_node_whose_terminal_closes():
    code = ('import os, signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n'
            'from trajectory_calibration.ros.executable import StopSignals; stop = StopSignals()\n'
            'os.kill(os.getpid(), signal.SIGHUP); print(stop.received)')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == 'False\n'
