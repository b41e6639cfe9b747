"""Between messages and numbers; the only place that knows the fields of a message."""

from __future__ import annotations

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
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from trajectory_calibration import se3
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.cdr import (
    ODOMETRY,
    PATH,
    PathPoses,
    POSE,
    POSE_WITH_COVARIANCE,
    StampedPose,
)

MESSAGE_TYPES = {
    ODOMETRY: Odometry,
    POSE: PoseStamped,
    POSE_WITH_COVARIANCE: PoseWithCovarianceStamped,
    PATH: Path,
}


class RosDeserialiser:
    """Reads messages with ROS itself: for byte orders and layouts that are not the usual one."""

    def pose(self, message: bytes, msgtype: str) -> StampedPose | None:
        """Return the pose of a message."""
        value = deserialize_message(message, MESSAGE_TYPES[msgtype])
        child = value.child_frame_id if msgtype == ODOMETRY else ''
        pose = value.pose if msgtype == POSE else value.pose.pose
        return StampedPose(
            _stamp_ns(value.header.stamp), (value.header.frame_id, child), _numbers(pose))

    def path(self, message: bytes) -> PathPoses | None:
        """Return the poses of a Path."""
        value = deserialize_message(message, Path)
        stamps_ns = [_stamp_ns(item.header.stamp) for item in value.poses]
        poses = [_numbers(item.pose) for item in value.poses]
        return PathPoses(
            value.header.frame_id, np.array(stamps_ns, np.int64), np.array(poses).reshape(-1, 7))


def _stamp_ns(stamp: Time) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _numbers(pose: Pose) -> tuple[float, ...]:
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def to_transform_stamped(result: CalibrationResult, stamp: Time) -> TransformStamped:
    """Return the extrinsic as the transform from frame a to its child b."""
    translation, rotation = _vector_and_quaternion(result)
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=result.frame_a),
        child_frame_id=result.frame_b,
        transform=Transform(translation=Vector3(**translation), rotation=Quaternion(**rotation)))


def to_pose_with_covariance(
    result: CalibrationResult, stamp: Time,
) -> PoseWithCovarianceStamped | None:
    """Return the pose of b in a with its covariance, or None where the solver gave none."""
    if result.covariance is None:
        return None
    translation, rotation = _vector_and_quaternion(result)
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=result.frame_a))
    message.pose.pose = Pose(position=Point(**translation), orientation=Quaternion(**rotation))
    message.pose.covariance = result.covariance.reshape(-1)
    return message


def _vector_and_quaternion(result: CalibrationResult) -> tuple[dict[str, Any], dict[str, Any]]:
    rotation = se3.rotation_to_quaternion(result.T_a_b[:3, :3])
    return (dict(zip('xyz', result.T_a_b[:3, 3].tolist(), strict=True)),
            dict(zip('xyzw', rotation.tolist(), strict=True)))
