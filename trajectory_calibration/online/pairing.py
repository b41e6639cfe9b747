# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How many poses of one sensor have a place among the other's: counted, not paired.

Each second, so that pairing all of them again would cost too much.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.time_alignment.pairing import COINCIDENCE_NS


class Pairing(NamedTuple):
    """Poses of b that a can be interpolated at, in gaps of a, and before or after all of a."""

    pairs: int
    in_gaps: int
    outside: int


def count_pairs(
    a: PoseBuffer, b: PoseBuffer, time_offset_ns: int, max_gap_ns: int, *, at_a: bool = False,
) -> Pairing:
    """Count as ``associate_by_interpolation`` does, from the few long gaps of a alone.

    ``at_a`` counts the poses of a among those of b.
    """
    if at_a:
        return count_pairs(b, a, -time_offset_ns, max_gap_ns)
    stamps_a, stamps_b = a.stamps_ns, b.stamps_ns
    if len(stamps_a) < 2:
        return Pairing(0, 0, len(stamps_b))
    # In the clock of b: adding the offset to its stamps would copy all of them.
    first, last = stamps_a[[0, -1]] - time_offset_ns
    inside = int(np.searchsorted(stamps_b, last, side='right') - np.searchsorted(stamps_b, first))
    left = np.flatnonzero(np.diff(stamps_a) > max_gap_ns)
    starts = stamps_a[left] - time_offset_ns + COINCIDENCE_NS
    ends = stamps_a[left + 1] - time_offset_ns - COINCIDENCE_NS
    in_gap = np.searchsorted(stamps_b, ends) - np.searchsorted(stamps_b, starts, side='right')
    in_gaps = int(np.maximum(in_gap, 0).sum())
    return Pairing(inside - in_gaps, in_gaps, len(stamps_b) - inside)
