# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms of the vehicle: what is heard on /tf and /tf_static, and what is published.

``tf2_msgs`` is loaded here, and only where it is needed: it is not in rclpy's wheels.
"""

from __future__ import annotations

from functools import partial
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import fault_of
from trajectory_calibration.online.vehicle_frames import difference_in_words, VehicleFrames
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.messages import LATCHED, stamp_ns, to_transform_stamped
from trajectory_calibration.sources.transforms import ChainFollower

# How long the node listens before it publishes on /tf_static: discovery takes up to 3 seconds.
_LISTEN_S = 4.0

# A moving transform is looked at once in this time for where it hangs, seconds.
_LOOK_S = 1.0

# As tf2's own listener and broadcaster have it.
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


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
        self._looked_s: dict[tuple[str, str], float] = {}
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
        node.create_subscription(
            TFMessage, '/tf_static', partial(self._hear, static=True), _STATIC)
        if publish or moving:
            node.create_subscription(
                TFMessage, '/tf', partial(self._hear, static=False), QoSProfile(depth=depth))
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
        for follower in self.followers:
            follower.restart()

    def settle(self) -> None:
        """Publish what waits, once the vehicle has been heard; log what is wrong in TF."""
        if self._publisher is None:
            return
        error = self._node.get_logger().error
        if self._waiting and time.monotonic() - self._since_s >= _LISTEN_S:
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

    def _hear(self, message: Any, *, static: bool) -> None:
        now_s = time.monotonic()
        for item in message.transforms:
            parent, child = names = item.header.frame_id, item.child_frame_id
            t, q = item.transform.translation, item.transform.rotation
            pose = t.x, t.y, t.z, q.x, q.y, q.z, q.w
            if static or now_s - self._looked_s.get(names, -_LOOK_S) >= _LOOK_S:
                self._looked_s[names] = now_s
                if fault_of(pose) is None:
                    unit = np.array(pose[3:]) / np.linalg.norm(pose[3:])
                    self._frames.add(parent, child, se3.from_rotation_translation(
                        se3.quaternion_to_rotation(unit), np.array(pose[:3])), static=static)
            for follower in self.followers:
                follower.add(parent, child, stamp_ns(item.header.stamp), pose, static=static)
