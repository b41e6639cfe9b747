# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Relative motions: the reference selections of the paper.

T. Valimaki, B. Garigipati, R. Ghabcheloo, "Motion-Based Extrinsic Sensor-to-Sensor Calibration:
Effect of Reference Frame Selection for New and Existing Methods", Sensors 23(7):3740, 2023,
doi:10.3390/s23073740, section III-D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import re

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import ConfigError, counted, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Step between poses, seconds, for which the lags of the checks are chosen.
_USUAL_STEP = 0.1

AUTOMATIC = 'auto'
REFERENCE_HELP = ('A (the first pose), B<n> (n poses earlier), C<n> (first pose of each n), '
                  'auto (the one with the smallest expected error)')


@dataclass(frozen=True, eq=False)
class MotionPairs:
    """Relative motions of both sensors between the same instants: ``A X = X B``.

    Attributes
    ----------
    reference : the selection that made them, 'A', 'B5', 'C10', ...
    i, j : (M,) indices into ``pairs``: the reference pose and the current pose.
    A, B : (M, 4, 4), pose j in the frame of pose i, for sensor a and sensor b.
    pairs : the pose pairs.

    """

    reference: str
    i: NDArray[np.intp]
    j: NDArray[np.intp]
    A: FloatArray
    B: FloatArray
    pairs: PosePairs

    def __len__(self) -> int:
        return len(self.i)

    def picked(self, keep: slice | NDArray[np.bool_] | NDArray[np.intp]) -> MotionPairs:
        """Return some of the motions: those of a slice, a (M,) mask, or (k,) indices."""
        return replace(self, i=self.i[keep], j=self.j[keep], A=self.A[keep], B=self.B[keep])

    def thinned(self, at_most: int) -> MotionPairs:
        """Return every n-th motion, at most so many."""
        return self.picked(slice(None, None, _every(len(self), at_most)))

    def scaled(self, scale: float) -> MotionPairs:
        """Return the motions with the translations of b multiplied by ``scale``."""
        if scale == 1.0:
            return self
        return replace(self, B=se3.scaled(self.B, scale), pairs=self.pairs.scaled(scale))


def _every(count: int, at_most: int) -> int:
    return max(1, -(-count // at_most))


def parse_reference(reference: str) -> tuple[str, int]:
    """Return the letter and the number of a reference: ('B', 5) of 'B5', ('A', 0) of 'A'.

    Raises ConfigError for anything else than 'A', 'B<n>' with n >= 1, or 'C<n>' with n >= 2.
    """
    match = re.fullmatch(r'(A)|([BC])([1-9]\d{0,99})', reference.strip().upper())
    if match is None:
        raise ConfigError(f'reference {reference!r} is unknown; needed {REFERENCE_HELP}')
    if match[2] == 'C' and int(match[3]) == 1:
        raise ConfigError('reference C1 compares every pose with itself; use C2 or more')
    return (match[1], 0) if match[1] else (match[2], int(match[3]))


def normal_reference(reference: str) -> str:
    """Return the one way of writing a reference: 'B7' of ' b7', 'auto' of 'AUTO'.

    Raises as ``parse_reference``, but for 'auto'.
    """
    if reference.strip().lower() == AUTOMATIC:
        return AUTOMATIC
    letter, n = parse_reference(reference)
    return f'{letter}{n}' if n else letter


def reference_indices(reference: str, poses: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the (M,) indices i of the reference and j of the current pose of each motion.

    * 'A': i = 0 for every j.
    * 'B<n>': i = j - n.
    * 'C<n>': the poses are split into segments of n; i is the first pose of the segment of j. The
      last segment is dropped even if it is complete: only this reproduces the published figures.

    Raises ConfigError as ``parse_reference``, MotionError for fewer than two motions.
    """
    letter, n = parse_reference(reference)
    # A huge n, beyond the range of an index, gives as few motions as n = poses.
    n = min(n, poses)
    if letter == 'A':
        j = np.arange(1, poses)
        i = np.zeros_like(j)
    elif letter == 'B':
        j = np.arange(n, poses)
        i = j - n
    else:
        j = np.arange(len(range(0, poses - n, n)) * n)
        j = j[j % n != 0]
        i = j - j % n
    if len(j) < 2:
        raise MotionError(
            f'reference {reference} leaves {counted(len(j), "motion")} of '
            f'{counted(poses, "pose")}, needed at least 2; use a smaller n or record longer')
    return i, j


def lag_grid(
    stamps_ns: NDArray[np.int64], seconds: Sequence[float], largest_share: float = 0.5,
) -> tuple[int, ...]:
    """Return the lags, in poses, that span the given times; ascending and distinct, at least one.

    Times, not numbers of poses, so that recordings at 10 and 200 Hz are treated alike. For a
    recording below 10 Hz the times are stretched accordingly, so that it has as many lags.
    ``stamps_ns`` are (N,), ascending; no lag is longer than a share of the N poses.
    """
    step = float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else _USUAL_STEP
    lags = {max(1, round(time / min(max(step, 1e-9), _USUAL_STEP))) for time in seconds}
    longest = largest_share * len(stamps_ns)
    return tuple(sorted(lag for lag in lags if lag <= longest)) or (1,)


def select_motions(pairs: PosePairs, reference: str, at_most: int | None = None) -> MotionPairs:
    """Form the relative motions of both sensors for a reference selection.

    Every n-th of them, ``at_most`` so many, where that is given; raises as ``reference_indices``.
    """
    i, j = reference_indices(reference, len(pairs))
    every = 1 if at_most is None else _every(len(i), at_most)
    i, j = i[::every], j[::every]
    A, B = (se3.inverse(poses[i]) @ poses[j] for poses in (pairs.poses_a, pairs.poses_b))
    return MotionPairs(normal_reference(reference), i, j, A, B, pairs)
