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

# header.frame_id and child_frame_id.
TwoFrames = tuple[str, str]


class Poses(NamedTuple):
    """Poses between two frames.

    Attributes
    ----------
    frames : header.frame_id and child_frame_id, empty where the type has none.
    messages : (N,), which message each of them is of.
    stamps_ns : (N,) int64, header.stamp.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw.

    """

    frames: TwoFrames
    messages: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]
    poses: FloatArray


class _Place(NamedTuple):
    """Where the stamp and the numbers of a pose begin in a message, and between which frames."""

    frames: TwoFrames
    stamp: int
    pose: int


def parse_pose(
    message: bytes, msgtype: str,
) -> tuple[int, TwoFrames, tuple[float, ...]] | None:
    """Return the pose of a message of one of ``POSE_TYPES``, or None where it is damaged.

    That is header.stamp in nanoseconds, the frames, and the pose, each as in ``Poses``.
    """
    fields = _walked(message, msgtype)
    if fields is None:
        return None
    (frames, stamp, pose), = fields.places
    sec, nanosec = struct.unpack_from(f'{fields.order}iI', message, stamp)
    return (sec * 1_000_000_000 + nanosec, frames,
            struct.unpack_from(f'{fields.order}7d', message, pose))


def parse_poses(
    messages: Sequence[bytes], msgtype: str, *, ros1: bool = False,
) -> tuple[list[Poses], int]:
    """Return the poses of many messages of one type, any but Path, and how many are damaged."""
    found: list[Poses] = []
    damaged = 0
    for indices, rows, fields in _groups(messages, msgtype, ros1=ros1):
        if fields is None:
            damaged += len(indices)
            continue
        found += [Poses(place.frames, indices, *_values(rows, place, fields.order))
                  for place in fields.places]
    return found, damaged


def parse_path(message: bytes, *, ros1: bool = False) -> Poses | None:
    """Return the poses of a Path, in the frame of its header; None where it is damaged."""
    parts = [(np.zeros(0, dtype=np.int64), np.zeros((0, 7)))]
    try:
        fields = _Fields(message, ros1=ros1)
        _, frame = fields.header()
        left = fields.count()
        while left:
            start = fields.offset
            fields.pose(child=False)
            size = fields.offset - start
            rows = np.frombuffer(message, np.uint8, (len(message) - start) // size * size, start)
            rows = rows.reshape(-1, size)[:left]
            # Poses of equal names have one size, but for a first one that begins between words.
            name = fields.deciding[-1]
            same = _same(rows, [slice(name.start - start, name.stop - start)])
            equal = 1 if size % 8 and not ros1 else len(same) if same.all() else int(same.argmin())
            fields.offset = start + equal * size
            left -= equal
            parts.append(_values(rows[:equal], fields.places[-1], fields.order, start))
    except (struct.error, ValueError):
        return None
    if not fields.ended:
        return None
    stamps_ns, poses = map(np.concatenate, zip(*parts, strict=True))
    return Poses((frame, ''), np.zeros(len(stamps_ns), np.intp), stamps_ns, poses)


def _groups(
    messages: Sequence[bytes], msgtype: str, *, ros1: bool,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.uint8], _Fields | None]]:
    """Yield which messages have one layout, None if damaged, and their (N, L) bytes."""
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    for length in np.unique(lengths):
        indices = np.flatnonzero(lengths == length)
        rows = np.frombuffer(b''.join([messages[k] for k in indices.tolist()]), dtype=np.uint8)
        rows = rows.reshape(len(indices), length)
        while len(indices):
            fields = _walked(messages[indices[0]], msgtype, ros1=ros1)
            same = _same(rows, [slice(None)] if fields is None else fields.deciding)
            # All of them, as they mostly are, need no copy.
            yield (indices, rows, fields) if same.all() else (indices[same], rows[same], fields)
            indices, rows = indices[~same], rows[~same]


def _same(rows: NDArray[np.uint8], deciding: Sequence[slice]) -> NDArray[np.bool_]:
    """Tell which rows agree with the first one where it matters."""
    # A slice at a time: frames are short, and a block fits the cache.
    same: NDArray[np.bool_] = np.ones(len(rows), dtype=bool)
    for part in deciding:
        same &= (rows[:, part] == rows[0, part]).all(axis=1)
    return same


def _values(
    rows: NDArray[np.uint8], place: _Place, order: str, start: int = 0,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return (N,) stamps and (N, 7) poses at one place of (N, L) bytes, which begin at a byte."""
    kind = np.dtype({
        'names': ('sec', 'nanosec', 'pose'),
        'formats': (f'{order}i4', f'{order}u4', f'{order}7f8'),
        'offsets': (place.stamp - start, place.stamp + 4 - start, place.pose - start),
        'itemsize': rows.shape[1]})
    fields = rows.view(kind)[:, 0]
    return (fields['sec'].astype(np.int64) * 1_000_000_000 + fields['nanosec'],
            fields['pose'].astype(np.float64))


def _walked(message: bytes, msgtype: str, *, ros1: bool = False) -> _Fields | None:
    """Return a message of which all fields have been passed, or None where it is damaged."""
    try:
        fields = _Fields(message, ros1=ros1)
        for _ in range(fields.count() if msgtype == TF else 1):
            fields.pose(child=msgtype in _WITH_CHILD)
    except (struct.error, ValueError):
        return None
    fields.offset += 8 * _REST.get(msgtype, 0)
    return fields if fields.ended else None


class _Fields:
    """A message that is walked from its beginning; raises where it ends too soon.

    Attributes
    ----------
    offset : where the next field begins.
    order : of the bytes, as ``struct`` writes it.
    deciding : the bytes so far that decide where the following ones are.
    places : of the poses so far.

    """

    def __init__(self, message: bytes, *, ros1: bool) -> None:
        self._message, self._ros1 = message, ros1
        self.offset = 0 if ros1 else 4
        if not ros1 and message[:2] not in (b'\x00\x00', b'\x00\x01'):
            raise ValueError('not plain CDR')
        self.order = '<' if ros1 or message[1] else '>'
        self.deciding = [slice(0, 0 if ros1 else 2)]
        self.places: list[_Place] = []

    @property
    def ended(self) -> bool:
        """Whether nothing is left but padding, with which a writer may fill a word."""
        return 0 <= len(self._message) - self.offset <= (0 if self._ros1 else 3)

    def pose(self, *, child: bool) -> None:
        """Pass a header, the name of a child, and a pose."""
        stamp, frame = self.header()
        frames: TwoFrames = (frame, self._text() if child else '')
        self.places.append(_Place(frames, stamp, self._pass(_POSE_BYTES, 8)))

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
