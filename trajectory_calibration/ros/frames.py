# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms of the vehicle: what is heard on /tf and /tf_static, and what is published.

``tf2_msgs`` is loaded here, and only where it is needed: it is not in rclpy's wheels.
"""

from __future__ import annotations

import time
from typing import Any

from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.vehicle_frames import Placement, VehicleFrames
from trajectory_calibration.outputs.frame_tree import Edge
from trajectory_calibration.ros.conversions import stamp_ns, to_transform_stamped
from trajectory_calibration.ros.outputs import LATCHED
from trajectory_calibration.sources.transforms import ChainFollower

# How long the node listens before it publishes on /tf_static: discovery takes up to 3 seconds.
LISTEN_S = 4.0

# A moving transform is looked at once in this time for where it hangs, seconds.
_LOOK_S = 1.0

# As tf2's own listener and broadcaster have it.
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

MISSING = 'tf2_msgs is not installed; sudo apt install ros-jazzy-tf2-msgs'


class VehicleTransforms:
    """Listens to /tf_static, and to /tf where that is needed; publishes where it may.

    Parameters
    ----------
    node : Node
        That listens.
    publish : bool
        Whether extrinsics go to /tf_static.
    moving : bool
        Whether inputs come from /tf.
    depth : int
        Messages of /tf that may wait while the node is busy.

    Attributes
    ----------
    frames : what the vehicle publishes.
    available : whether tf2_msgs is installed.

    Raises
    ------
    ConfigError
        tf2_msgs is needed and not installed.

    """

    def __init__(self, node: Node, *, publish: bool, moving: bool, depth: int) -> None:
        self._node = node
        self.frames = VehicleFrames()
        self._followers: list[ChainFollower] = []
        self._looked_s: dict[tuple[str, str], float] = {}
        self._since_s = time.monotonic()
        self._publisher = None
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError as error:
            if publish or moving:
                what = 'publish_tf' if publish else 'a topic tf:PARENT.CHILD'
                raise ConfigError(f'{what} needs tf2_msgs: {MISSING}') from error
            return
        self._message_type: Any = TFMessage
        node.create_subscription(TFMessage, '/tf_static', self._on_static, _STATIC)
        if publish or moving:
            node.create_subscription(
                TFMessage, '/tf', self._on_moving, QoSProfile(depth=depth))
        if publish:
            self._publisher = node.create_publisher(TFMessage, '/tf_static', LATCHED)

    def follow(self, follower: ChainFollower) -> None:
        """Give every transform to a follower, too."""
        self._followers.append(follower)

    @property
    def publishes(self) -> bool:
        """Whether extrinsics go to /tf_static."""
        return self._publisher is not None

    @property
    def has_listened(self) -> bool:
        """Whether what a vehicle publishes has had the time to arrive."""
        return time.monotonic() - self._since_s >= LISTEN_S

    def publish(self, frame_a: str, frame_b: str, T_a_b: FloatArray, invented: frozenset[str],
                ) -> Placement:
        """Publish the extrinsic as the edge that keeps the tree, or say why not."""
        placement = self.frames.place(frame_a, frame_b, T_a_b, invented)
        if placement.edge is not None and self._publisher is not None:
            self.frames.published(placement.edge)
            self._publisher.publish(self._message_type(transforms=[self._message(placement.edge)]))
        return placement

    def _message(self, edge: Edge) -> TransformStamped:
        return to_transform_stamped(
            edge.parent, edge.child, edge.T_parent_child, self._node.get_clock().now().to_msg())

    def _on_static(self, message: Any) -> None:
        for transform in message.transforms:
            pose = _pose(transform)
            self._look(transform, pose, static=True)
            self._give(transform, pose, static=True)

    def _on_moving(self, message: Any) -> None:
        now_s = time.monotonic()
        for transform in message.transforms:
            pose = _pose(transform)
            key = transform.header.frame_id, transform.child_frame_id
            if now_s - self._looked_s.get(key, -_LOOK_S) >= _LOOK_S:
                self._looked_s[key] = now_s
                self._look(transform, pose, static=False)
            self._give(transform, pose, static=False)

    def _look(self, transform: TransformStamped, pose: tuple[float, ...], *, static: bool) -> None:
        q = np.array(pose[3:])
        if not np.isfinite(pose).all() or not abs(np.linalg.norm(q) - 1.0) < 0.01:
            return
        T = se3.from_rotation_translation(
            se3.quaternion_to_rotation(q / np.linalg.norm(q)), np.array(pose[:3]))
        self.frames.add(
            transform.header.frame_id, transform.child_frame_id, T, static=static)

    def _give(self, transform: TransformStamped, pose: tuple[float, ...], *, static: bool) -> None:
        for follower in self._followers:
            follower.add(
                transform.header.frame_id, transform.child_frame_id,
                stamp_ns(transform.header.stamp), pose, static=static)


def _pose(transform: TransformStamped) -> tuple[float, ...]:
    t, q = transform.transform.translation, transform.transform.rotation
    return t.x, t.y, t.z, q.x, q.y, q.z, q.w
