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
number of its transforms and the transforms, each like a TransformStamped; a Path is a header, the
number of its poses and the poses, each like a PoseStamped.

One message is walked field by field, which tells where stamp and pose are; all messages of its
length, names and order of bytes have them at the same place, and NumPy reads those without a
loop. A message that is shorter or longer than its fields is none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

# Numbers after the pose.
_REST = {ODOMETRY: 36 + 6 + 36, POSE: 0, POSE_WITH_COVARIANCE: 36, TRANSFORM: 0}
_WITH_CHILD = (ODOMETRY, TRANSFORM, TF)

POSE_TYPES = tuple(_REST)
TRAJECTORY_TYPES = (*POSE_TYPES, PATH)

_POSE_BYTES = 56
# Groups of equal messages that are looked for in a block; the rest is read one by one.
_MAX_GROUPS = 8

# header.frame_id and child_frame_id.
TwoFrames = tuple[str, str]


@dataclass(frozen=True, eq=False)
class PoseBlock:
    """Many pose messages.

    Attributes
    ----------
    stamps_ns : (N,) int64, header.stamp.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.
    frame_index : (N,), index into ``frames``; -1 for a message that is damaged, whose stamp and
        pose mean nothing.
    frames : pairs of header.frame_id and child_frame_id.

    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    frame_index: NDArray[np.intp]
    frames: list[TwoFrames]


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


class _Place(NamedTuple):
    """Where the stamp and the numbers of a pose begin in a message, and between which frames."""

    frames: TwoFrames
    stamp: int
    pose: int


class _Layout(NamedTuple):
    """Where the poses of a message are, its order of bytes, and which bytes decide that."""

    places: list[_Place]
    order: str
    deciding: list[slice]


def parse_pose(
    message: bytes, msgtype: str,
) -> tuple[int, TwoFrames, tuple[float, ...]] | None:
    """Return the pose of a message of one of ``POSE_TYPES``, or None where it is damaged.

    That is header.stamp in nanoseconds; the frames, empty where the type has none; x, y, z (m),
    qx, qy, qz, qw.
    """
    layout = _layout(message, msgtype)
    if layout is None:
        return None
    (frames, stamp, pose), = layout.places
    sec, nanosec = struct.unpack_from(f'{layout.order}iI', message, stamp)
    return (sec * 1_000_000_000 + nanosec, frames,
            struct.unpack_from(f'{layout.order}7d', message, pose))


def parse_poses(messages: Sequence[bytes], msgtype: str, *, ros1: bool = False) -> PoseBlock:
    """Return the poses of many messages of one of ``POSE_TYPES``."""
    count = len(messages)
    block = PoseBlock(
        np.zeros(count, dtype=np.int64), np.zeros((count, 7)), np.full(count, -1), [])
    for indices, rows, layout in _groups(messages, msgtype, ros1=ros1):
        if layout is None:
            continue
        (place,) = layout.places
        if place.frames not in block.frames:
            block.frames.append(place.frames)
        block.stamps_ns[indices], block.poses[indices] = _values(rows, place, layout.order)
        block.frame_index[indices] = block.frames.index(place.frames)
    return block


def parse_transforms(
    messages: Sequence[bytes], *, ros1: bool = False,
) -> tuple[list[TransformRun], int]:
    """Return the transforms of many TFMessages, and how many messages are damaged."""
    runs: list[TransformRun] = []
    damaged = 0
    for indices, rows, layout in _groups(messages, TF, ros1=ros1):
        if layout is None:
            damaged += len(indices)
            continue
        runs += [TransformRun(place.frames, indices, *_values(rows, place, layout.order))
                 for place in layout.places]
    return runs, damaged


def parse_path(message: bytes, *, ros1: bool = False) -> PathPoses | None:
    """Return the poses of a Path, or None where it is damaged."""
    stamps_ns, poses = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 7))]
    try:
        fields = _Fields(message, ros1=ros1)
        _, frame = fields.header()
        left = fields.count()
        while left:
            start = fields.offset
            place, size = fields.pose(child=False), fields.offset - start
            rows = np.frombuffer(message, np.uint8, (len(message) - start) // size * size, start)
            rows = rows.reshape(-1, size)[:left]
            # Poses of equal names have one size, but for a first one that begins between words.
            name = fields.deciding[-1]
            same = _same(rows, [slice(name.start - start, name.stop - start)])
            equal = 1 if size % 8 and not ros1 else len(same) if same.all() else int(same.argmin())
            fields.offset = start + equal * size
            left -= equal
            place = _Place(place.frames, place.stamp - start, place.pose - start)
            stamps, numbers = _values(rows[:equal], place, fields.order)
            stamps_ns.append(stamps)
            poses.append(numbers)
    except (struct.error, ValueError):
        return None
    return PathPoses(frame, np.concatenate(stamps_ns), np.concatenate(poses)) if (
        fields.ended) else None


def _groups(
    messages: Sequence[bytes], msgtype: str, *, ros1: bool,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.uint8], _Layout | None]]:
    """Yield which messages have one layout, None if damaged, and their (N, L) bytes."""
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    for length in np.unique(lengths):
        indices = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b''.join([messages[k] for k in indices.tolist()]), dtype=np.uint8)
        rows = rows.reshape(len(indices), length)
        for _ in range(_MAX_GROUPS):
            if not len(indices):
                break
            layout = _layout(messages[indices[0]], msgtype, ros1=ros1)
            same = _same(rows, [slice(None)] if layout is None else layout.deciding)
            # All of them, as they mostly are, need no copy.
            yield (indices, rows, layout) if same.all() else (indices[same], rows[same], layout)
            indices, rows = indices[~same], rows[~same]
        for k, index in enumerate(indices.tolist()):
            yield (indices[k:k + 1], rows[k:k + 1],
                   _layout(messages[index], msgtype, ros1=ros1))


def _same(rows: NDArray[np.uint8], deciding: Sequence[slice]) -> NDArray[np.bool_]:
    """Tell which rows agree with the first one where it matters."""
    # A slice at a time: frames are short, and a block fits the cache.
    same: NDArray[np.bool_] = np.ones(len(rows), dtype=bool)
    for part in deciding:
        same &= (rows[:, part] == rows[0, part]).all(axis=1)
    return same


def _values(
    rows: NDArray[np.uint8], place: _Place, order: str,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the (N,) stamps and the (N, 7) poses at one place of (N, L) bytes."""
    time = np.ascontiguousarray(rows[:, place.stamp:place.stamp + 8])
    sec = time.view(f'{order}i4')[:, 0].astype(np.int64)
    poses = np.ascontiguousarray(rows[:, place.pose:place.pose + _POSE_BYTES])
    return (sec * 1_000_000_000 + time.view(f'{order}u4')[:, 1],
            poses.view(f'{order}f8').astype(np.float64))


def _layout(message: bytes, msgtype: str, *, ros1: bool = False) -> _Layout | None:
    """Return where the poses of a message are, or None where it is damaged."""
    try:
        fields = _Fields(message, ros1=ros1)
        places = [fields.pose(child=msgtype in _WITH_CHILD)
                  for _ in range(fields.count() if msgtype == TF else 1)]
    except (struct.error, ValueError):
        return None
    fields.offset += 8 * _REST.get(msgtype, 0)
    return _Layout(places, fields.order, fields.deciding) if fields.ended else None


class _Fields:
    """A message that is walked from its beginning; raises where it ends too soon.

    Attributes
    ----------
    offset : where the next field begins.
    order : of the bytes, as ``struct`` writes it.
    deciding : the bytes so far that decide where the following ones are.

    """

    def __init__(self, message: bytes, *, ros1: bool) -> None:
        self._message, self._ros1 = message, ros1
        self.offset = 0 if ros1 else 4
        if not ros1 and message[:2] not in (b'\x00\x00', b'\x00\x01'):
            raise ValueError('not plain CDR')
        self.order = '<' if ros1 or message[1] else '>'
        self.deciding = [slice(0, 0 if ros1 else 2)]

    @property
    def ended(self) -> bool:
        """Whether nothing is left but padding, with which a writer may fill a word."""
        return 0 <= len(self._message) - self.offset <= (0 if self._ros1 else 3)

    def pose(self, *, child: bool) -> _Place:
        """Pass a header, the name of a child, and a pose."""
        stamp, frame = self.header()
        frames: TwoFrames = (frame, self._text() if child else '')
        return _Place(frames, stamp, self._pass(_POSE_BYTES, 8))

    def header(self) -> tuple[int, str]:
        """Pass a header; return where its stamp begins, and its frame."""
        stamp = self._pass(12, 4) + 4 if self._ros1 else self._pass(8, 4)
        return stamp, self._text()

    def count(self) -> int:
        """Return the length of a sequence of poses."""
        start = self._pass(4, 4)
        self.deciding.append(slice(start, start + 4))
        (count,) = struct.unpack_from(f'{self.order}I', self._message, start)
        # A stamp, a length of a name and the numbers are the shortest pose.
        if count * (8 + 4 + _POSE_BYTES) > len(self._message):
            raise ValueError('more than fit')
        return int(count)

    def _text(self) -> str:
        start = self._pass(4, 4)
        (length,) = struct.unpack_from(f'{self.order}I', self._message, start)
        data = self._message[self._pass(length, 1):self.offset]
        self.deciding.append(slice(start, self.offset))
        if self._ros1:
            return data.decode()
        # The characters end with one NUL, which the length counts.
        if not data.endswith(b'\0'):
            raise ValueError('a string without an end')
        return data[:-1].decode()

    def _pass(self, size: int, alignment: int) -> int:
        """Pass a field; return where it begins."""
        start = self.offset if self._ros1 else -(-(self.offset - 4) // alignment) * alignment + 4
        self.offset = start + size
        if self.offset > len(self._message):
            raise ValueError('cut off')
        return start
