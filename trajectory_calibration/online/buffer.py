# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The poses of one sensor as they arrive: bounded, checked, ready to be calibrated from.

Nothing here imports ROS, so that a replay of a bag runs through the same code as the node.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from itertools import islice
import math

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import (
    MAX_POSITION,
    pose_faults,
    ROTATION_TOLERANCE,
)
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.snapshot import Snapshot

# A stamp this far behind the newest came late; further behind, or this far ahead, either it is
# wrong or the clock jumped. The poses that follow decide which.
JUMP_NS = 5_000_000_000
# So many poses in a row must agree before a jump of the clock, or other frames, are believed.
CONFIRMATIONS = 3

# Names of the world frame and of the sensor frame; empty where a message has none.
Frames = tuple[str, str]

_NO_FRAMES = ('', '')

# Position x, y, z (metres) and quaternion x, y, z, w.
PoseTuple = tuple[float, ...]


class Refusal(str, Enum):
    """Why a pose did not enter the buffer; the words of the diagnostics."""

    NO_STAMP = 'no stamp'
    NOT_FINITE = 'not finite'
    NOT_UNIT = 'not a unit quaternion'
    TOO_FAR = 'too far away'
    DUPLICATE = 'duplicate stamp'
    OUT_OF_ORDER = 'out of order'
    STRAY_STAMP = 'stray stamp'
    OTHER_FRAME = 'other frame'
    UNREADABLE = 'unreadable'
    EMPTY_PATH = 'path without a usable pose'


# Of these the unit is the message, not the pose.
OF_MESSAGES = (Refusal.UNREADABLE, Refusal.EMPTY_PATH)
# As ``pose_faults`` tells them apart.
_FAULTS = (Refusal.NOT_FINITE, Refusal.NOT_UNIT, Refusal.TOO_FAR)


@dataclass(frozen=True)
class BufferLimits:
    """How much a buffer keeps; the options of these names say what each limit is."""

    max_poses: int = 100_000
    max_age_s: float = 28_800.0
    still_after_s: float = 2.0
    still_distance: float = 0.02
    still_angle_deg: float = 0.2


class PoseBuffer:
    """The newest poses of one sensor, in order, in arrays that do not grow beyond a bound.

    A bad pose is counted and refused, never an error: a vehicle keeps driving. ``forgotten``
    counts the poses held when the clock went back or other frames were believed; ``generation``
    changes whenever poses were forgotten other than by age or number.
    """

    def __init__(self, limits: BufferLimits) -> None:
        self._limits = limits
        self._max_age_ns = round(limits.max_age_s * 1e9)
        self._still_after_ns = round(limits.still_after_s * 1e9)
        self._still_distance_squared = limits.still_distance**2
        self._still_cosine = math.cos(math.radians(limits.still_angle_deg) / 2)
        self.generation = 0
        self.received = 0
        self.clear()

    def clear(self) -> None:
        """Forget all poses, frames and counts."""
        self._received_before = self.received
        # Poses dropped because the sensor stood still.
        self.still = 0
        self.clock_jumps = self.frame_changes = self.forgotten = 0
        self.frames_before = _NO_FRAMES
        self._slashed = False
        self.refused = dict.fromkeys(Refusal, 0)
        self._forget_poses()

    def __len__(self) -> int:
        return self._end - self._start

    @property
    def messages(self) -> int:
        """Messages since the start or the last ``clear``."""
        return self.received - self._received_before

    @property
    def nbytes(self) -> int:
        """Bytes of memory held for poses."""
        return self._stamps.nbytes + self._poses.nbytes

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps of the oldest and the newest pose, or None where there is none."""
        if not len(self):
            return None
        return int(self._stamps[self._start]), int(self._stamps[self._end - 1])

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return a view of all stamps."""
        return self._stamps[self._start:self._end]

    def append(self, stamp_ns: int, frames: Frames, pose: PoseTuple) -> None:
        """Take one pose as it arrives, or count why not."""
        self.received += 1
        fault = fault_of(pose) if stamp_ns else Refusal.NO_STAMP
        if fault is not None:
            self.refused[fault] += 1
            return
        if frames != self.frames:
            frames = self._without_slashes(frames)
        if frames != self.frames:
            if len(self) >= CONFIRMATIONS:
                self._consider_frames(stamp_ns, frames, pose)
                return
            self._change_frames(frames)
        self._strangers.clear()
        step = stamp_ns - self._last_ns
        if 0 < step <= JUMP_NS or not len(self):
            self._drop_strays()
            self._store(stamp_ns, pose)
        elif step == 0:
            self.refused[Refusal.DUPLICATE] += 1
        elif -JUMP_NS <= step < 0:
            self.refused[Refusal.OUT_OF_ORDER] += 1
        else:
            self._consider_jump(stamp_ns, pose)

    def count_unreadable(self) -> None:
        """Count a message of which nothing could be read."""
        self.received += 1
        self.refused[Refusal.UNREADABLE] += 1

    def count_refused(self, counts: Iterable[int]) -> None:
        """Count (3,) poses that were refused before, as ``pose_faults`` tells them apart."""
        for why, count in zip(_FAULTS, map(int, counts), strict=True):
            self.received += count
            self.refused[why] += count

    def replace(
        self, stamps_ns: NDArray[np.int64], poses: FloatArray, frames: Frames,
    ) -> None:
        """Hold the (N,) stamps and (N, 7) poses of a whole trajectory instead of what was held.

        For a SLAM that publishes its optimised path again and again. The counts of refused and
        dropped poses are those of this trajectory; those of messages go on. A trajectory without
        a usable pose is counted and replaces nothing.
        """
        self.received += 1
        self.refused = {why: self.refused[why] if why in OF_MESSAGES else 0 for why in Refusal}
        usable = np.ones(len(stamps_ns), dtype=bool)
        for why, bad in zip(
                (Refusal.NO_STAMP, *_FAULTS),
                (stamps_ns == 0, *pose_faults(poses)), strict=True):
            self.refused[why] = int(np.count_nonzero(usable & bad))
            usable &= ~bad
        sorted_ns, first = np.unique(stamps_ns[usable], return_index=True)
        self.refused[Refusal.DUPLICATE] = int(np.count_nonzero(usable)) - len(first)
        if not len(first):
            self.refused[Refusal.EMPTY_PATH] += 1
            return
        self._change_frames(self._without_slashes(frames))
        self.still = 0
        strays = self.refused[Refusal.STRAY_STAMP] = self._strays(sorted_ns)
        row = zip(sorted_ns.tolist(), map(tuple, poses[usable][first].tolist()), strict=True)
        self._store_all(islice(row, len(first) - strays))

    def _strays(self, sorted_ns: NDArray[np.int64]) -> int:
        """Return how many of the last of the sorted stamps are wrong.

        Fewer than CONFIRMATIONS are, if only without them so many poses are within the age.
        """
        for strays in range(CONFIRMATIONS):
            ends = sorted_ns[:len(sorted_ns) - strays][-CONFIRMATIONS:]
            if len(ends) == CONFIRMATIONS and ends[-1] - ends[0] <= self._max_age_ns:
                return strays
        return 0

    def snapshot(self, name: str, sensor_frame: str = '') -> Snapshot:
        """Return a copy; the sensor is ``sensor_frame``, or as its messages say, or ``name``."""
        world, sensor = self.frames
        frame = sensor_frame or sensor or name
        held = slice(self._start, self._end)
        slashes = ('the leading slash of its frame ids was removed (tf2 refuses it)'
                   if self._slashed else '')
        return Snapshot(
            self._stamps[held].copy(), self._poses[held].copy(), world or 'map', frame,
            tuple(f'{frame}: {note}' for note in (self.refusals(), slashes) if note))

    def refusals(self) -> str:
        """Return the counts of refused poses and messages in words, or '' where none was."""
        sentences = []
        for unit, reasons in (('pose', [why for why in Refusal if why not in OF_MESSAGES]),
                              ('message', OF_MESSAGES)):
            counts = {why.value: self.refused[why] for why in reasons if self.refused[why]}
            if counts:
                words = ', '.join(f'{count} {why}' for why, count in counts.items())
                sentences.append(f'{counted(sum(counts.values()), unit)} refused ({words})')
        return ', '.join(sentences)

    def _without_slashes(self, frames: Frames) -> Frames:
        """Return frame ids as tf2 takes them: it refuses a leading slash."""
        plain = frames[0].lstrip('/'), frames[1].lstrip('/')
        self._slashed |= plain != frames
        return plain

    def _forget_poses(self, frames: Frames = _NO_FRAMES) -> None:
        self.frames = frames
        self.generation += 1
        self._stamps = np.empty(0, np.int64)
        self._poses = np.empty((0, 7))
        self._start = self._end = 0
        self._last_ns = 0
        # Where the sensor was when it moved last, and when.
        self._anchor: tuple[int, PoseTuple] = 0, ()
        self._jump: list[tuple[int, PoseTuple]] = []
        # Poses in a row in frames that are not those held, and these frames.
        self._strangers: list[tuple[int, PoseTuple]] = []
        self._strange_frames = _NO_FRAMES

    def _change_frames(self, frames: Frames) -> None:
        if len(self) and frames != self.frames:
            self.frame_changes += 1
            self.frames_before = self.frames
        self._forget_poses(frames)

    def _consider_frames(self, stamp_ns: int, frames: Frames, pose: PoseTuple) -> None:
        """Refuse a pose in other frames, unless those before it were in these, too."""
        self.refused[Refusal.OTHER_FRAME] += 1
        if frames != self._strange_frames:
            self._strangers.clear()
            self._strange_frames = frames
        step = stamp_ns - self._strangers[-1][0] if self._strangers else 1
        if -JUMP_NS <= step <= 0:
            return
        # Of two poses so far apart, one has a wrong stamp: the later one decides which.
        if abs(step) > JUMP_NS:
            self._strangers.clear()
        self._strangers.append((stamp_ns, pose))
        if self._is_confirmed(self._strangers):
            self.refused[Refusal.OTHER_FRAME] -= len(self._strangers)
            self._begin_anew(self._strangers, frames)

    def _begin_anew(self, row: list[tuple[int, PoseTuple]], frames: Frames) -> None:
        self.forgotten += len(self)
        self._change_frames(frames)
        self._store_all(row)

    def _store_all(self, row: Iterable[tuple[int, PoseTuple]]) -> None:
        for stamp_ns, pose in row:
            self._store(stamp_ns, pose)

    def _drop_strays(self) -> None:
        if self._jump:
            self.refused[Refusal.STRAY_STAMP] += len(self._jump)
            self._jump.clear()

    def _consider_jump(self, stamp_ns: int, pose: PoseTuple) -> None:
        """Hold a pose whose stamp is far off until the next ones show whether the clock jumped."""
        if self._jump and stamp_ns <= self._jump[-1][0]:
            self._drop_strays()
        self._jump.append((stamp_ns, pose))
        if not self._is_confirmed(self._jump):
            return
        if self._jump[0][0] < self._last_ns:
            self.clock_jumps += 1
            self._begin_anew(self._jump, self.frames)
        else:
            self._store_all(self._jump)
        self._jump.clear()

    def _is_confirmed(self, row: list[tuple[int, PoseTuple]]) -> bool:
        """Return whether poses in a row that contradict what is held are to be believed."""
        # And go on for a second: at 200 Hz three poses are over in 10 ms, which a receiver that
        # starts anew fills with wrong stamps. Of a clock that hardly moves no more are held back
        # than a buffer keeps.
        return len(row) >= self._limits.max_poses or (
            len(row) >= CONFIRMATIONS and row[-1][0] - row[0][0] >= 1_000_000_000)

    def _store(self, stamp_ns: int, pose: PoseTuple) -> None:
        if self._stands(stamp_ns, pose):
            self._end -= 1
            self.still += 1
        self._last_ns = stamp_ns
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end] = stamp_ns
        self._poses[self._end] = pose
        self._end += 1
        oldest = stamp_ns - self._max_age_ns
        while (self._end - self._start > self._limits.max_poses
               or self._stamps[self._start] < oldest):
            self._start += 1

    def _stands(self, stamp_ns: int, pose: PoseTuple) -> bool:
        """Return whether the pose takes the place of the newest one: a standstill goes on.

        When motion resumes, the pose just before it is there to interpolate from.
        """
        anchor_ns, anchor = self._anchor
        if not anchor or self._moved(anchor, pose):
            self._anchor = stamp_ns, pose
            return False
        return stamp_ns - anchor_ns > self._still_after_ns and self._last_ns > anchor_ns

    def _moved(self, before: PoseTuple, after: PoseTuple) -> bool:
        x, y, z = after[0] - before[0], after[1] - before[1], after[2] - before[2]
        if x * x + y * y + z * z >= self._still_distance_squared:
            return True
        cosine = abs(before[3] * after[3] + before[4] * after[4] + before[5] * after[5]
                     + before[6] * after[6])
        return cosine < self._still_cosine

    def _make_room(self) -> None:
        """Move the poses held to the front of arrays of twice their number, within the bound.

        With room for twice ``max_poses`` the move happens once in ``max_poses`` poses.
        """
        count = len(self)
        size = min(max(2 * count, 1024), 2 * self._limits.max_poses)
        stamps, poses = np.empty(size, np.int64), np.empty((size, 7))
        stamps[:count], poses[:count] = (
            array[self._start:self._end] for array in (self._stamps, self._poses))
        self._stamps, self._poses, self._start, self._end = stamps, poses, 0, count


def fault_of(pose: PoseTuple) -> Refusal | None:
    """Return why a pose is of no use, None where it is."""
    x, y, z, qx, qy, qz, qw = pose
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    # Written so that NaN fails.
    unit = abs(norm - 1.0) <= ROTATION_TOLERANCE
    if (unit and abs(x) <= MAX_POSITION and abs(y) <= MAX_POSITION
            and abs(z) <= MAX_POSITION):
        return None
    if not all(map(math.isfinite, pose)):
        return Refusal.NOT_FINITE
    return Refusal.TOO_FAR if unit else Refusal.NOT_UNIT
