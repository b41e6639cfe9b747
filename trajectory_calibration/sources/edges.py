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

# A gap of an edge is longer than this, and than ten median steps.
_GAP_NS = 1_000_000_000
_GAP_FACTOR = 10

# If the stamps of an edge go back by more, its time was reset; by less, messages were reordered.
_RESTART_NS = 1_000_000_000

# Limits on live transforms: the time span is ten steps of an edge that changes every six seconds;
# the number bounds an edge whose stamps hardly advance.
_KEPT_NS = 60_000_000_000
_MOST_KEPT = 60_000
_BLOCK = 1000
# Kept before the last pose as well, for the median step.
_KEPT_BEFORE = 10


# The three rows of ``pose_faults`` in words.
FAULTS = ('not finite', 'quaternion not of unit length',
          f'more than {MAX_POSITION:.0e} m away along an axis')


@dataclass(eq=False)
class Edge:
    """The transforms from one frame to its child.

    Attributes
    ----------
    parent, child : names of the frames.
    static : whether the transform is valid at all times.
    samples : (N,) stamps (ns) and (N, 7) transforms (m, quaternion xyzw) in order of arrival.
    changes : number of samples that differ from the one before.
    refused : (3,), number of invalid transforms by the kinds of ``pose_faults``.
    pending : live transforms that are not yet in ``samples``.

    """

    parent: str
    child: str
    static: bool = False
    samples: tuple[NDArray[np.int64], FloatArray] = field(
        default_factory=lambda: (np.zeros(0, np.int64), np.zeros((0, 7))))
    changes: int = 0
    refused: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    pending: list[tuple[int, Sequence[float]]] = field(default_factory=list)
    _reported: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    _newest_ns: int = -2**63

    def __str__(self) -> str:
        return f'{self.parent} -> {self.child}'

    def is_reset(self, stamp_ns: int) -> bool:
        """Return whether a transform with this stamp means that time was reset."""
        return not self.static and stamp_ns < self._newest_ns - _RESTART_NS

    def add(self, stamp_ns: int, pose: Sequence[float]) -> None:
        """Add one live transform: x, y, z (m), qx, qy, qz, qw; old ones are dropped."""
        self.pending.append((stamp_ns, pose))
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if len(self.pending) >= _BLOCK:
            self.flush()

    def extend(self, stamps_ns: ArrayLike, poses: ArrayLike) -> None:
        """Add (N,) stamps and (N, 7) transforms in order of arrival; all are kept."""
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

    def flush(self) -> None:
        """Move live transforms to the samples, and drop samples beyond the limits."""
        if self.pending:
            stamps, poses = zip(*self.pending, strict=True)
            self.pending = []
            self.extend(stamps, poses)
            self.forget_before(self._newest_ns - _KEPT_NS)
            self._keep_from(-1 if self.static else -_MOST_KEPT)

    def forget_before(self, stamp_ns: int) -> None:
        """Drop samples before a stamp, except the last ones, which give the median step."""
        if not self.static:
            self._keep_from(max(int(np.searchsorted(self.samples[0], stamp_ns)) - _KEPT_BEFORE, 0))

    def _keep_from(self, first: int) -> None:
        stamps_ns, poses = self.samples
        self.samples = stamps_ns[first:], poses[first:]

    def new_refusals(self) -> NDArray[np.int64]:
        """Return (3,), the number of transforms refused since the last call."""
        new, self._reported = self.refused - self._reported, self.refused
        return new

    def ordered(self, notes: list[str]) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the samples of the longest run without a time reset, by ascending stamps.

        Of equal stamps the first is kept. Dropped runs are added to ``notes``.
        """
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
    """Return (3,) counts of refused transforms in words, '' for none."""
    return ', '.join(f'{count} {why}' for count, why in zip(refused, FAULTS, strict=True) if count)


def longest_silence_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Return the longest step, nanoseconds, of (N,) stamps that is not a gap."""
    median_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return max(_GAP_NS, _GAP_FACTOR * median_ns)


def interpolated(
    stamps_ns: NDArray[np.int64], poses: FloatArray, at_ns: NDArray[np.int64],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Interpolate (N, 7) poses at (N,) stamps; return (M, 4, 4) poses at (M,) times, and validity.

    Linear in position, slerp in orientation, as in tf2. A pose is valid at a stamp, and between
    two stamps without a gap.
    """
    after = np.minimum(np.searchsorted(stamps_ns, at_ns), len(stamps_ns) - 1)
    before = np.maximum(np.searchsorted(stamps_ns, at_ns, side='right') - 1, 0)
    step = stamps_ns[after] - stamps_ns[before]
    inside = (at_ns >= stamps_ns[0]) & (at_ns <= stamps_ns[-1])
    valid: NDArray[np.bool_] = inside & (step <= longest_silence_ns(stamps_ns))
    fraction = (np.where(inside, at_ns - stamps_ns[before], 0) / np.maximum(step, 1))[:, None]
    start, end = matrices(poses[before]), matrices(poses[after])
    R = start[:, :3, :3]
    rotation_vector = se3.log_so3(np.swapaxes(R, 1, 2) @ end[:, :3, :3])
    return se3.from_rotation_translation(
        R @ se3.exp_so3(fraction * rotation_vector),
        (1.0 - fraction) * start[:, :3, 3] + fraction * end[:, :3, 3]), valid


def matrices(poses: FloatArray) -> FloatArray:
    """Return the (N, 4, 4) matrices of (N, 7) poses."""
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return se3.from_rotation_translation(se3.quaternion_to_rotation(q), poses[:, :3])
