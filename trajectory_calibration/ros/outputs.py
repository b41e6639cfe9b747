# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Everything the node publishes about an answer, latched."""

from __future__ import annotations

import json

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from trajectory_calibration.online.overlay import Overlay
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.conversions import (
    to_markers,
    to_path,
    to_pose_with_covariance,
    to_transform_stamped,
)

# The newest value for whoever comes later.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ResultPublisher:
    """Publishes results of one node; what goes to TF is another matter, see ``frames``."""

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
        """Publish an answer; without an overlay, as after a restart, no tracks."""
        stamp: Time = self._node.get_clock().now().to_msg()
        messages = {
            'extrinsic': to_transform_stamped(
                result.frame_a, result.frame_b, result.T_a_b, stamp),
            'result': String(data=json.dumps(result.to_dict()))}
        if result.covariance is not None:
            messages['extrinsic_with_covariance'] = to_pose_with_covariance(result, stamp)
        if overlay is not None:
            messages['path_a'] = to_path(overlay.poses_a, overlay)
            messages['path_b'] = to_path(overlay.poses_b, overlay)
            messages['markers'] = to_markers(result, overlay, stamp)
        for name, message in messages.items():
            self._publishers[name].publish(message)
