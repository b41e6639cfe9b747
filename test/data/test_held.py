# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows that repeat an old measurement are told from a vehicle that stands still."""

from dataclasses import replace

import numpy as np
import pytest

from trajectory_calibration import calibrate, Trajectory
from trajectory_calibration.data.held import without_held
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate

RUN = simulate(replace(SCENARIOS['offroad'], duration=60.0), 3)


def repeated(trajectory, rows, *, positions=True, orientations=False):
    """Return the trajectory with parts of each row k taken from row rows[k]."""
    poses = trajectory.poses.copy()
    if positions:
        poses[:, :3, 3] = poses[rows, :3, 3]
    if orientations:
        poses[:, :3, :3] = poses[rows, :3, :3]
    return replace(trajectory, poses=poses)


def frozen(count):
    """Return which row each one repeats where all of the middle third repeat its first."""
    rows = np.arange(count)
    rows[count // 3:2 * count // 3] = count // 3
    return rows


@pytest.mark.parametrize('parts', [
    {'positions': True}, {'positions': True, 'orientations': True},
    {'positions': False, 'orientations': True}])
@pytest.mark.parametrize('every', [2, 20])
def test_a_slow_sensor_that_is_written_fast(parts, every):
    kept, (finding,) = without_held(repeated(
        RUN.b, np.arange(len(RUN.b)) // every * every, **parts))
    assert np.array_equal(kept.stamps_ns, RUN.b.stamps_ns[::every])
    assert finding.values['poses'] == len(RUN.b) - len(kept)
    assert ('positions' in finding.text) == parts['positions']


def test_a_pause_that_ends_with_a_jump():
    rows = frozen(len(RUN.b))
    kept, _ = without_held(repeated(RUN.b, rows))
    assert np.array_equal(kept.stamps_ns, RUN.b.stamps_ns[rows == np.arange(len(RUN.b))])


def test_a_vehicle_that_stands_still_or_turns_on_the_spot_keeps_its_poses():
    count = len(RUN.b)
    going = np.concatenate([np.arange(count // 3), np.full(count // 3, count // 3),
                            np.arange(count // 3, count)])
    for positions, orientations in ((going, going), (going, np.arange(len(going))),
                                    (np.arange(len(going)), going)):
        poses = RUN.b.poses[np.minimum(positions, count - 1)].copy()
        poses[:, :3, :3] = RUN.b.rotations[np.minimum(orientations, count - 1)]
        stamps_ns = RUN.b.stamps_ns[0] + 50_000_000 * np.arange(len(going))
        trajectory = Trajectory(stamps_ns, poses[:len(stamps_ns)])
        # Up to the end, where there is nothing left to go on to.
        part = replace(trajectory, stamps_ns=stamps_ns[:count - 1], poses=poses[:count - 1])
        assert without_held(part) == (part, ())


def test_rounded_coordinates_are_no_repeated_ones():
    poses = RUN.b.poses.copy()
    poses[:, :3, 3] = np.round(poses[:, :3, 3])
    trajectory = replace(RUN.b, poses=poses)
    assert without_held(trajectory)[1] == ()


def test_positions_of_one_hertz_at_twenty_give_the_lever_arm():
    b = repeated(RUN.b, np.arange(len(RUN.b)) // 20 * 20)
    result = calibrate(RUN.a, b)
    assert [found.code for found in result.findings].count('poses-held') == 1
    off = result.T_a_b @ se3.inverse(RUN.T_a_b)
    error = np.concatenate([result.T_a_b[:3, 3] - RUN.T_a_b[:3, 3], se3.log_so3(off[:3, :3])])
    # As read, the lever arm along the drive is metres and 30 deviations off.
    assert (np.abs(error) < 4 * np.sqrt(np.diag(result.covariance))).all()
