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
        self._extrinsic = node.create_publisher(TransformStamped, '~/extrinsic', LATCHED)
        self._with_covariance = node.create_publisher(
            PoseWithCovarianceStamped, '~/extrinsic_with_covariance', LATCHED)
        self._result = node.create_publisher(String, '~/result', LATCHED)
        self._path_a = node.create_publisher(Path, '~/path_a', LATCHED)
        self._path_b = node.create_publisher(Path, '~/path_b', LATCHED)
        self._markers = node.create_publisher(MarkerArray, '~/markers', LATCHED)

    def publish(self, result: CalibrationResult, overlay: Overlay | None) -> None:
        """Publish an answer; without an overlay, as after a restart, no tracks."""
        stamp: Time = self._node.get_clock().now().to_msg()
        self._extrinsic.publish(to_transform_stamped(
            result.frame_a, result.frame_b, result.T_a_b, stamp))
        with_covariance = to_pose_with_covariance(result, stamp)
        if with_covariance is not None:
            self._with_covariance.publish(with_covariance)
        self._result.publish(String(data=json.dumps(result.to_dict())))
        if overlay is not None:
            self._path_a.publish(to_path(overlay.poses_a, overlay))
            self._path_b.publish(to_path(overlay.poses_b, overlay))
            self._markers.publish(to_markers(result, overlay, stamp))
