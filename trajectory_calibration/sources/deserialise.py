# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses out of serialized messages of any kind, one at a time: the slow and general way.

For what ``cdr`` leaves: big endian, unusual layouts, blocks of many frames. A message is read
field by field; one that is shorter or longer than its fields is none.
"""

from __future__ import annotations

import struct

import numpy as np

from trajectory_calibration.sources.cdr import (
    DOUBLES,
    ODOMETRY,
    PathPoses,
    StampedPose,
    TRANSFORM,
    TwoFrames,
)

# Bytes that a writer may append to a message to fill a word.
_MAX_PADDING = 3
# A pose is no shorter: what declares more elements than fit is damaged.
_SHORTEST_POSE = 60


class Deserialiser:
    """Reads messages of ROS 1 or ROS 2."""

    def __init__(self, *, ros1: bool) -> None:
        self._ros1 = ros1

    def pose(self, message: bytes, msgtype: str) -> StampedPose | None:
        """Return the pose of a message, or None where it is damaged."""
        try:
            fields = _Fields(message, ros1=self._ros1)
            sample = fields.pose(child=msgtype in (ODOMETRY, TRANSFORM))
            fields.doubles(DOUBLES[msgtype] - 7)
        except (struct.error, ValueError):
            return None
        return sample if fields.ended else None

    def path(self, message: bytes) -> PathPoses | None:
        """Return the poses of a Path, or None where it is damaged."""
        try:
            fields = _Fields(message, ros1=self._ros1)
            frame = fields.header()[1]
            poses = [fields.pose(child=False) for _ in range(fields.count())]
        except (struct.error, ValueError):
            return None
        if not fields.ended:
            return None
        return PathPoses(
            frame, np.array([pose.stamp_ns for pose in poses], dtype=np.int64),
            np.array([pose.pose for pose in poses]).reshape(-1, 7))

    def transforms(self, message: bytes) -> list[StampedPose] | None:
        """Return the transforms of a TFMessage, or None where it is damaged."""
        try:
            fields = _Fields(message, ros1=self._ros1)
            found = [fields.pose(child=True) for _ in range(fields.count())]
        except (struct.error, ValueError):
            return None
        return found if fields.ended else None


class _Fields:
    """A message that is read from its beginning to its end; raises where it ends too soon."""

    def __init__(self, message: bytes, *, ros1: bool) -> None:
        self._message, self._ros1 = message, ros1
        self._offset = 0 if ros1 else 4
        if not ros1 and message[:2] not in (b'\x00\x00', b'\x00\x01'):
            raise ValueError('not plain CDR')
        self._order = '<' if ros1 or message[1] else '>'

    @property
    def ended(self) -> bool:
        """Whether nothing is left but padding."""
        rest = len(self._message) - self._offset
        return rest == 0 if self._ros1 else 0 <= rest <= _MAX_PADDING

    def pose(self, *, child: bool) -> StampedPose:
        stamp_ns, frame = self.header()
        frames: TwoFrames = (frame, self.text() if child else '')
        return StampedPose(stamp_ns, frames, self.doubles(7))

    def header(self) -> tuple[int, str]:
        """Return stamp and frame."""
        sec, nanosec = self._unpack('4xII' if self._ros1 else 'iI', 4)
        return int(sec) * 1_000_000_000 + int(nanosec), self.text()

    def text(self) -> str:
        length = int(self._unpack('I', 4)[0])
        start, self._offset = self._offset, self._offset + length
        data = self._message[start:self._offset]
        if len(data) != length:
            raise ValueError('cut off')
        if self._ros1:
            return data.decode()
        if not data.endswith(b'\0'):
            raise ValueError('a string without an end')
        return data[:-1].decode()

    def count(self) -> int:
        """Return the length of a sequence of poses."""
        (count,) = self._unpack('I', 4)
        if count * _SHORTEST_POSE > len(self._message):
            raise ValueError('more than fit')
        return int(count)

    def doubles(self, count: int) -> tuple[float, ...]:
        # Alignment of nothing is none.
        return self._unpack(f'{count}d', 8) if count else ()

    def _unpack(self, layout: str, alignment: int) -> tuple[float, ...]:
        if not self._ros1:
            self._offset = -(-(self._offset - 4) // alignment) * alignment + 4
        values = struct.unpack_from(self._order + layout, self._message, self._offset)
        self._offset += struct.calcsize(self._order + layout)
        return values
