"""Between messages and numbers; the only place that knows the fields of a message."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
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
from std_msgs.msg import Header

from trajectory_calibration import se3
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.buffer import PoseBuffer, PoseTuple

# The parameter value that means: the type that the topic's publishers offer.
AUTOMATIC = 'auto'


@dataclass(frozen=True)
class Reader:
    """How the messages of one type enter a buffer."""

    name: str
    message_type: type
    read: Callable[[Any, PoseBuffer], None]


def stamp_ns(stamp: Time) -> int:
    """Return a message's time in nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _pose_tuple(pose: Pose) -> PoseTuple:
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def _read_odometry(message: Odometry, buffer: PoseBuffer) -> None:
    header = message.header
    buffer.append(stamp_ns(header.stamp), header.frame_id, message.child_frame_id,
                  _pose_tuple(message.pose.pose))


def _read_pose_stamped(message: PoseStamped, buffer: PoseBuffer) -> None:
    header = message.header
    buffer.append(stamp_ns(header.stamp), header.frame_id, '', _pose_tuple(message.pose))


def _read_pose_with_covariance(message: PoseWithCovarianceStamped, buffer: PoseBuffer) -> None:
    header = message.header
    buffer.append(stamp_ns(header.stamp), header.frame_id, '', _pose_tuple(message.pose.pose))


def _read_path(message: Path, buffer: PoseBuffer) -> None:
    stamps_ns = array('q', (stamp_ns(item.header.stamp) for item in message.poses))
    numbers = array('d')
    for item in message.poses:
        numbers.extend(_pose_tuple(item.pose))
    buffer.replace(np.frombuffer(stamps_ns, np.int64),
                   np.frombuffer(numbers, np.float64).reshape(-1, 7), message.header.frame_id)


READERS = {reader.name: reader for reader in (
    Reader('nav_msgs/msg/Odometry', Odometry, _read_odometry),
    Reader('geometry_msgs/msg/PoseStamped', PoseStamped, _read_pose_stamped),
    Reader('geometry_msgs/msg/PoseWithCovarianceStamped', PoseWithCovarianceStamped,
           _read_pose_with_covariance),
    Reader('nav_msgs/msg/Path', Path, _read_path),
)}


def find_reader(type_name: str) -> Reader | None:
    """Return the reader of 'nav_msgs/msg/Odometry', or for short 'Odometry'; None for 'auto'.

    Raises
    ------
    ConfigError
        A type that cannot serve as a trajectory; the message lists those that can.

    """
    if type_name == AUTOMATIC:
        return None
    for name, reader in READERS.items():
        if type_name in (name, name.replace('/msg/', '/'), name.rpartition('/')[2]):
            return reader
    raise ConfigError(
        f'type {type_name!r} cannot serve as a trajectory; needed one of {AUTOMATIC}, '
        f'{", ".join(READERS)}')


def to_transform_stamped(result: CalibrationResult, stamp: Time) -> TransformStamped:
    """Return the extrinsic as the transform from frame a to its child b."""
    x, y, z = result.T_a_b[:3, 3].tolist()
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3]).tolist()
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=result.frame_a),
        child_frame_id=result.frame_b,
        transform=Transform(translation=Vector3(x=x, y=y, z=z),
                            rotation=Quaternion(x=qx, y=qy, z=qz, w=qw)))


def to_pose_with_covariance(
    result: CalibrationResult, stamp: Time,
) -> PoseWithCovarianceStamped | None:
    """Return the pose of b in a with its covariance, or None where the solver gave none."""
    if result.covariance is None:
        return None
    x, y, z = result.T_a_b[:3, 3].tolist()
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3]).tolist()
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=result.frame_a))
    message.pose.pose = Pose(
        position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    message.pose.covariance = result.covariance.reshape(-1)
    return message


def describe(result: CalibrationResult) -> str:
    """Return the extrinsic and how good it is in one line for a person."""
    x, y, z = result.T_a_b[:3, 3]
    qx, qy, qz, qw = se3.rotation_to_quaternion(result.T_a_b[:3, :3])
    parts = [
        f'{result.frame_a} -> {result.frame_b}: translation [{x:.4f}, {y:.4f}, {z:.4f}] m',
        f'rotation xyzw [{qx:.5f}, {qy:.5f}, {qz:.5f}, {qw:.5f}]',
    ]
    if result.covariance is not None:
        sigma = np.sqrt(np.diag(result.covariance))
        metres = ', '.join(f'{value:.4f}' for value in sigma[:3])
        degrees = ', '.join(f'{value:.3f}' for value in np.rad2deg(sigma[3:]))
        parts.append(f'standard deviations [{metres}] m, [{degrees}] deg')
    parts.append(
        f'{result.motions} motions of {result.poses} poses, e_rt {result.metrics.e_rt:.4f} m, '
        f'e_rR {np.rad2deg(result.metrics.e_rR):.3f} deg')
    if result.warnings:
        parts.append(f'warnings: {" | ".join(result.warnings)}')
    return '; '.join(parts)
