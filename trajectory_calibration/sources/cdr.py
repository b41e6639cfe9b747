# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses straight out of serialized messages, without building message objects.

What DDS sends and bags hold is CDR: a header of four bytes (byte 1 is 1 where little endian),
then the fields, each aligned to its size counted from byte 4::

    4   int32 sec, uint32 nanosec              header.stamp
    12  uint32 length with NUL, characters     header.frame_id
        [align 4: the same]                    child_frame_id, of Odometry and TransformStamped
        align 8: 7 float64                     x y z qx qy qz qw
        [36 float64 covariance]                all but PoseStamped
        [6 + 36 float64 twist]                 of Odometry only

ROS 1 has a counter in place of the four bytes, no alignment, and no NUL. A TFMessage is the
number of its transforms and the transforms, each like a TransformStamped.

Messages of one length and one pair of frames have the pose at one place: a block of them is an
array, which NumPy views without a loop. Everything is checked against the length of the
message; what does not fit is left to a general deserialiser.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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

# Numbers from the start of the pose to the end of the message.
DOUBLES = {ODOMETRY: 7 + 36 + 6 + 36, POSE: 7, POSE_WITH_COVARIANCE: 7 + 36, TRANSFORM: 7}
_WITH_CHILD = (ODOMETRY, TRANSFORM)

POSE_TYPES = tuple(DOUBLES)
TRAJECTORY_TYPES = (*POSE_TYPES, PATH)

_POSE_BYTES = 56
# Bytes that a writer may append to a message to fill a word.
_MAX_PADDING = 3
# Different frame ids in one block beyond which the general deserialiser takes the rest.
_MAX_FRAMES = 8


# header.frame_id and child_frame_id.
TwoFrames = tuple[str, str]


class StampedPose(NamedTuple):
    """One pose message.

    Attributes
    ----------
    stamp_ns : header.stamp, nanoseconds.
    frames : header.frame_id and child_frame_id, empty where the type has none.
    pose : x, y, z (m), qx, qy, qz, qw.

    """

    stamp_ns: int
    frames: TwoFrames
    pose: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PoseBlock:
    """Many pose messages.

    Attributes
    ----------
    stamps_ns : (N,) int64, header.stamp.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.
    frame_index : (N,), index into ``frames``; -1 for a message that was not understood, whose
        stamp and pose mean nothing.
    frames : pairs of header.frame_id and child_frame_id.

    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    frame_index: NDArray[np.intp]
    frames: list[tuple[str, str]]


class PathPoses(NamedTuple):
    """The poses of one Path: header.frame_id, (N,) int64 stamps, (N, 7) poses as above."""

    frame: str
    stamps_ns: NDArray[np.int64]
    poses: FloatArray


class TransformRun(NamedTuple):
    """Transforms between two frames: in which messages, (N,) stamps, (N, 7) poses as above."""

    frames: TwoFrames
    messages: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]
    poses: FloatArray


class _Layout(NamedTuple):
    """Where stamp and pose of a message begin, and which bytes decide that."""

    frames: TwoFrames
    stamp_offset: int
    pose_offset: int
    deciding: list[slice]


def parse_pose(message: bytes, msgtype: str) -> StampedPose | None:
    """Return the pose of one serialized message, or None where it is not plain CDR.

    ``msgtype`` is one of ``POSE_TYPES``.
    """
    layout = _layout(message, msgtype)
    if layout is None:
        return None
    sec, nanosec = struct.unpack_from('<iI', message, 4)
    pose = struct.unpack_from('<7d', message, layout.pose_offset)
    return StampedPose(sec * 1_000_000_000 + nanosec, layout.frames, pose)


def parse_poses(messages: Sequence[bytes], msgtype: str, *, ros1: bool = False) -> PoseBlock:
    """Return the poses of many serialized messages of one of ``POSE_TYPES``."""
    count = len(messages)
    block = PoseBlock(
        np.zeros(count, dtype=np.int64), np.zeros((count, 7)), np.full(count, -1), [])
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=count)
    for length in np.unique(lengths):
        _parse_equal_lengths(
            messages, np.flatnonzero(lengths == length), msgtype, block, ros1=ros1)
    return block


def parse_transforms(messages: Sequence[bytes]) -> tuple[list[TransformRun], list[int]]:
    """Return the transforms of many TFMessages, and which messages were not understood."""
    runs, left = [], []
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    for length in np.unique(lengths):
        indices = np.flatnonzero(lengths == length)
        rows = _rows(messages, indices)
        for _ in range(_MAX_FRAMES):
            if not len(indices):
                break
            layouts = _transform_layouts(messages[indices[0]])
            if layouts is None:
                left.append(int(indices[0]))
                indices, rows = indices[1:], rows[1:]
                continue
            same = _same(rows, [part for layout in layouts for part in layout.deciding])
            runs += [TransformRun(
                layout.frames, indices[same],
                _stamps_ns(rows[same, layout.stamp_offset:layout.stamp_offset + 8]),
                _doubles(rows[same, layout.pose_offset:layout.pose_offset + _POSE_BYTES]))
                for layout in layouts]
            indices, rows = indices[~same], rows[~same]
        left += indices.tolist()
    return runs, left


def parse_path(message: bytes) -> PathPoses | None:
    """Return the poses of a serialized nav_msgs/Path, or None where it is not plain CDR.

    Equal frame ids in all of its poses give them one distance in the message; others are left
    to a general deserialiser.
    """
    if not _is_little_endian(message):
        return None
    header = _string(message, 12)
    if header is None or len(message) < _align(header.end, 4) + 4:
        return None
    start = _align(header.end, 4) + 4
    count = int.from_bytes(message[start - 4:start], 'little')
    if count == 0 and len(message) - start <= _MAX_PADDING:
        return PathPoses(header.text, np.zeros(0, dtype=np.int64), np.zeros((0, 7)))
    frame = _string(message, start + 8)
    if count == 0 or frame is None:
        return None
    # The first pose may begin between two multiples of eight; the others begin on one.
    first_end = _align(frame.end, 8) + _POSE_BYTES
    head = 8 + frame.end - frame.start
    stride = -(-head // 8) * 8 + _POSE_BYTES
    if not 0 <= len(message) - (first_end + (count - 1) * stride) <= _MAX_PADDING:
        return None
    data = np.frombuffer(message, dtype=np.uint8)
    rest = data[first_end:first_end + (count - 1) * stride].reshape(count - 1, stride)
    same_frame = (rest[:, 8:head] == data[start + 8:frame.end]).all()
    if not same_frame:
        return None
    stamps = np.vstack([data[start:start + 8], rest[:, :8]])
    poses = np.vstack([data[first_end - _POSE_BYTES:first_end], rest[:, stride - _POSE_BYTES:]])
    return PathPoses(header.text, _stamps_ns(stamps), _doubles(poses))


def _parse_equal_lengths(
    messages: Sequence[bytes], indices: NDArray[np.intp], msgtype: str, block: PoseBlock, *,
    ros1: bool,
) -> None:
    """Fill ``block`` at ``indices``, whose messages have the same length."""
    rows = _rows(messages, indices)
    for _ in range(_MAX_FRAMES):
        if not len(indices):
            return
        layout = _layout(messages[indices[0]], msgtype, ros1=ros1)
        if layout is None:
            indices, rows = indices[1:], rows[1:]
            continue
        same = _same(rows, layout.deciding)
        chosen, offset = indices[same], layout.pose_offset
        block.stamps_ns[chosen] = _stamps_ns(rows[same, 4:12])
        block.poses[chosen] = _doubles(rows[same, offset:offset + _POSE_BYTES])
        if layout.frames not in block.frames:
            block.frames.append(layout.frames)
        block.frame_index[chosen] = block.frames.index(layout.frames)
        indices, rows = indices[~same], rows[~same]


def _rows(messages: Sequence[bytes], indices: NDArray[np.intp]) -> NDArray[np.uint8]:
    """Return (N, L) bytes of some messages of equal length."""
    return np.frombuffer(
        b''.join([messages[k] for k in indices.tolist()]), dtype=np.uint8,
    ).reshape(len(indices), -1)


def _same(rows: NDArray[np.uint8], deciding: Sequence[slice]) -> NDArray[np.bool_]:
    """Tell which rows agree with the first one where it matters."""
    # A slice at a time: frames are short, and a block fits the cache.
    same: NDArray[np.bool_] = np.ones(len(rows), dtype=bool)
    for part in deciding:
        same &= (rows[:, part] == rows[0, part]).all(axis=1)
    return same


def _layout(message: bytes, msgtype: str, *, ros1: bool = False) -> _Layout | None:
    if not ros1 and not _is_little_endian(message):
        return None
    header = _string(message, 12, ros1=ros1)
    if header is None:
        return None
    strings = [header]
    if msgtype in _WITH_CHILD:
        child = _string(message, _align(header.end, 4, ros1=ros1), ros1=ros1)
        if child is None:
            return None
        strings.append(child)
    offset = _align(strings[-1].end, 8, ros1=ros1)
    padding = len(message) - (offset + 8 * DOUBLES[msgtype])
    if padding and (ros1 or not 0 < padding <= _MAX_PADDING):
        return None
    encapsulation = [] if ros1 else [slice(0, 2)]
    return _Layout(
        (header.text, strings[1].text if len(strings) > 1 else ''), 4, offset,
        [*encapsulation, *(slice(item.start, item.end) for item in strings)])


def _transform_layouts(message: bytes) -> list[_Layout] | None:
    """Return where each transform of a TFMessage is, None where that is not plain CDR."""
    if not _is_little_endian(message):
        return None
    layouts = []
    count, offset = int.from_bytes(message[4:8], 'little'), 8
    for _ in range(min(count, len(message))):
        start = _align(offset, 4)
        header = _string(message, start + 8)
        child = None if header is None else _string(message, _align(header.end, 4))
        if header is None or child is None:
            return None
        offset = _align(child.end, 8) + _POSE_BYTES
        layouts.append(_Layout(
            (header.text, child.text), start, offset - _POSE_BYTES,
            [slice(0, 2), slice(4, 8), slice(header.start, header.end),
             slice(child.start, child.end)]))
    return layouts if 0 <= len(message) - offset <= _MAX_PADDING else None


class _String(NamedTuple):
    """A string in a message: its text, where its length begins, where its characters end."""

    text: str
    start: int
    end: int


def _string(message: bytes, start: int, *, ros1: bool = False) -> _String | None:
    end = start + 4 + int.from_bytes(message[start:start + 4], 'little')
    # In CDR, the characters end with one NUL, which the length counts.
    terminated = ros1 or (end > start + 4 and message[end - 1:end] == b'\0')
    if not start + 4 <= end <= len(message) or not terminated:
        return None
    try:
        return _String(message[start + 4:end - (not ros1)].decode(), start, end)
    except UnicodeDecodeError:
        return None


def _is_little_endian(message: bytes) -> bool:
    return message[:2] == b'\x00\x01'


def _align(offset: int, size: int, *, ros1: bool = False) -> int:
    if ros1:
        return offset
    return -(-(offset - 4) // size) * size + 4


def _stamps_ns(rows: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return (N,) nanoseconds of the (N, 8) bytes of builtin_interfaces/Time."""
    data = np.ascontiguousarray(rows)
    sec = data[:, :4].copy().view('<i4')[:, 0].astype(np.int64)
    nanosec = data[:, 4:].copy().view('<u4')[:, 0].astype(np.int64)
    stamps_ns: NDArray[np.int64] = sec * 1_000_000_000 + nanosec
    return stamps_ns


def _doubles(rows: NDArray[np.uint8]) -> FloatArray:
    """Return the (N, 7) numbers of (N, 56) bytes."""
    return np.ascontiguousarray(rows).view('<f8').astype(np.float64)
