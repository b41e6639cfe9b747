# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The process of the node: from the ROS arguments to its end by a signal."""

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

# Beyond it DDS runs out of ports, and Fast DDS ends the process itself.
_HIGHEST_DOMAIN = 232

# Between two callbacks: what comes meanwhile is taken together.
_REST_S = 0.02


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
            time.sleep(_REST_S)
        node.take_leave(executor)
        executor.shutdown()
    except ConfigError as error:
        get_logger(NODE_NAME).fatal(str(error))
        return 2
    finally:
        if node is not None:
            node.shutdown()
        rclpy.try_shutdown()
    return 0
