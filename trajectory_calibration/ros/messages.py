# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The messages that the node receives and publishes."""

from __future__ import annotations

from collections.abc import Callable
import json
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.session import Overlay
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.cdr import (
    ODOMETRY,
    PATH,
    POSE,
    POSE_WITH_COVARIANCE,
    TRANSFORM,
)

MESSAGE_TYPES = {
    ODOMETRY: Odometry,
    POSE: PoseStamped,
    POSE_WITH_COVARIANCE: PoseWithCovarianceStamped,
    TRANSFORM: TransformStamped,
    PATH: Path,
}

# The newest value for late subscribers.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ResultPublisher:
    """Publishes the results of one node on its topics; for TF see ``frames``."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publishers = {
            name: node.create_publisher(kind, f'~/{name}', LATCHED) for name, kind in (
                ('extrinsic', TransformStamped),
                ('extrinsic_with_covariance', PoseWithCovarianceStamped),
                ('result', String),
                ('path_a', Path),
                ('path_b', Path),
                ('markers', MarkerArray))}

    def publish(self, result: CalibrationResult, overlay: Overlay | None) -> None:
        """Publish an answer; its tracks only with an overlay, which a restored one lacks."""
        stamp: Time = self._node.get_clock().now().to_msg()
        messages = {
            'extrinsic': to_transform_stamped(
                result.frame_a, result.frame_b, result.T_a_b, stamp),
            'result': String(data=json.dumps(result.to_dict()))}
        if result.covariance is not None:
            messages['extrinsic_with_covariance'] = _to_pose_with_covariance(result, stamp)
        if overlay is not None:
            messages['path_a'] = _to_path(overlay.poses_a, overlay)
            messages['path_b'] = _to_path(overlay.poses_b, overlay)
            messages['markers'] = _to_markers(result, overlay, stamp)
        for name, message in messages.items():
            self._publishers[name].publish(message)


def subscribe(
    node: Node, kind: Any, topic: str, take: Callable[[bytes], None], profile: QoSProfile,
    on_lost: Callable[[QoSMessageLostInfo], None] | None = None,
) -> Subscription:
    """Call ``take`` with every serialized message, ``on_lost`` for messages lost by DDS.

    All queued messages are taken together. The executor of rclpy takes one per wake-up, which
    costs ten times as much as a pose: two topics of 200 Hz took a fifth of a core.
    """
    def take_all(message: bytes) -> None:
        take(message)
        with subscription.handle:
            # At most the queue depth, so that a flood does not block other callbacks.
            for _ in range(profile.depth):
                # As rclpy.wait_for_message does.
                taken = subscription.handle.take_message(kind, subscription.raw)
                if taken is None:
                    break
                take(taken[0])

    subscription: Subscription = node.create_subscription(
        kind, topic, take_all, profile, raw=True,
        event_callbacks=SubscriptionEventCallbacks(message_lost=on_lost))
    return subscription


def to_transform_stamped(
    parent: str, child: str, T_parent_child: FloatArray, stamp: Time,
) -> TransformStamped:
    """Return the message of a (4, 4) transform, the pose of the child in the parent."""
    pose, = _poses(T_parent_child[np.newaxis])
    t = pose.position
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=parent), child_frame_id=child,
        transform=Transform(translation=Vector3(x=t.x, y=t.y, z=t.z), rotation=pose.orientation))


def _to_pose_with_covariance(result: CalibrationResult, stamp: Time) -> PoseWithCovarianceStamped:
    """Return the pose of b in a with its covariance."""
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=result.frame_a))
    message.pose.pose, = _poses(result.T_a_b[np.newaxis])
    message.pose.covariance = result.covariance.reshape(-1)
    return message


def _to_path(poses: FloatArray, overlay: Overlay) -> Path:
    """Return (K, 4, 4) poses of an overlay as a Path in its world frame."""
    stamped = []
    for stamp_ns, pose in zip(overlay.stamps_ns.tolist(), _poses(poses), strict=True):
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=overlay.world_frame)
        stamped.append(PoseStamped(header=header, pose=pose))
    return Path(header=stamped[-1].header, poses=stamped)


def _to_markers(result: CalibrationResult, overlay: Overlay, stamp: Time) -> MarkerArray:
    """Return lines between simultaneous positions from a and b, and their RMS distance as text."""
    header = Header(stamp=stamp, frame_id=overlay.world_frame)
    ends = np.stack([overlay.poses_a[:, :3, 3], overlay.poses_b[:, :3, 3]], axis=1)
    rms_distance = np.sqrt(np.mean(np.sum((ends[:, 0] - ends[:, 1])**2, axis=1)))
    lines = Marker(header=header, ns='disagreement', type=Marker.LINE_LIST)
    lines.scale.x = 0.01
    lines.color = ColorRGBA(r=0.9, g=0.2, b=0.1, a=0.9)
    lines.points = [Point(x=x, y=y, z=z) for x, y, z in ends.reshape(-1, 3).tolist()]
    text = Marker(header=header, ns='answer', type=Marker.TEXT_VIEW_FACING)
    x, y, z = ends[0, 0].tolist()
    text.pose.position = Point(x=x, y=y, z=z + 1)
    text.scale.z = 0.5
    text.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    text.text = f'{result.frame_a} -> {result.frame_b}: tracks {rms_distance:.3f} m apart (rms)'
    return MarkerArray(markers=[lines, text])


def _poses(poses: FloatArray) -> list[Pose]:
    """Return (N, 4, 4) poses as messages."""
    quaternions = se3.rotation_to_quaternion(poses[:, :3, :3])
    return [
        Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        for (x, y, z), (qx, qy, qz, qw) in zip(
            poses[:, :3, 3].tolist(), quaternions.tolist(), strict=True)]
