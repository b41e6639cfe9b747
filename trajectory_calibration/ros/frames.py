# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms of the vehicle: receive /tf and /tf_static, and publish the extrinsic.

``tf2_msgs`` is imported only if needed, because rclpy's wheels do not include it.
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
    """Listens to /tf_static, and to /tf if needed; publishes the extrinsic on /tf_static.

    Attributes
    ----------
    followers : also receive every transform.
    placed : whether and how the newest answer is in TF, in words, '' without ``publish``.

    Raises
    ------
    ConfigError
        tf2_msgs is needed and not installed.

    """

    def __init__(self, node: Node, *, publish: bool, moving: bool, depth: int) -> None:
        self._node = node
        self._frames = VehicleFrames()
        self.followers: list[ChainFollower] = []
        # Whether static -> messages since the last update.
        self._messages: dict[bool, list[bytes]] = {True: [], False: []}
        self._listening_since_s = time.monotonic()
        self._publisher = None
        # The newest answer that is not yet published, and its frames named after topics.
        self._pending: tuple[CalibrationResult, frozenset[str]] | None = None
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
        subscribe(node, TFMessage, '/tf_static', self._messages[True].append, _STATIC)
        if publish or moving:
            subscribe(
                node, TFMessage, '/tf', self._messages[False].append, QoSProfile(depth=depth))
        if publish:
            self._publisher = node.create_publisher(TFMessage, '/tf_static', LATCHED)

    def take(self, result: CalibrationResult, invented: frozenset[str]) -> None:
        """Publish a new answer later; ``invented`` are frames that are named after topics."""
        if self._publisher is not None:
            self._pending = result, invented
            self.placed = 'not on /tf_static yet: listening first to what the vehicle publishes'
            self.publish_pending()

    def reset(self) -> None:
        """Restart the followers, so that they give no poses from before the reset."""
        self._messages[False].clear()
        for follower in self.followers:
            follower.restart()

    def update(self) -> None:
        """Process the messages since the last call; damaged ones are ignored."""
        for static, messages in self._messages.items():
            runs, _ = parse_poses(messages, TF)
            messages.clear()
            for follower in self.followers:
                follower.extend(runs, static=static)
            for run in runs:
                if static and len(usable := run.poses[~np.any(pose_faults(run.poses), axis=0)]):
                    self._frames.add(*run.frames, matrices(usable[-1:])[0], static=True)
                elif self._publisher and not static:
                    # Of a non-static transform only the frames matter.
                    self._frames.add(*run.frames, np.eye(4), static=False)

    def publish_pending(self) -> None:
        """Publish the pending answer after listening long enough; log conflicts in TF."""
        self.update()
        if self._publisher is None:
            return
        error = self._node.get_logger().error
        # Discovery takes up to 3 seconds.
        if self._pending and time.monotonic() - self._listening_since_s >= 4:
            (result, invented), self._pending = self._pending, None
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
        """Return the difference of an answer from the vehicle's own transform in words, or ''."""
        T_today = result and self._frames.transform(result.frame_a, result.frame_b)
        if T_today is None:
            return ''
        return (f"differs from the vehicle's own transform {result.frame_a} -> {result.frame_b} "
                f'by {difference_in_words(result.T_a_b, T_today)}')
