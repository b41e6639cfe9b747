# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms from one frame to its child, over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.data.trajectory import MAX_POSITION, pose_faults
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# An edge is silent where it pauses for longer than this, and than ten of its usual steps.
_GAP_NS = 1_000_000_000
_GAP_FACTOR = 10

# Where the time of an edge runs backwards by more, it began anew; by less, messages changed
# places.
_RESTART_NS = 1_000_000_000

# Of transforms that arrive one by one, so much is kept: ten steps of an edge that changes every
# six seconds, and no more of one whose stamps hardly advance.
_KEPT_NS = 60_000_000_000
_MOST_KEPT = 60_000
_BLOCK = 1000
# So many before the last pose stay as well: they tell the usual step.
_SPARE = 10


# What ``pose_faults`` tells apart, in words.
FAULTS = ('not finite', 'quaternion not of unit length',
          f'more than {MAX_POSITION:.0e} m away along an axis')


@dataclass(eq=False)
class Edge:
    """The transforms from one frame to its child.

    Attributes
    ----------
    parent, child : names of the frames.
    static : whether the transform holds at all times.
    samples : (N,) stamps and (N, 7) transforms in the order in which they came.
    changes : how many of them differed from the one before.
    refused : (3,), how many transforms were none, as ``pose_faults`` tells them apart.
    waiting : those that arrived one by one, until they become samples.

    """

    parent: str
    child: str
    static: bool = False
    samples: tuple[NDArray[np.int64], FloatArray] = field(
        default_factory=lambda: (np.zeros(0, np.int64), np.zeros((0, 7))))
    changes: int = 0
    refused: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    waiting: list[tuple[int, Sequence[float]]] = field(default_factory=list)
    _told: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    _newest_ns: int = -2**63

    def __str__(self) -> str:
        return f'{self.parent} -> {self.child}'

    def goes_back(self, stamp_ns: int) -> bool:
        """Return whether time begins anew with a transform of this stamp."""
        return not self.static and stamp_ns < self._newest_ns - _RESTART_NS

    def add(self, stamp_ns: int, pose: Sequence[float]) -> None:
        """Take one transform as it arrives: x, y, z (m), qx, qy, qz, qw; old ones go."""
        self.waiting.append((stamp_ns, pose))
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if len(self.waiting) >= _BLOCK:
            self.settle()

    def extend(self, stamps_ns: ArrayLike, poses: ArrayLike) -> None:
        """Take (N,) stamps and (N, 7) transforms in the order in which they came; all stay."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        new = np.asarray(poses, dtype=np.float64).reshape(len(stamps), 7)
        faults = np.array(pose_faults(new))
        self.refused = self.refused + np.count_nonzero(faults, axis=1)
        usable = ~faults.any(axis=0)
        before, last = self.samples
        steps = np.diff(np.concatenate([last[-1:], new[usable]]), axis=0)
        self.changes += int(np.count_nonzero(steps.any(axis=1)))
        self.samples = (np.concatenate([before, stamps[usable]]),
                        np.concatenate([last, new[usable]]))

    def settle(self) -> None:
        """Put what waits with the rest, of which what nobody will ask for goes."""
        if self.waiting:
            stamps, poses = zip(*self.waiting, strict=True)
            self.waiting = []
            self.extend(stamps, poses)
            self.forget_before(self._newest_ns - _KEPT_NS)
            self._keep_from(-1 if self.static else -_MOST_KEPT)

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what no later pose needs, but for some that tell the usual step."""
        if not self.static:
            self._keep_from(max(int(np.searchsorted(self.samples[0], stamp_ns)) - _SPARE, 0))

    def _keep_from(self, first: int) -> None:
        stamps_ns, poses = self.samples
        self.samples = stamps_ns[first:], poses[first:]

    def new_refusals(self) -> NDArray[np.int64]:
        """Return (3,), how many transforms were refused since the last call."""
        new, self._told = self.refused - self._told, self.refused
        return new

    def ordered(self, notes: list[str]) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the samples in the order of their stamps, one a stamp, of one run of time."""
        stamps_ns, poses = self.samples
        if np.all(stamps_ns[1:] > stamps_ns[:-1]):
            return stamps_ns, poses
        restarts = np.flatnonzero(np.diff(stamps_ns) < -_RESTART_NS) + 1
        parts = np.split(np.arange(len(stamps_ns)), restarts)
        longest = max(parts, key=len)
        if len(parts) > 1:
            notes.append(
                f'the time of {self} ran backwards {counted(len(parts) - 1, "time")} (bag or '
                'simulation restarted, or bags that overlap?): kept '
                f'{len(longest)} of {counted(len(stamps_ns), "transform")}')
        stamps_ns, first = np.unique(stamps_ns[longest], return_index=True)
        return stamps_ns, poses[longest][first]


def fault_words(refused: Iterable[int]) -> str:
    """Return (3,) counts of what was refused in words, '' for none."""
    return ', '.join(f'{count} {why}' for count, why in zip(refused, FAULTS, strict=True) if count)


def longest_step_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Return the time between two of (N,) stamps, nanoseconds, beyond which they are a gap."""
    usual = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return max(_GAP_NS, _GAP_FACTOR * usual)


def interpolated(
    stamps_ns: NDArray[np.int64], poses: FloatArray, at_ns: NDArray[np.int64],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (M, 4, 4) poses at (M,) times of (N, 7) poses at (N,) stamps, and which of them hold.

    On the straight line in position and the great arc in orientation, as tf2 has it. A pose holds
    on a stamp, and between two that are no gap apart.
    """
    right = np.minimum(np.searchsorted(stamps_ns, at_ns), len(stamps_ns) - 1)
    left = np.maximum(np.searchsorted(stamps_ns, at_ns, side='right') - 1, 0)
    step = stamps_ns[right] - stamps_ns[left]
    inside = (at_ns >= stamps_ns[0]) & (at_ns <= stamps_ns[-1])
    holds: NDArray[np.bool_] = inside & (step <= longest_step_ns(stamps_ns))
    share = (np.where(inside, at_ns - stamps_ns[left], 0) / np.maximum(step, 1))[:, None]
    start, end = matrices(poses[left]), matrices(poses[right])
    R = start[:, :3, :3]
    turn = se3.log_so3(np.swapaxes(R, 1, 2) @ end[:, :3, :3])
    return se3.from_rotation_translation(
        R @ se3.exp_so3(share * turn),
        (1.0 - share) * start[:, :3, 3] + share * end[:, :3, 3]), holds


def matrices(poses: FloatArray) -> FloatArray:
    """Return the (N, 4, 4) matrices of (N, 7) poses."""
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return se3.from_rotation_translation(se3.quaternion_to_rotation(q), poses[:, :3])
