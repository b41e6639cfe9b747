# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bounded buffer of the checked live poses of one sensor.

Nothing here imports ROS, so a replay of a bag uses the same code as the node.
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

# Up to this far behind the newest stamp, a pose is out of order. Further behind, or this far
# ahead, the stamp is wrong or the clock jumped; the following poses decide which.
JUMP_NS = 5_000_000_000
# Number of consecutive poses that confirm a clock jump or a change of frames.
CONFIRMATIONS = 3

# World frame and sensor frame, '' if a message has none.
Frames = tuple[str, str]

_NO_FRAMES = ('', '')

# Position x, y, z (metres) and quaternion x, y, z, w.
PoseTuple = tuple[float, ...]


class Refusal(str, Enum):
    """Why a pose was refused, in the words of the diagnostics."""

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


# These count messages, not poses.
OF_MESSAGES = (Refusal.UNREADABLE, Refusal.EMPTY_PATH)
# In the order of ``pose_faults``.
_FAULTS = (Refusal.NOT_FINITE, Refusal.NOT_UNIT, Refusal.TOO_FAR)


@dataclass(frozen=True)
class BufferLimits:
    """Limits of a buffer; the options of these names have the explanations."""

    max_poses: int = 100_000
    max_age_s: float = 28_800.0
    still_after_s: float = 2.0
    still_distance: float = 0.02
    still_angle_deg: float = 0.2


class PoseBuffer:
    """The newest poses of one sensor, ordered by stamp, in arrays of bounded size.

    A bad pose is refused and counted, never an error. ``forgotten`` counts the poses dropped
    because the clock went back or the frames changed; ``generation`` increases whenever poses are
    dropped for a reason other than age or number.
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
        """Drop all poses, frames and counts."""
        self._received_before = self.received
        # Poses dropped at standstill.
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
        """Messages since the last ``clear``."""
        return self.received - self._received_before

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        return self._stamps.nbytes + self._poses.nbytes

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps of the oldest and the newest pose, None if the buffer is empty."""
        if not len(self):
            return None
        return int(self._stamps[self._start]), int(self._stamps[self._end - 1])

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return a view of all stamps."""
        return self._stamps[self._start:self._end]

    def append(self, stamp_ns: int, frames: Frames, pose: PoseTuple) -> None:
        """Add a live pose, or count the reason for refusing it."""
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
        self._other_poses.clear()
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
        """Count a message that could not be parsed."""
        self.received += 1
        self.refused[Refusal.UNREADABLE] += 1

    def count_refused(self, counts: Iterable[int]) -> None:
        """Add (3,) counts of poses refused earlier, by the kinds of ``pose_faults``."""
        for why, count in zip(_FAULTS, map(int, counts), strict=True):
            self.received += count
            self.refused[why] += count

    def replace(
        self, stamps_ns: NDArray[np.int64], poses: FloatArray, frames: Frames,
    ) -> None:
        """Replace all poses by the (N,) stamps and (N, 7) poses of a whole trajectory.

        For a SLAM that publishes its optimised path repeatedly. Counts of refused and dropped
        poses restart, those of messages continue. A trajectory without a usable pose is counted
        and replaces nothing.
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
        """Return how many of the last sorted stamps are wrong, fewer than CONFIRMATIONS.

        Without the wrong ones, the last CONFIRMATIONS poses are within the maximum age.
        """
        for strays in range(CONFIRMATIONS):
            ends = sorted_ns[:len(sorted_ns) - strays][-CONFIRMATIONS:]
            if len(ends) == CONFIRMATIONS and ends[-1] - ends[0] <= self._max_age_ns:
                return strays
        return 0

    def snapshot(self, name: str, sensor_frame: str = '') -> Snapshot:
        """Return a copy; the sensor is ``sensor_frame``, else from the messages, else ``name``."""
        world, sensor = self.frames
        frame = sensor_frame or sensor or name
        held = slice(self._start, self._end)
        slashes = ('the leading slash of its frame ids was removed (tf2 refuses it)'
                   if self._slashed else '')
        return Snapshot(
            self._stamps[held].copy(), self._poses[held].copy(), world or 'map', frame,
            tuple(f'{frame}: {note}' for note in (self.refusals(), slashes) if note))

    def refusals(self) -> str:
        """Return the counts of refused poses and messages in words, '' for none."""
        sentences = []
        for unit, reasons in (('pose', [why for why in Refusal if why not in OF_MESSAGES]),
                              ('message', OF_MESSAGES)):
            counts = {why.value: self.refused[why] for why in reasons if self.refused[why]}
            if counts:
                words = ', '.join(f'{count} {why}' for why, count in counts.items())
                sentences.append(f'{counted(sum(counts.values()), unit)} refused ({words})')
        return ', '.join(sentences)

    def _without_slashes(self, frames: Frames) -> Frames:
        """Return frame ids without a leading slash, which tf2 refuses."""
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
        # Stamp and pose of the last motion.
        self._anchor: tuple[int, PoseTuple] = 0, ()
        self._jump: list[tuple[int, PoseTuple]] = []
        # Consecutive poses in other frames than the buffered ones, and these frames.
        self._other_poses: list[tuple[int, PoseTuple]] = []
        self._other_frames = _NO_FRAMES

    def _change_frames(self, frames: Frames) -> None:
        if len(self) and frames != self.frames:
            self.frame_changes += 1
            self.frames_before = self.frames
        self._forget_poses(frames)

    def _consider_frames(self, stamp_ns: int, frames: Frames, pose: PoseTuple) -> None:
        """Refuse a pose in other frames, until enough consecutive poses confirm the change."""
        self.refused[Refusal.OTHER_FRAME] += 1
        if frames != self._other_frames:
            self._other_poses.clear()
            self._other_frames = frames
        step = stamp_ns - self._other_poses[-1][0] if self._other_poses else 1
        if -JUMP_NS <= step <= 0:
            return
        # With such a large step, one of the two stamps is wrong: restart from the later one.
        if abs(step) > JUMP_NS:
            self._other_poses.clear()
        self._other_poses.append((stamp_ns, pose))
        if self._is_confirmed(self._other_poses):
            self.refused[Refusal.OTHER_FRAME] -= len(self._other_poses)
            self._restart(self._other_poses, frames)

    def _restart(self, row: list[tuple[int, PoseTuple]], frames: Frames) -> None:
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
        """Store a pose with a distant stamp until the next ones show whether the clock jumped."""
        if self._jump and stamp_ns <= self._jump[-1][0]:
            self._drop_strays()
        self._jump.append((stamp_ns, pose))
        if not self._is_confirmed(self._jump):
            return
        if self._jump[0][0] < self._last_ns:
            self.clock_jumps += 1
            self._restart(self._jump, self.frames)
        else:
            self._store_all(self._jump)
        self._jump.clear()

    def _is_confirmed(self, row: list[tuple[int, PoseTuple]]) -> bool:
        """Return whether the consecutive poses are enough to confirm a jump or other frames."""
        # They must span a second: at 200 Hz three poses take 10 ms, in which a restarting receiver
        # may send wrong stamps. ``max_poses`` is the bound if the clock hardly advances.
        return len(row) >= self._limits.max_poses or (
            len(row) >= CONFIRMATIONS and row[-1][0] - row[0][0] >= 1_000_000_000)

    def _store(self, stamp_ns: int, pose: PoseTuple) -> None:
        if self._continues_standstill(stamp_ns, pose):
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

    def _continues_standstill(self, stamp_ns: int, pose: PoseTuple) -> bool:
        """Return whether the pose replaces the newest one because the standstill continues.

        So the pose just before the next motion is kept, for interpolation.
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
        """Copy the poses to the front of arrays of twice their number, at most 2 ``max_poses``.

        So at the limit a copy occurs only once per ``max_poses`` poses.
        """
        count = len(self)
        size = min(max(2 * count, 1024), 2 * self._limits.max_poses)
        stamps, poses = np.empty(size, np.int64), np.empty((size, 7))
        stamps[:count], poses[:count] = (
            array[self._start:self._end] for array in (self._stamps, self._poses))
        self._stamps, self._poses, self._start, self._end = stamps, poses, 0, count


def fault_of(pose: PoseTuple) -> Refusal | None:
    """Return why a pose is unusable, None if it is usable."""
    x, y, z, qx, qy, qz, qw = pose
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    # NaN fails this comparison.
    unit = abs(norm - 1.0) <= ROTATION_TOLERANCE
    if (unit and abs(x) <= MAX_POSITION and abs(y) <= MAX_POSITION
            and abs(z) <= MAX_POSITION):
        return None
    if not all(map(math.isfinite, pose)):
        return Refusal.NOT_FINITE
    return Refusal.TOO_FAR if unit else Refusal.NOT_UNIT
