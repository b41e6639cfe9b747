"""Poses out of serialized messages of any kind, one at a time: the slow and general way.

For what ``cdr`` leaves: ROS 1, big endian, unusual layouts.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import get_typestore, Stores, TypesysError

from trajectory_calibration.sources.cdr import ODOMETRY, PATH, PathPoses, POSE, StampedPose

_FAILURES = (SerdeError, TypesysError, struct.error, AssertionError, LookupError, MemoryError,
             OverflowError, TypeError, ValueError)


class Deserialiser:
    """Reads the messages of one bag, ROS 1 or ROS 2."""

    def __init__(self, *, ros1: bool) -> None:
        # The types that can serve have not changed since ROS 2 began, nor in ROS 1.
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
        self._deserialise = store.deserialize_ros1 if ros1 else store.deserialize_cdr

    def pose(self, message: bytes, msgtype: str) -> StampedPose | None:
        """Return the pose of a message, or None where it is damaged."""
        value = self._read(message, msgtype)
        if value is None:
            return None
        pose = value.pose if msgtype == POSE else value.pose.pose
        child = value.child_frame_id if msgtype == ODOMETRY else ''
        return StampedPose(
            _stamp_ns(value.header), (value.header.frame_id, child), _numbers(pose))

    def path(self, message: bytes) -> PathPoses | None:
        """Return the poses of a Path, or None where it is damaged."""
        value = self._read(message, PATH)
        if value is None:
            return None
        return PathPoses(
            value.header.frame_id,
            np.array([_stamp_ns(item.header) for item in value.poses], dtype=np.int64),
            np.array([_numbers(item.pose) for item in value.poses]).reshape(-1, 7))

    def _read(self, message: bytes, msgtype: str) -> Any:
        try:
            return self._deserialise(message, msgtype)
        except _FAILURES:
            return None


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _numbers(pose: Any) -> tuple[float, ...]:
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
