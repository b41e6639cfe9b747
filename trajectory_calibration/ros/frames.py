# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms of the vehicle: what is heard on /tf and /tf_static, and what is published.

``tf2_msgs`` is loaded here, and only where it is needed: it is not in rclpy's wheels.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from trajectory_calibration.data.trajectory import pose_faults
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.vehicle_frames import difference_in_words, VehicleFrames
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.messages import LATCHED, subscribe, to_transform_stamped
from trajectory_calibration.sources.cdr import parse_poses, TF
from trajectory_calibration.sources.edges import matrices
from trajectory_calibration.sources.transforms import ChainFollower

# As tf2's own listener has it, but for the depth: those of all senders come at once.
_STATIC = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class VehicleTransforms:
    """Listens to /tf_static, and to /tf where that is needed; publishes where it may.

    Attributes
    ----------
    followers : get every transform, too.
    placed : what became of the newest answer in TF, '' where TF is none of its business.

    Raises
    ------
    ConfigError
        tf2_msgs is needed and not installed.

    """

    def __init__(self, node: Node, *, publish: bool, moving: bool, depth: int) -> None:
        self._node = node
        self._frames = VehicleFrames()
        self.followers: list[ChainFollower] = []
        # Messages since the last update, and whether their transforms are static.
        self._heard: dict[bool, list[bytes]] = {True: [], False: []}
        self._since_s = time.monotonic()
        self._publisher = None
        # The newest answer until the node has listened, and its frames that nobody named.
        self._waiting: tuple[CalibrationResult, frozenset[str]] | None = None
        self._conflicts: tuple[str, ...] = ()
        self.placed = ''
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError as error:
            if publish or moving:
                what = 'publish_tf' if publish else 'a topic tf:PARENT.CHILD'
                raise ConfigError(
                    f'{what} needs tf2_msgs: tf2_msgs is not installed; sudo apt install '
                    'ros-jazzy-tf2-msgs') from error
            return
        self._message_type: Any = TFMessage
        subscribe(node, TFMessage, '/tf_static', self._heard[True].append, _STATIC)
        if publish or moving:
            subscribe(
                node, TFMessage, '/tf', self._heard[False].append, QoSProfile(depth=depth))
        if publish:
            self._publisher = node.create_publisher(TFMessage, '/tf_static', LATCHED)

    def take(self, result: CalibrationResult, invented: frozenset[str]) -> None:
        """Take a new answer; ``invented`` are names of frames that nobody gave."""
        if self._publisher is not None:
            self._waiting = result, invented
            self.placed = 'not on /tf_static yet: listening first to what the vehicle publishes'
            self.settle()

    def reset(self) -> None:
        """Have the followers begin anew, so that no pose from before comes out later."""
        self._heard[False].clear()
        for follower in self.followers:
            follower.restart()

    def update(self) -> None:
        """Take what has come since the last call; what is damaged is left out."""
        for static, messages in self._heard.items():
            runs, _ = parse_poses(messages, TF)
            messages.clear()
            for follower in self.followers:
                follower.extend(runs, static=static)
            for run in runs:
                if static and len(usable := run.poses[~np.any(pose_faults(run.poses), axis=0)]):
                    self._frames.add(*run.frames, matrices(usable[-1:])[0], static=True)
                elif self._publisher and not static:
                    # Of one that moves it matters only between which frames it is.
                    self._frames.add(*run.frames, np.eye(4), static=False)

    def settle(self) -> None:
        """Publish what waits, once the vehicle has been heard; log what is wrong in TF."""
        self.update()
        if self._publisher is None:
            return
        error = self._node.get_logger().error
        # Discovery takes up to 3 seconds.
        if self._waiting and time.monotonic() - self._since_s >= 4:
            (result, invented), self._waiting = self._waiting, None
            edge, reason = self._frames.place(
                result.frame_a, result.frame_b, result.T_a_b, invented)
            if edge is None:
                self.placed = f'not on /tf_static: {reason}'
                error(self.placed)
            else:
                self._frames.published(edge)
                self._publisher.publish(self._message_type(transforms=[to_transform_stamped(
                    edge.parent, edge.child, edge.T_parent_child,
                    self._node.get_clock().now().to_msg())]))
                self.placed = f'on /tf_static: {edge.parent} -> {edge.child}' + (
                    reason and f' ({reason})')
                self._node.get_logger().info(self.placed)
        conflicts = self._frames.conflicts
        for conflict in conflicts:
            if conflict not in self._conflicts:
                error(f'/tf: {conflict}')
        self._conflicts = conflicts

    def today(self, result: CalibrationResult | None) -> str:
        """Return how far an answer is from the transform that the vehicle has itself."""
        T_today = result and self._frames.transform(result.frame_a, result.frame_b)
        if T_today is None:
            return ''
        return (f"differs from the vehicle's own transform {result.frame_a} -> {result.frame_b} "
                f'by {difference_in_words(result.T_a_b, T_today)}')
