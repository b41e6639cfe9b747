# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses from serialized messages, without building message objects.

DDS and rosbag2 use CDR: a header of four bytes (byte 1 is 1 for little endian), then the fields,
each aligned to its size relative to byte 4::

    4   int32 sec, uint32 nanosec              header.stamp
    12  uint32 length with NUL, characters     header.frame_id
        [align 4: the same]                    child_frame_id, of Odometry and TransformStamped
        align 8: 7 float64                     x y z qx qy qz qw
        [36 float64 covariance]                of Odometry and PoseWithCovarianceStamped
        [6 + 36 float64 twist]                 of Odometry only

ROS 1 has a sequence number in the header, no four bytes, no alignment and no NUL. A TFMessage is
the number of transforms and the transforms, each like a TransformStamped; a Path is a header, the
number of poses and the poses, each like a PoseStamped.

One message is parsed field by field to find the offsets of stamp and pose. All messages with the
same length, frame names and byte order have the same offsets, so NumPy reads them without a loop.
A message whose length does not match its fields is damaged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray

ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseStamped'
POSE_WITH_COVARIANCE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
TRANSFORM = 'geometry_msgs/msg/TransformStamped'
PATH = 'nav_msgs/msg/Path'
TF = 'tf2_msgs/msg/TFMessage'

# Number of float64 after the pose.
_TRAILING = {ODOMETRY: 36 + 6 + 36, POSE: 0, POSE_WITH_COVARIANCE: 36, TRANSFORM: 0}
_WITH_CHILD = (ODOMETRY, TRANSFORM, TF)

POSE_TYPES = tuple(_TRAILING)
TRAJECTORY_TYPES = (*POSE_TYPES, PATH)

_POSE_BYTES = 56

# header.frame_id and child_frame_id.
TwoFrames = tuple[str, str]


class Poses(NamedTuple):
    """Poses between two frames.

    Attributes
    ----------
    frames : header.frame_id and child_frame_id, '' if the type has none.
    messages : (N,), index of the message of each pose.
    stamps_ns : (N,) int64, header.stamp.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.

    """

    frames: TwoFrames
    messages: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]
    poses: FloatArray


class _PoseOffsets(NamedTuple):
    """Frames of a pose in a message, and the byte offsets of its stamp and numbers."""

    frames: TwoFrames
    stamp: int
    pose: int


def parse_pose(
    message: bytes, msgtype: str,
) -> tuple[int, TwoFrames, tuple[float, ...]] | None:
    """Return stamp (ns), frames and pose of a message of one of ``POSE_TYPES``.

    Frames and pose as in ``Poses``; None if the message is damaged.
    """
    fields = _parsed(message, msgtype)
    if fields is None:
        return None
    (frames, stamp, pose), = fields.pose_offsets
    sec, nanosec = struct.unpack_from(f'{fields.order}iI', message, stamp)
    return (sec * 1_000_000_000 + nanosec, frames,
            struct.unpack_from(f'{fields.order}7d', message, pose))


def parse_poses(
    messages: Sequence[bytes], msgtype: str, *, ros1: bool = False,
) -> tuple[list[Poses], int]:
    """Return the poses of messages of one type (not Path), and the number of damaged messages."""
    found: list[Poses] = []
    damaged = 0
    for indices, rows, fields in _groups_by_layout(messages, msgtype, ros1=ros1):
        if fields is None:
            damaged += len(indices)
            continue
        found += [Poses(offsets.frames, indices, *_values_at(rows, offsets, fields.order))
                  for offsets in fields.pose_offsets]
    return found, damaged


def parse_path(message: bytes, *, ros1: bool = False) -> Poses | None:
    """Return the poses of a Path, in the frame of its header; None if it is damaged."""
    parts = [(np.zeros(0, dtype=np.int64), np.zeros((0, 7)))]
    try:
        fields = _MessageParser(message, ros1=ros1)
        _, frame = fields.header()
        remaining = fields.count()
        while remaining:
            start = fields.offset
            fields.pose(child=False)
            size = fields.offset - start
            rows = np.frombuffer(message, np.uint8, (len(message) - start) // size * size, start)
            rows = rows.reshape(-1, size)[:remaining]
            # Poses with equal names have equal sizes, except after an unaligned first one.
            name = fields.layout_bytes[-1]
            same = _equal_first(rows, [slice(name.start - start, name.stop - start)])
            equal = 1 if size % 8 and not ros1 else len(same) if same.all() else int(same.argmin())
            fields.offset = start + equal * size
            remaining -= equal
            parts.append(_values_at(rows[:equal], fields.pose_offsets[-1], fields.order, start))
    except (struct.error, ValueError):
        return None
    if not fields.at_end:
        return None
    stamps_ns, poses = map(np.concatenate, zip(*parts, strict=True))
    return Poses((frame, ''), np.zeros(len(stamps_ns), np.intp), stamps_ns, poses)


def _groups_by_layout(
    messages: Sequence[bytes], msgtype: str, *, ros1: bool,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.uint8], _MessageParser | None]]:
    """Yield groups of one layout: message indices, (N, L) bytes, layout (None if damaged)."""
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    for length in np.unique(lengths):
        indices = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b''.join([messages[k] for k in indices.tolist()]), dtype=np.uint8)
        rows = rows.reshape(len(indices), length)
        while len(indices):
            fields = _parsed(messages[indices[0]], msgtype, ros1=ros1)
            same = _equal_first(rows, [slice(None)] if fields is None else fields.layout_bytes)
            # The usual case, all messages alike, needs no copy.
            yield (indices, rows, fields) if same.all() else (indices[same], rows[same], fields)
            indices, rows = indices[~same], rows[~same]


def _equal_first(rows: NDArray[np.uint8], layout_bytes: Sequence[slice]) -> NDArray[np.bool_]:
    """Return (N,), which of the (N, L) rows equal the first one in all of the slices."""
    # One slice at a time: they are short, and a block fits the cache.
    same: NDArray[np.bool_] = np.ones(len(rows), dtype=bool)
    for part in layout_bytes:
        same &= (rows[:, part] == rows[0, part]).all(axis=1)
    return same


def _values_at(
    rows: NDArray[np.uint8], offsets: _PoseOffsets, order: str, start: int = 0,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return (N,) stamps and (N, 7) poses from (N, L) bytes that begin at offset ``start``."""
    kind = np.dtype({
        'names': ('sec', 'nanosec', 'pose'),
        'formats': (f'{order}i4', f'{order}u4', f'{order}7f8'),
        'offsets': (offsets.stamp - start, offsets.stamp + 4 - start, offsets.pose - start),
        'itemsize': rows.shape[1]})
    fields = rows.view(kind)[:, 0]
    return (fields['sec'].astype(np.int64) * 1_000_000_000 + fields['nanosec'],
            fields['pose'].astype(np.float64))


def _parsed(message: bytes, msgtype: str, *, ros1: bool = False) -> _MessageParser | None:
    """Return the field offsets of a message, or None if it is damaged."""
    try:
        fields = _MessageParser(message, ros1=ros1)
        for _ in range(fields.count() if msgtype == TF else 1):
            fields.pose(child=msgtype in _WITH_CHILD)
    except (struct.error, ValueError):
        return None
    fields.offset += 8 * _TRAILING.get(msgtype, 0)
    return fields if fields.at_end else None


class _MessageParser:
    """Sequential parser of one message; raises ValueError or struct.error if it is too short.

    Attributes
    ----------
    offset : byte offset of the next field.
    order : byte order in ``struct`` notation.
    layout_bytes : byte ranges so far on which later offsets depend.
    pose_offsets : of the poses found so far.

    """

    def __init__(self, message: bytes, *, ros1: bool) -> None:
        self._message, self._ros1 = message, ros1
        self.offset = 0 if ros1 else 4
        if not ros1 and message[:2] not in (b'\x00\x00', b'\x00\x01'):
            raise ValueError('not plain CDR')
        self.order = '<' if ros1 or message[1] else '>'
        self.layout_bytes = [slice(0, 0 if ros1 else 2)]
        self.pose_offsets: list[_PoseOffsets] = []

    @property
    def at_end(self) -> bool:
        """Whether all bytes were parsed, except for padding to a multiple of four."""
        return 0 <= len(self._message) - self.offset <= (0 if self._ros1 else 3)

    def pose(self, *, child: bool) -> None:
        """Skip a header, a child frame (if ``child``) and a pose, and record their offsets."""
        stamp, frame = self.header()
        frames: TwoFrames = (frame, self._read_string() if child else '')
        self.pose_offsets.append(_PoseOffsets(frames, stamp, self._skip(_POSE_BYTES, 8)))

    def header(self) -> tuple[int, str]:
        """Skip a header; return the offset of its stamp, and its frame."""
        stamp = self._skip(12, 4) + 4 if self._ros1 else self._skip(8, 4)
        return stamp, self._read_string()

    def count(self) -> int:
        """Return the length of a sequence of poses."""
        start = self._skip(4, 4)
        self.layout_bytes.append(slice(start, start + 4))
        (count,) = struct.unpack_from(f'{self.order}I', self._message, start)
        # The shortest pose: a stamp, the length of an empty name, and the numbers.
        if count * (8 + 4 + _POSE_BYTES) > len(self._message):
            raise ValueError('more than fit')
        return int(count)

    def _read_string(self) -> str:
        start = self._skip(4, 4)
        (length,) = struct.unpack_from(f'{self.order}I', self._message, start)
        data = self._message[self._skip(length, 1):self.offset]
        self.layout_bytes.append(slice(start, self.offset))
        if self._ros1:
            return data.decode()
        # The length includes one NUL at the end.
        if not data.endswith(b'\0'):
            raise ValueError('a string without an end')
        return data[:-1].decode()

    def _skip(self, size: int, alignment: int) -> int:
        """Skip a field of some bytes; return its offset."""
        start = self.offset if self._ros1 else -(-(self.offset - 4) // alignment) * alignment + 4
        self.offset = start + size
        if self.offset > len(self._message):
            raise ValueError('cut off')
        return start
