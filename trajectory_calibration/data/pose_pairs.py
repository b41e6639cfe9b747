# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of two sensors at common times, and a summary of the association."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

METHODS = ('auto', 'interpolate', 'nearest')

# Two relative motions need three poses.
MIN_PAIRS = 3


@dataclass(frozen=True)
class AssociationSummary:
    """Summary of the association: counts, and time differences of the poses.

    Attributes
    ----------
    method : 'nearest' or 'interpolate'.
    time_offset_s : seconds that were added to the stamps of b.
    poses_a, poses_b : number of poses of each trajectory.
    pairs : number of pairs.
    outside : poses of b before the first or after the last pose of a.
    in_gaps : poses of b inside the span of a, but in a gap of a.
    between : poses of b that were not used because most others coincide with poses of a.
    median_difference_s, max_difference_s : time between a pose of b and the nearest pose of a
        over the pairs.
    stamps_of : 'b'; 'a' where b was interpolated at the stamps of a, and all of these count poses
        of a among those of b.

    """

    method: str
    time_offset_s: float
    poses_a: int
    poses_b: int
    pairs: int
    outside: int
    in_gaps: int
    between: int
    median_difference_s: float
    max_difference_s: float
    stamps_of: str = 'b'


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Poses of a and b at common times.

    Attributes
    ----------
    stamps_ns : (K,) int64, in the clock of a, strictly increasing.
    poses_a : (K, 4, 4), pose of sensor a in the world of a.
    poses_b : (K, 4, 4), pose of sensor b in the world of b.
    summary : of the association.

    """

    stamps_ns: NDArray[np.int64]
    poses_a: FloatArray
    poses_b: FloatArray
    summary: AssociationSummary

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def scaled(self, scale: float) -> PosePairs:
        """Return the pairs with the positions of b multiplied by ``scale``."""
        return self if scale == 1.0 else replace(self, poses_b=se3.scaled(self.poses_b, scale))

    def thinned(self, every: int) -> PosePairs:
        """Return every ``every``-th pair, from the first."""
        return self.picked(slice(None, None, every))

    def picked(self, part: slice | NDArray[np.bool_]) -> PosePairs:
        """Return some of the pairs."""
        return PosePairs(
            self.stamps_ns[part], self.poses_a[part], self.poses_b[part], self.summary)
