# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The counts of the diagnostics are those of the association. Needs no ROS."""

import numpy as np
import pytest

from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.online.motion import count_pairs, Pairing
from trajectory_calibration.time_alignment.pairing import associate, associate_by_interpolation

SECOND = 1_000_000_000


def holding(stamps_ns):
    buffer = PoseBuffer(BufferLimits(still_distance=0.0))
    poses = np.column_stack([0.1 * np.arange(len(stamps_ns)), np.zeros((len(stamps_ns), 5)),
                             np.ones(len(stamps_ns))])
    buffer.replace(np.asarray(stamps_ns, np.int64), poses, ('map', ''))
    return buffer


@pytest.mark.parametrize('seed', range(20))
def test_the_counts_are_those_of_the_association(seed):
    rng = np.random.default_rng(seed)
    stamps_a = 1000 * SECOND + np.unique(rng.integers(0, 60 * 100, 120)) * (SECOND // 100)
    # Many coincide with a, to the microsecond, or lie at its ends.
    stamps_b = np.unique(np.concatenate([
        stamps_a[rng.integers(0, len(stamps_a), 40)] + rng.integers(-2, 3, 40) * 1_000_000,
        stamps_a[[0, -1]], 995 * SECOND + rng.integers(0, 70 * SECOND, 200)]))
    offset_ns, max_gap_ns = int(rng.integers(-3, 4)) * SECOND, int(rng.choice([0, 10**8, 10**9]))
    a, b = holding(stamps_a), holding(stamps_b - offset_ns)
    expected = associate_by_interpolation(
        a.snapshot('a').trajectory(), b.snapshot('b').trajectory(), max_gap_ns=max_gap_ns,
        time_offset_ns=offset_ns).summary
    assert count_pairs(a, b, offset_ns, max_gap_ns) == Pairing(
        expected.pairs, expected.in_gaps, expected.outside)


def test_auto_counts_the_sparser():
    a, b = holding(np.arange(1, 30) * SECOND), holding(SECOND // 10 * np.arange(5, 205))
    summary = associate(a.snapshot('a').trajectory(), b.snapshot('b').trajectory()).summary
    assert (summary.stamps_of, summary.outside) == ('a', 9)
    assert count_pairs(a, b, 0, SECOND // 2, at_a=True) == Pairing(
        summary.pairs, summary.in_gaps, summary.outside)
    assert count_pairs(a, b, 0, SECOND // 2).pairs == 20


@pytest.mark.parametrize('poses_a, poses_b', [(0, 0), (0, 5), (1, 5), (5, 0)])
def test_nothing_pairs_with_nothing(poses_a, poses_b):
    a, b = (holding(np.arange(1, count + 1) * SECOND) for count in (poses_a, poses_b))
    assert count_pairs(a, b, 0, SECOND) == Pairing(0, 0, poses_b)
