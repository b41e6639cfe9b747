# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The process of the node: initialise ROS, spin until a signal, shut down."""

from __future__ import annotations

from collections.abc import Callable
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_default_context

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.ros.node import CalibrationNode, NODE_NAME

# Above it DDS has no ports, and Fast DDS aborts the process.
_HIGHEST_DOMAIN = 232

# Pause between two callbacks, seconds; messages that arrive meanwhile are taken together.
_PAUSE_S = 0.02


def _init() -> None:
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, UnicodeEncodeError) as error:
        raise ConfigError(f'ROS arguments: {" ".join(str(error).split())}') from error
    domain = get_default_context().get_domain_id()
    if domain > _HIGHEST_DOMAIN:
        raise ConfigError(f'ROS_DOMAIN_ID is {domain}, needed 0 to {_HIGHEST_DOMAIN}')


def main(stopped: Callable[[], bool]) -> int:
    """Run the node until it is stopped by a signal; return the exit status."""
    node = None
    try:
        _init()
        executor = SingleThreadedExecutor()
        node = CalibrationNode()
        executor.add_node(node)
        while rclpy.ok() and not stopped():
            executor.spin_once(timeout_sec=0.2)
            time.sleep(_PAUSE_S)
        node.finish_calls(executor)
        executor.shutdown()
    except ConfigError as error:
        get_logger(NODE_NAME).fatal(str(error))
        return 2
    finally:
        if node is not None:
            node.shutdown()
        rclpy.try_shutdown()
    return 0
