# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories read back from real bags are those that were written."""

from bag_writing import BagFile, make_track, write_bag
import numpy as np
import pytest

from trajectory_calibration import SourceError, TopicError
from trajectory_calibration.geometry.se3 import quaternion_to_rotation
from trajectory_calibration.sources import BagSource
from trajectory_calibration.sources.bags import open_bags
from trajectory_calibration.sources.cdr import TRAJECTORY_TYPES

STORAGES = ('mcap', 'mcap zstd', 'sqlite3', 'sqlite3 message', 'sqlite3 file', 'ros1')


def _path(folder, storage):
    return folder / ('bag.bag' if storage == 'ros1' else 'bag')


def _expect(trajectory, stamps_ns, poses):
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(trajectory.positions, poses[:, :3])
    np.testing.assert_allclose(
        trajectory.rotations, quaternion_to_rotation(poses[:, 3:]), atol=1e-12)


@pytest.mark.parametrize('storage', STORAGES)
def test_every_type_in_every_storage(tmp_path, storage):
    stamps_ns, poses = make_track(9)
    with BagFile(_path(tmp_path, storage), storage) as bag:
        for k in range(9):
            stamp, pose = stamps_ns[k], poses[k]
            bag.add('/odom', bag.messages.odometry(stamp, pose, 'world', 'base'), stamp + 1)
            bag.add('/ns/pose', bag.messages.pose(stamp, pose), stamp + 2)
            bag.add('/cov', bag.messages.pose_with_covariance(stamp, pose), stamp + 3)
            path = bag.messages.path(stamps_ns[:k + 1], poses[:k + 1] + (8 - k), 'earth')
            bag.add('/path', path, stamp + 4)
    names = {}
    for topic in ('/odom', '/ns/pose', '/cov', '/path'):
        trajectory = BagSource([_path(tmp_path, storage)], topic).load()
        _expect(trajectory, stamps_ns, poses)
        assert trajectory.warnings == ()
        names[topic] = trajectory.world_frame, trajectory.sensor_frame
    assert names == {'/odom': ('world', 'base'), '/ns/pose': ('map', 'ns_pose'),
                     '/cov': ('map', 'cov'), '/path': ('earth', 'path')}


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_storage_file_without_its_folder(tmp_path, storage):
    folder = write_bag(tmp_path / 'bag', storage)
    file = next(item for item in folder.iterdir() if item.suffix in ('.mcap', '.db3'))
    trajectory = BagSource([file], '/odom').load()
    _expect(trajectory, *make_track(50, 1))
    assert trajectory.warnings == ()


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3 message'])
def test_a_folder_named_like_a_ros1_bag(tmp_path, storage):
    write_bag(tmp_path / 'drive.bag', storage)
    _expect(BagSource([tmp_path / 'drive.bag'], '/odom').load(), *make_track(50, 1))


def test_frames_can_be_overridden(tmp_path):
    write_bag(tmp_path / 'bag')
    trajectory = BagSource([str(tmp_path / 'bag')], '/odom', 'velodyne', 'utm').load()
    assert (trajectory.sensor_frame, trajectory.world_frame) == ('velodyne', 'utm')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
def test_several_bags_in_any_order(tmp_path, storage):
    stamps_ns, poses = make_track(30)
    paths = []
    for part in (slice(20, 30), slice(0, 10), slice(10, 20)):
        paths.append(tmp_path / f'{part.start}{".bag" if storage == "ros1" else ""}')
        with BagFile(paths[-1], storage) as bag:
            for stamp, pose in zip(stamps_ns[part], poses[part], strict=True):
                bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    trajectory = BagSource(paths, '/odom').load()
    _expect(trajectory, stamps_ns, poses)
    assert trajectory.warnings == ()


@pytest.mark.parametrize('storage', ['mcap', 'ros1'])
def test_messages_that_two_bags_hold_are_used_once_and_named(tmp_path, storage):
    stamps_ns, poses = make_track(50)
    bags = [tmp_path / f'{name}.{"bag" if storage == "ros1" else "mcap"}' for name in 'xy']
    for path, part in zip(bags, (slice(0, 30), slice(20, 50)), strict=True):
        with BagFile(path, storage) as bag:
            for stamp, pose in zip(stamps_ns[part], poses[part], strict=True):
                bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    for order in (bags, bags[::-1], [*bags, bags[0]]):
        trajectory = BagSource(order, '/odom').load()
        _expect(trajectory, stamps_ns, poses)
        assert f'{order[1]} repeats 10 messages of {order[0]}: used once' in trajectory.warnings[0]


def test_two_runs_of_one_time_are_never_mixed(tmp_path):
    stamps_ns, poses = make_track(50)
    bags = [tmp_path / 'x.mcap', tmp_path / 'y.mcap']
    for path, step_ns in zip(bags, (0, 2_000_000_000), strict=True):
        with BagFile(path, 'mcap') as bag:
            for stamp, pose in zip(stamps_ns + step_ns, poses, strict=True):
                bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    with pytest.raises(SourceError, match=r'x\.mcap and .*y\.mcap overlap by 2\.9 s with diff'):
        BagSource(bags, '/odom').load()


def test_a_topic_that_only_one_of_the_bags_holds(tmp_path):
    write_bag(tmp_path / 'one')
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'two') as bag:
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/camera', bag.messages.pose(stamp, pose), stamp)
    trajectory = BagSource([tmp_path / 'one', tmp_path / 'two'], '/camera').load()
    _expect(trajectory, stamps_ns, poses)


def test_last_path_wins_over_several_bags(tmp_path):
    stamps_ns, poses = make_track(6)
    for name, shift, received_ns in (('late', 0.0, 2000), ('early', 1.0, 1000)):
        with BagFile(tmp_path / name) as bag:
            bag.add('/path', bag.messages.path(stamps_ns, poses + 5), received_ns)
            bag.add('/path', bag.messages.path(stamps_ns, poses + shift), received_ns + 1)
    trajectory = BagSource([tmp_path / 'late', tmp_path / 'early'], '/path').load()
    _expect(trajectory, stamps_ns, poses)
    assert trajectory.warnings == ()


@pytest.mark.parametrize('last', ['empty', 'lost', 'unstamped'])
def test_a_path_without_a_usable_pose_replaces_nothing(tmp_path, last):
    """A SLAM that is shut down clears its path, and publishes it."""
    stamps_ns, poses = make_track(6)
    few = {'empty': (stamps_ns[:0], poses[:0]), 'lost': (stamps_ns[:2], poses[:2] * np.nan),
           'unstamped': (0 * stamps_ns[:2], poses[:2])}[last]
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/path', bag.messages.path(stamps_ns, poses), 1000)
        bag.add('/path', bag.messages.path(*few), 1001)
    _expect(BagSource([tmp_path / 'bag'], '/path').load(), stamps_ns, poses)


def test_a_path_of_another_drive_that_is_dropped_is_named(tmp_path):
    stamps_ns, poses = make_track(9)
    for k, name in enumerate(('one', 'two', 'three')):
        part = slice(3 * k, 3 * k + 3)
        with BagFile(tmp_path / name) as bag:
            bag.add('/path', bag.messages.path(stamps_ns[part], poses[part]), 1000 + k)
    trajectory = BagSource([tmp_path / name for name in ('two', 'three', 'one')], '/path').load()
    _expect(trajectory, stamps_ns[6:], poses[6:])
    assert ''.join(trajectory.warnings) == (
        'path: /path: 2 earlier paths with 6 poses of another time: dropped, only the last path '
        'is used; calibrate each bag separately')


def test_a_path_that_began_anew_within_a_bag_is_named(tmp_path):
    """A SLAM that lost its track begins a path of its own."""
    stamps_ns, poses = make_track(9)
    with BagFile(tmp_path / 'bag') as bag:
        for k, (first, last) in enumerate([(0, 3), (0, 6), (6, 7), (6, 9)]):
            part = slice(first, last)
            bag.add('/path', bag.messages.path(stamps_ns[part], poses[part]), 1000 + k)
    trajectory = BagSource([tmp_path / 'bag'], '/path').load()
    _expect(trajectory, stamps_ns[6:], poses[6:])
    assert '1 earlier path with 6 poses of another time: dropped' in trajectory.warnings[0]


def test_blocks_are_joined(tmp_path):
    """More messages than one block holds, with frame ids that change the length between."""
    stamps_ns, poses = make_track(9000)
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/pose', bag.messages.pose(stamp, pose), stamp)
    seen = []
    with open_bags([tmp_path / 'bag']) as reader:
        track = reader.read(['/pose'], lambda done, total: seen.append((done, total)))['/pose']
    _expect(track.to_trajectory(), stamps_ns, poses)
    assert seen[-1] == (9000, 9000)


def test_a_topic_that_is_asked_for_twice_needs_no_transforms(tmp_path):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/pose', bag.messages.pose(stamp, pose), stamp)
    with open_bags([tmp_path / 'bag']) as reader:
        found = reader.read(['/pose', '/pose'])
    _expect(found['/pose'].to_trajectory(), stamps_ns, poses)


def test_headers_without_stamps_fall_back_to_the_time_of_reception(tmp_path):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/pose', bag.messages.pose(0, pose), stamp + 7)
    trajectory = BagSource([tmp_path / 'bag'], '/pose').load()
    _expect(trajectory, stamps_ns + 7, poses)
    assert 'times of reception are used' in trajectory.warnings[0]


def test_some_headers_without_stamps_are_dropped(tmp_path):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        for k, (stamp, pose) in enumerate(zip(stamps_ns, poses, strict=True)):
            bag.add('/pose', bag.messages.pose(0 if k in (1, 2) else stamp, pose), stamp)
    trajectory = BagSource([tmp_path / 'bag'], '/pose').load()
    _expect(trajectory, stamps_ns[[0, 3, 4]], poses[[0, 3, 4]])
    assert 'dropped 2 poses without a stamp' in trajectory.warnings[0]


def test_a_path_without_stamps_has_no_time_to_fall_back_to(tmp_path):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/path', bag.messages.path(stamps_ns * 0, poses), 99)
    with pytest.raises(SourceError, match=r'0 of 1 message, .*dropped 5 poses without a stamp'):
        BagSource([tmp_path / 'bag'], '/path').load()


@pytest.mark.parametrize('storage', ['mcap', 'ros1'])
def test_worlds_are_never_mixed(tmp_path, storage):
    stamps_ns, poses = make_track(10)
    with BagFile(_path(tmp_path, storage), storage) as bag:
        for k, (stamp, pose) in enumerate(zip(stamps_ns, poses, strict=True)):
            frame = 'odom' if k < 4 else 'map'
            bag.add('/pose', bag.messages.pose(stamp, pose, frame), stamp)
    trajectory = BagSource([_path(tmp_path, storage)], '/pose').load()
    _expect(trajectory, stamps_ns[4:], poses[4:])
    assert trajectory.world_frame == 'map'
    assert "kept 6 poses in 'map', dropped 4 in 'odom'" in trajectory.warnings[0]


def test_a_child_frame_that_changes_is_another_sensor(tmp_path):
    stamps_ns, poses = make_track(10)
    with BagFile(tmp_path / 'bag') as bag:
        for k, (stamp, pose) in enumerate(zip(stamps_ns, poses, strict=True)):
            child = 'rear' if k % 3 == 0 else 'front'
            bag.add('/odom', bag.messages.odometry(stamp, pose, 'map', child), stamp)
    trajectory = BagSource([tmp_path / 'bag'], '/odom').load()
    assert (len(trajectory), trajectory.sensor_frame) == (6, 'front')
    assert "dropped 4 in 'map' -> 'rear'" in trajectory.warnings[0]


@pytest.mark.parametrize('storage', ['sqlite3', 'ros1'])
def test_poses_that_are_no_poses_are_dropped_and_counted(tmp_path, storage):
    stamps_ns, poses = make_track(10)
    wrong = poses.copy()
    wrong[2, 0], wrong[3, 5], wrong[4, 3:], wrong[5, 3:] = np.nan, np.inf, 0.0, 2 * wrong[5, 3:]
    wrong[6, 1] = -2e9
    with BagFile(_path(tmp_path, storage), storage) as bag:
        for stamp, pose in zip(stamps_ns, wrong, strict=True):
            bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    trajectory = BagSource([_path(tmp_path, storage)], '/odom').load()
    good = [0, 1, 7, 8, 9]
    _expect(trajectory, stamps_ns[good], poses[good])
    assert [note.split(': ', 2)[2] for note in trajectory.warnings] == [
        'dropped 2 poses: not finite',
        'dropped 2 poses: quaternion not of unit length',
        'dropped 1 pose: more than 1e+09 m away along an axis']


def test_messages_that_are_no_messages_are_dropped_and_counted(tmp_path):
    stamps_ns, poses = make_track(10)
    with BagFile(tmp_path / 'bag') as bag:
        for k, (stamp, pose) in enumerate(zip(stamps_ns, poses, strict=True)):
            message = bag.messages.pose(stamp, pose)
            data = bytes(bag.messages.store.serialize_cdr(message, message.__msgtype__))
            bag.add_raw('/pose', message.__msgtype__, data[:-1] if k == 4 else data, stamp)
            bag.add_raw('/none', message.__msgtype__, b'', stamp)
    trajectory = BagSource([tmp_path / 'bag'], '/pose').load()
    _expect(trajectory, np.delete(stamps_ns, 4), np.delete(poses, 4, axis=0))
    assert 'dropped 1 of 10 messages: unreadable' in trajectory.warnings[0]
    with pytest.raises(SourceError, match='poses in 0 of 10 messages, needed at least 2'):
        BagSource([tmp_path / 'bag'], '/none').load()


def test_big_endian_messages(tmp_path):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            message = bag.messages.pose(stamp, pose)
            data = bag.messages.store.serialize_cdr(
                message, message.__msgtype__, little_endian=False)
            bag.add_raw('/pose', message.__msgtype__, data, stamp)
    _expect(BagSource([tmp_path / 'bag'], '/pose').load(), stamps_ns, poses)


@pytest.mark.parametrize(('topic', 'message'), [
    ('/odm', 'no topic /odm'),
    ('/words', 'topic /words is std_msgs/msg/String, which cannot be used as a trajectory'),
])
def test_a_wrong_topic_lists_the_candidates(tmp_path, topic, message):
    write_bag(tmp_path / 'bag')
    with pytest.raises(TopicError) as caught:
        BagSource([tmp_path / 'bag'], topic).load()
    assert str(caught.value) == (
        f'{tmp_path}/bag: {message}; usable topics: /odom (Odometry, 50 messages), '
        '/pose (PoseStamped, 50 messages)')


def test_a_bag_without_candidates_and_an_empty_bag(tmp_path):
    with BagFile(tmp_path / 'words') as bag:
        bag.add('/words', bag.messages.text('hello'), 1)
    with BagFile(tmp_path / 'empty', 'sqlite3'):
        pass
    for name in ('words', 'empty'):
        with pytest.raises(TopicError, match='usable topics: none'):
            BagSource([tmp_path / name], '/odom').load()


def test_one_topic_of_two_types(tmp_path):
    stamps_ns, poses = make_track(3)
    with BagFile(tmp_path / 'one') as bag:
        bag.add('/x', bag.messages.pose(stamps_ns[0], poses[0]), 1)
    with BagFile(tmp_path / 'two') as bag:
        bag.add('/x', bag.messages.odometry(stamps_ns[1], poses[1]), 2)
    with pytest.raises(TopicError, match=r'has several types \(geometry_msgs/.*, nav_msgs/'):
        BagSource([tmp_path / 'one', tmp_path / 'two'], '/x').load()


def test_too_few_poses(tmp_path):
    stamps_ns, poses = make_track(1)
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/x', bag.messages.pose(stamps_ns[0], poses[0]), 1)
    with pytest.raises(SourceError, match='/x: poses in 1 of 1 message, needed at least 2'):
        BagSource([tmp_path / 'bag'], '/x').load()


def test_channels_list_everything(tmp_path):
    write_bag(tmp_path / 'bag')
    with open_bags([tmp_path / 'bag']) as reader:
        assert [tuple(channel) for channel in reader.channels] == [
            ('/odom', TRAJECTORY_TYPES[0], 50, 'cdr'), ('/pose', TRAJECTORY_TYPES[1], 50, 'cdr'),
            ('/words', 'std_msgs/msg/String', 1, 'cdr')]
        assert reader.notes == []
