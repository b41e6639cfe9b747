# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Validation at the border: what a trajectory accepts, repairs with a word, and refuses."""

from motion_data import stamps, wander
import numpy as np
import pytest

from trajectory_calibration import Trajectory, TrajectoryError
from trajectory_calibration.data.trajectory import MAX_POSITION, pose_faults
from trajectory_calibration.geometry import se3


@pytest.fixture
def poses():
    return wander(np.random.default_rng(0), poses=10)


def test_holds_what_it_was_given_and_no_more(poses):
    given = stamps(10)
    trajectory = Trajectory(given, poses, 'map', 'lidar')
    given[0] = 0
    assert trajectory.stamps_ns[0] == stamps(10)[0]
    assert trajectory.stamps_ns.dtype == np.int64
    np.testing.assert_allclose(trajectory.poses, poses, atol=1e-15)
    assert (trajectory.world_frame, trajectory.sensor_frame) == ('map', 'lidar')
    assert trajectory.warnings == ()
    assert len(trajectory) == 10
    assert trajectory.duration_s == pytest.approx(0.9)
    assert repr(trajectory) == '<Trajectory of lidar in map: 10 poses over 0.9 s>'
    with pytest.raises(ValueError, match='read-only'):
        trajectory.poses[0, 0, 0] = 2.0


def test_sorts_by_stamp_and_says_so(poses):
    order = np.array([0, 1, 2, 5, 3, 4, 6, 9, 7, 8])
    trajectory = Trajectory(stamps(10)[order], poses[order], sensor_frame='lidar')
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps(10))
    np.testing.assert_allclose(trajectory.poses, poses, atol=1e-15)
    assert trajectory.warnings == (
        'lidar: sorted the poses by stamp: time ran backwards in 2 places',)


def test_drops_duplicates_and_counts_them(poses):
    t = stamps(10)
    t[[3, 4]] = t[2]
    trajectory = Trajectory(t, poses, sensor_frame='lidar')
    assert len(trajectory) == 8
    np.testing.assert_allclose(trajectory.poses[2], poses[2], atol=1e-15)
    assert trajectory.warnings == (
        'lidar: dropped 2 poses with the stamp of another',)


def test_rounding_is_removed_without_a_word_and_more_with_one(poses):
    q = np.round(se3.rotation_to_quaternion(poses[:, :3, :3]), 6)
    rounded = Trajectory.from_quaternions(stamps(10), poses[:, :3, 3], q)
    assert rounded.warnings == ()
    R = rounded.rotations
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.tile(np.eye(3), (10, 1, 1)),
                               atol=1e-14)
    q[4] *= 1.004
    repaired = Trajectory.from_quaternions(stamps(10), poses[:, :3, 3], q, sensor_frame='imu')
    assert len(repaired.warnings) == 1
    assert repaired.warnings[0].startswith('imu: normalised 1 rotation (')
    np.testing.assert_allclose(repaired.poses, rounded.poses, atol=1e-5)


@pytest.mark.parametrize('spoil, message', [
    (lambda t, T: (t.astype(float), T), 'needed one-dimensional integer nanoseconds'),
    (lambda t, T: (t[:-1], T), r'needed \(9, 4, 4\) to match 9 stamps'),
    (lambda t, T: (t, T[:, :3]), r'shape \(10, 3, 4\)'),
    (lambda t, T: (t[:1], T[:1]), 'needed at least 2'),
    (lambda t, T: (t[:0], T[:0]), 'needed at least 2'),
    (lambda t, T: (t, T.astype(complex)), 'poses are complex, needed real numbers'),
    (lambda t, T: (t.astype(np.uint64) + np.uint64(2**63), T),
     'stamp 9 is 1[0-9]* ns, needed less than 2\\^63'),
    (lambda t, T: (np.full_like(t, 5), T), '1 pose with a stamp of its own, needed at least 2'),
])
def test_refuses_wrong_shapes(poses, spoil, message):
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(*spoil(stamps(10), poses))


@pytest.mark.parametrize('row, column, value, message', [
    (0, 3, np.nan, r'pose 6 is not finite \(1 of 10 are not\)'),
    (1, 1, np.inf, 'pose 6 is not finite'),
    (3, 0, 0.5, 'the last row of a pose is not 0 0 0 1'),
    (0, 0, 7.0, 'pose 6: the deviation from a rotation'),
])
def test_refuses_what_is_not_a_pose(poses, row, column, value, message):
    poses = poses.copy()
    poses[6, row, column] = value
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(stamps(10), poses)


@pytest.mark.parametrize('position', [1.1e9, -1e12, 1e100, 1e300])
def test_refuses_positions_that_no_map_holds(poses, position):
    poses = poses.copy()
    poses[4, 1, 3] = position
    with pytest.raises(TrajectoryError, match=r'pose 4 lies .* needed at most 1e\+09 m; remove'):
        Trajectory(stamps(10), poses)
    with pytest.raises(TrajectoryError, match='pose 4 lies'):
        Trajectory.from_quaternions(
            stamps(10), poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3]))


def test_positions_up_to_the_limit_and_unsigned_stamps_are_taken(poses):
    poses = poses.copy()
    poses[4, 1, 3] = -MAX_POSITION
    t = stamps(10)
    np.testing.assert_array_equal(Trajectory(t.astype(np.uint64), poses).stamps_ns, t)


def test_stamps_are_no_further_apart_than_64_bits_hold(poses):
    t = np.array([2**62, -2**62 + 1, 5])
    np.testing.assert_array_equal(Trajectory(t, poses[:3]).stamps_ns, np.sort(t))
    with pytest.raises(TrajectoryError, match='reach over 585 years, needed less than 292'):
        Trajectory(np.array([2**63 - 1, -2**63, 5]), poses[:3])


def test_faults_of_poses_are_told_apart():
    rows = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (7, 1))
    rows[1, 0], rows[2, 4], rows[3, 3:] = np.nan, np.inf, 0.0
    rows[4, 3], rows[5, 2], rows[6] = 1e200, -1.1 * MAX_POSITION, [np.inf, 0, 0, 9, 9, 9, 9]
    found = [np.flatnonzero(mask).tolist() for mask in pose_faults(rows)]
    assert found == [[1, 2, 6], [3, 4], [5]]


# NumPy before 1.24 warns of rows of unequal length where later ones raise.
@pytest.mark.filterwarnings('ignore:Creating an ndarray from ragged')
@pytest.mark.parametrize('given, message', [
    ([[[1, 2], [3]]] * 10, 'poses are no array of numbers .*needed one'),
    ('abc', 'poses are no array of numbers'), (['1', '2'], r'shape \(2,\)'),
    (None, 'poses have the shape|poses are no')])
def test_refuses_poses_that_are_no_numbers(given, message):
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(stamps(10), given)


@pytest.mark.filterwarnings('ignore:Creating an ndarray from ragged')
def test_refuses_positions_that_are_no_numbers(poses):
    q = se3.rotation_to_quaternion(poses[:, :3, :3])
    with pytest.raises(TrajectoryError, match='positions are no array of numbers'):
        Trajectory.from_quaternions(stamps(2), [[1, 2, 3], [1]], q[:2])
    with pytest.raises(TrajectoryError, match='stamps are'):
        Trajectory([[1, 2], [3]], poses)
    with pytest.raises(TrajectoryError, match='stamps are'):
        Trajectory.from_quaternions([[1, 2], [3]], poses[:2, :3, 3], q[:2])
    with pytest.raises(TrajectoryError, match='positions are no array of numbers'):
        Trajectory.from_quaternions(stamps(2), [[10**400, 2, 3], [1, 2, 3]], q[:2])
    with pytest.raises(TrajectoryError, match='quaternions are complex'):
        Trajectory.from_quaternions(stamps(10), poses[:, :3, 3], q * 1j)


def test_refuses_reflections(poses):
    poses = poses.copy()
    poses[2, :3, 0] *= -1
    with pytest.raises(TrajectoryError, match='pose 2: the deviation from a rotation'):
        Trajectory(stamps(10), poses)


def test_refuses_rotations_whose_squares_overflow(poses):
    poses = poses.copy()
    poses[2, :3, :3] = 1e200 * np.array([[1, 1, 0], [1, -1, 0], [0, 0, 1]])
    with pytest.raises(TrajectoryError, match='pose 2: the deviation from a rotation'):
        Trajectory(stamps(10), poses)
    with pytest.raises(TrajectoryError, match='pose 0: the norm of the quaternion is inf'):
        Trajectory.from_quaternions(stamps(2), np.zeros((2, 3)), np.full((2, 4), 1e200))


def test_refuses_quaternions_that_are_none(poses):
    p, q = poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3])
    with pytest.raises(TrajectoryError, match='norm of the quaternion is 0'):
        Trajectory.from_quaternions(stamps(10), p, np.zeros((10, 4)))
    with pytest.raises(TrajectoryError, match='pose 3 is not finite'):
        q[3, 1] = np.nan
        Trajectory.from_quaternions(stamps(10), p, q)
    with pytest.raises(TrajectoryError, match=r'needed \(N, 3\) and \(N, 4\)'):
        Trajectory.from_quaternions(stamps(10), q, p)


def test_arrays_of_a_notebook():
    seconds = [0.5, 1.0, 1.25]
    found = Trajectory.from_arrays(
        seconds, np.eye(3), [[0, 0, 0.6, 0.8]] * 3, world_frame='odom', sensor_frame='camera')
    np.testing.assert_array_equal(found.stamps_ns, [500_000_000, 1_000_000_000, 1_250_000_000])
    np.testing.assert_array_equal(found.positions, np.eye(3))
    assert (found.world_frame, found.sensor_frame) == ('odom', 'camera')
    np.testing.assert_allclose(found.rotations[0, :, 0], [0.28, 0.96, 0], atol=1e-12)


@pytest.mark.parametrize('seconds', [[0, 1, np.nan], [0, 1, 1.7e18], [0, 'x', 2]])
def test_seconds_that_are_none(seconds):
    with pytest.raises(TrajectoryError, match='seconds are'):
        Trajectory.from_arrays(seconds, np.eye(3), [[0, 0, 0, 1]] * 3)


def test_of_two_recordings_in_one_the_longest_stays():
    steps = 100_000_000 * np.arange(60)
    stamps_ns = np.concatenate([steps[:25], steps[:60] + 37])
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    poses[:, 0, 3] = np.arange(len(stamps_ns))
    trajectory = Trajectory(stamps_ns, poses)
    assert np.array_equal(trajectory.stamps_ns, steps + 37)
    assert np.array_equal(trajectory.positions[:, 0], np.arange(25, 85))
    assert 'dropped 25 poses: time restarted' in trajectory.warnings[0]


@pytest.mark.parametrize('order', [
    np.arange(60)[::-1],
    np.concatenate([np.arange(30, 60), np.arange(30)]),
    np.random.default_rng(3).permutation(60)])
def test_poses_of_one_recording_that_are_out_of_order_all_stay(order):
    stamps_ns = 100_000_000 * np.arange(60)
    trajectory = Trajectory(stamps_ns[order], np.tile(np.eye(4), (60, 1, 1)))
    assert np.array_equal(trajectory.stamps_ns, stamps_ns)
