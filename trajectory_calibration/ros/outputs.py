"""Everything the node publishes about an answer, latched."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.overlay import Overlay
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.conversions import (
    to_markers,
    to_path,
    to_pose_with_covariance,
    to_transform_stamped,
)

_LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ResultPublisher:
    """Publishes results of one node.

    Raises
    ------
    ConfigError
        ``publish_tf`` is set and tf2_msgs is not installed.

    """

    def __init__(self, node: Node, *, publish_tf: bool) -> None:
        self._node = node
        self._extrinsic = node.create_publisher(TransformStamped, '~/extrinsic', _LATCHED)
        self._with_covariance = node.create_publisher(
            PoseWithCovarianceStamped, '~/extrinsic_with_covariance', _LATCHED)
        self._path_a = node.create_publisher(Path, '~/path_a', _LATCHED)
        self._path_b = node.create_publisher(Path, '~/path_b', _LATCHED)
        self._markers = node.create_publisher(MarkerArray, '~/markers', _LATCHED)
        self._tf = _StaticTransform(node) if publish_tf else None

    def publish(self, result: CalibrationResult, overlay: Overlay | None) -> None:
        """Publish an answer; without an overlay, as after a restart, no tracks."""
        stamp: Time = self._node.get_clock().now().to_msg()
        transform = to_transform_stamped(result, stamp)
        self._extrinsic.publish(transform)
        with_covariance = to_pose_with_covariance(result, stamp)
        if with_covariance is not None:
            self._with_covariance.publish(with_covariance)
        if self._tf is not None:
            self._tf.publish(transform)
        if overlay is not None:
            self._path_a.publish(to_path(overlay.poses_a, overlay))
            self._path_b.publish(to_path(overlay.poses_b, overlay))
            self._markers.publish(to_markers(result, overlay, stamp))


class _StaticTransform:
    """The extrinsic on /tf_static.

    Not ``tf2_ros.StaticTransformBroadcaster``: that of Jazzy keeps the first transform of a
    child frame and drops every later one, so that a second calibration would never arrive.
    """

    def __init__(self, node: Node) -> None:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError as error:
            raise ConfigError(
                'publish_tf needs tf2_msgs, which is not installed; install '
                'ros-jazzy-tf2-msgs or set publish_tf to false') from error
        self._node, self._message_type = node, TFMessage
        self._publisher: Publisher = node.create_publisher(TFMessage, '/tf_static', _LATCHED)

    def publish(self, transform: TransformStamped) -> None:
        """Publish, unless both frames have one name: TF would take that for a frame in itself."""
        if transform.header.frame_id == transform.child_frame_id:
            self._node.get_logger().error(
                f'not on /tf_static: both frames are {transform.child_frame_id}; set frame_a and '
                'frame_b')
            return
        self._publisher.publish(self._message_type(transforms=[transform]))
