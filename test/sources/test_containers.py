# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags of every container, also those that rosbag2 itself did not write, give what they hold."""

import shutil
import sys

from bag_writing import BagFile, make_track, Messages, ROS1, write_bag, write_mcap
import numpy as np
import pytest

from trajectory_calibration import SourceError, TopicError
from trajectory_calibration.errors import MissingPackageError
from trajectory_calibration.geometry.se3 import quaternion_to_rotation
from trajectory_calibration.sources import BagSource
from trajectory_calibration.sources.bags import open_bags

COUNT = 40
STAMPS_NS, POSES = make_track(COUNT, 1)


def _expect(trajectory, stamps_ns=STAMPS_NS, poses=POSES):
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(trajectory.positions, poses[:, :3])
    np.testing.assert_allclose(
        trajectory.rotations, quaternion_to_rotation(poses[:, 3:]), atol=1e-12)


def _messages(*, ros1=False, msgtype='nav_msgs/msg/Odometry'):
    messages = Messages(ROS1) if ros1 else Messages()
    serialize = messages.store.serialize_ros1 if ros1 else messages.store.serialize_cdr
    for stamp_ns, pose in zip(STAMPS_NS, POSES, strict=True):
        message = messages.odometry(stamp_ns, pose)
        yield '/odom', msgtype, stamp_ns, bytes(serialize(message, message.__msgtype__))


@pytest.mark.parametrize('options', [
    {}, {'profile': ''}, {'profile': 'other'}, {'crc': False}, {'chunked': False},
    {'indexed': False}, {'indexed': False, 'chunked': False}])
def test_an_mcap_file_of_another_recorder(tmp_path, options):
    path = write_mcap(tmp_path / 'a.mcap', _messages(), **options)
    trajectory = BagSource([path], '/odom').load()
    _expect(trajectory)
    assert trajectory.warnings == ()


def test_an_mcap_file_of_ros_1(tmp_path):
    path = write_mcap(tmp_path / 'a.mcap', _messages(ros1=True, msgtype='nav_msgs/Odometry'),
                      profile='ros1', encoding='ros1')
    trajectory = BagSource([path], '/odom').load()
    _expect(trajectory)
    assert trajectory.warnings == ()


def test_an_mcap_file_of_json_says_what_it_is(tmp_path):
    messages = [('/odom', 'nav_msgs/msg/Odometry', stamp, b'{"x": 1}') for stamp in STAMPS_NS]
    path = write_mcap(tmp_path / 'a.mcap', messages, profile='', encoding='json')
    with pytest.raises(TopicError, match='topic /odom is written as json, and only cdr and ros1 '
                       'can be read; usable topics: none'):
        BagSource([path], '/odom').load()


def test_the_checksum_of_a_chunk_is_checked(tmp_path):
    path = write_mcap(tmp_path / 'a.mcap', _messages())
    data = bytearray(path.read_bytes())
    # A digit of a number in the middle of the chunk: only the checksum tells.
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r'wrong size or checksum.*read 0 of 40 messages'):
        BagSource([path], '/odom').load()


def test_a_type_without_msg(tmp_path):
    path = write_mcap(tmp_path / 'a.mcap', _messages(msgtype='nav_msgs/Odometry'))
    _expect(BagSource([path], '/odom').load())


@pytest.mark.parametrize('storage', ['sqlite3 message', 'sqlite3 file'])
def test_compressed_without_metadata(tmp_path, storage):
    folder = write_bag(tmp_path / 'bag', storage, COUNT)
    (folder / 'metadata.yaml').unlink()
    trajectory = BagSource([folder], '/odom').load()
    _expect(trajectory)
    assert all('metadata.yaml is missing' in note for note in trajectory.warnings)
    (file,) = folder.iterdir()
    alone = BagSource([file], '/odom').load()
    _expect(alone)
    assert alone.warnings == ()


@pytest.mark.parametrize('storage', ['mcap zstd', 'sqlite3 message', 'sqlite3 file'])
def test_a_missing_package_is_no_damage(tmp_path, monkeypatch, storage):
    folder = write_bag(tmp_path / 'bag', storage, COUNT)
    for name in ('compression.zstd', 'backports.zstd', 'zstandard'):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingPackageError, match=r'^backports\.zstd is not installed; pip'):
        BagSource([folder], '/odom').load()


def test_a_file_that_was_compressed_by_hand(tmp_path):
    from backports import zstd
    folder = write_bag(tmp_path / 'bag', 'mcap', COUNT)
    packed = tmp_path / 'bag.mcap.zst'
    packed.write_bytes(zstd.compress((folder / 'bag.mcap').read_bytes()))
    _expect(BagSource([packed], '/odom').load())
    packed.write_bytes(packed.read_bytes()[:-100])
    with pytest.raises(SourceError, match='damaged'):
        BagSource([packed], '/odom').load()


def test_a_bag_of_ros_1_that_was_not_closed(tmp_path):
    path = write_bag(tmp_path / 'a.bag', 'ros1', COUNT)
    data = bytearray(path.read_bytes())
    at = data.index(b'index_pos=') + len(b'index_pos=')
    data[at:at + 8] = bytes(8)
    path.write_bytes(data)
    trajectory = BagSource([path], '/odom').load()
    _expect(trajectory)
    assert 'it was not closed and has no index; rosbag reindex writes a new index' in (
        trajectory.warnings[0])
    path.write_bytes(data[:len(data) // 2])
    with BagFile(tmp_path / 'long.bag', 'ros1 bz2') as bag:
        for stamp, pose in zip(*make_track(8000), strict=True):
            bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    path = tmp_path / 'long.bag'
    path.write_bytes(path.read_bytes()[:-path.stat().st_size // 3])
    trajectory = BagSource([path], '/odom').load()
    assert 2000 < len(trajectory) < 8000
    assert 'rosbag reindex' in trajectory.warnings[0]
    assert 'of an unknown number' in trajectory.warnings[1]


@pytest.mark.parametrize('name', ['a.mcap', 'a.db3', 'a.bag'])
def test_a_pointer_of_git_lfs(tmp_path, name):
    (tmp_path / name).write_text('version https://git-lfs.github.com/spec/v1\noid sha256:0\n',
                                 encoding='utf-8')
    with pytest.raises(SourceError, match=r'is a pointer of Git LFS, .*git lfs pull'):
        BagSource([tmp_path / name], '/odom').load()


@pytest.mark.parametrize('topic', ['odom', '/odom'])
def test_a_topic_with_and_without_its_slash(tmp_path, topic):
    write_bag(tmp_path / 'bag', count=COUNT)
    _expect(BagSource([tmp_path / 'bag'], topic).load())


def test_frames_lose_their_slash(tmp_path):
    with BagFile(tmp_path / 'bag') as bag:
        for k, (stamp, pose) in enumerate(zip(STAMPS_NS, POSES, strict=True)):
            frame = '/map' if k % 2 else 'map'
            bag.add('/odom', bag.messages.odometry(stamp, pose, frame, '/base'), stamp)
    trajectory = BagSource([tmp_path / 'bag'], '/odom').load()
    _expect(trajectory)
    assert (trajectory.world_frame, trajectory.sensor_frame) == ('map', 'base')
    assert [found.code for found in trajectory.findings] == ['frame-renamed']
    assert 'which tf2 refuses: /base, /map' in trajectory.warnings[0]


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
def test_a_topic_of_transforms(tmp_path, storage):
    path = tmp_path / ('bag.bag' if storage == 'ros1' else 'bag')
    with BagFile(path, storage) as bag:
        for stamp, pose in zip(STAMPS_NS, POSES, strict=True):
            bag.add('/pose', bag.messages.transform(stamp, pose, 'odom', 'camera'), stamp)
    trajectory = BagSource([path], '/pose').load()
    _expect(trajectory)
    assert (trajectory.world_frame, trajectory.sensor_frame) == ('odom', 'camera')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
def test_a_chain_of_transforms(tmp_path, storage):
    path = tmp_path / ('bag.bag' if storage == 'ros1' else 'bag')
    _, others = make_track(COUNT, 2)
    still = [0.1, 0.2, 0.3, 0, 0, 0.6, 0.8]
    with BagFile(path, storage) as bag:
        bag.add('/tf_static', bag.messages.tf((0, still, 'base', 'lidar')), STAMPS_NS[0])
        for stamp, odom, correction in zip(STAMPS_NS, POSES, others, strict=True):
            bag.add('/tf', bag.messages.tf(
                (stamp, correction, 'map', 'odom'), (stamp, odom, 'odom', 'base')), stamp + 1)
            bag.add('/tf', bag.messages.tf((stamp, still, 'arm', 'hand')), stamp + 2)
        bag.add('/odom', bag.messages.odometry(stamp, odom), stamp)
    trajectory = BagSource([path], 'tf:map.lidar').load()
    np.testing.assert_array_equal(trajectory.stamps_ns, STAMPS_NS)
    assert (trajectory.world_frame, trajectory.sensor_frame) == ('map', 'lidar')

    def matrices(poses):
        T = np.tile(np.eye(4), (len(poses), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = quaternion_to_rotation(poses[:, 3:]), poses[:, :3]
        return T

    expected = matrices(others) @ matrices(POSES) @ matrices(np.array([still]))
    np.testing.assert_allclose(trajectory.poses, expected, atol=1e-12)
    with open_bags([path]) as reader:
        assert reader.transforms().pairs() == [('map', 'odom'), ('map', 'base'), ('odom', 'base')]
        tracks = reader.read(['/tf:odom.base', 'odom'])
        assert [track.msgtype for track in tracks.values()] == [
            'tf2_msgs/msg/TFMessage', 'nav_msgs/msg/Odometry']
        with pytest.raises(TopicError, match='no frame lidr in the transforms; frames: arm, base'):
            reader.read(['tf:map.lidr'])
        with pytest.raises(TopicError, match='name a pair of frames, tf:PARENT.CHILD; '
                           r'usable topics: .*tf:PARENT.CHILD \(inspect lists the frames\)'):
            reader.read(['/tf'])


def test_transforms_of_several_bags_in_any_order(tmp_path):
    for part in (slice(20, 40), slice(0, 20)):
        with BagFile(tmp_path / f'{part.start}') as bag:
            for stamp, pose in zip(STAMPS_NS[part], POSES[part], strict=True):
                bag.add('/tf', bag.messages.tf((stamp, pose, 'odom', 'base')), stamp)
    trajectory = BagSource([tmp_path / '20', tmp_path / '0'], 'tf:odom.base').load()
    _expect(trajectory)
    assert trajectory.warnings == ()


def test_a_bag_without_transforms(tmp_path):
    write_bag(tmp_path / 'bag', count=COUNT)
    with pytest.raises(TopicError, match=r'no topic of transforms \(/tf\)'):
        BagSource([tmp_path / 'bag'], 'tf:map.base').load()


def test_the_public_bag_of_transforms(shared_data):
    bag = shared_data / 'real/tf_example_bag'
    with open_bags([bag]) as reader:
        tree = reader.transforms()
    assert tree.pairs()
    for parent, child in tree.pairs():
        assert len(BagSource([bag], f'tf:{parent}.{child}').load()) > 10


def test_a_path_whose_poses_share_one_stamp(tmp_path):
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/path', bag.messages.path(np.full(COUNT, STAMPS_NS[0]), POSES), STAMPS_NS[0])
    with pytest.raises(SourceError, match=r'/path: all 40 poses have the same time, .*; needed'):
        BagSource([tmp_path / 'bag'], '/path').load()


def test_poses_that_were_written_as_identity_while_lost(tmp_path):
    poses = POSES.copy()
    poses[:, :3] = np.linspace([5, 0, 0], [40, 3, 0], COUNT)
    poses[[10, 11, 30]] = [0, 0, 0, 0, 0, 0, 1]
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(STAMPS_NS, poses, strict=True):
            bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    trajectory = BagSource([tmp_path / 'bag'], '/odom').load()
    keep = np.delete(np.arange(COUNT), [10, 11, 30])
    _expect(trajectory, STAMPS_NS[keep], poses[keep])
    assert 'dropped 3 poses: identity, far from the neighbours' in trajectory.warnings[0]


def test_a_trajectory_that_begins_at_the_identity_or_anew_keeps_it(tmp_path):
    poses = POSES.copy()
    poses[:, :3] = np.linspace([0, 0, 0], [39, 3, 0], COUNT)
    poses[20:, :3] -= poses[20, :3]
    poses[[0, 1, 20]] = [0, 0, 0, 0, 0, 0, 1]
    shutil.rmtree(tmp_path / 'bag', ignore_errors=True)
    with BagFile(tmp_path / 'bag') as bag:
        for stamp, pose in zip(STAMPS_NS, poses, strict=True):
            bag.add('/odom', bag.messages.odometry(stamp, pose), stamp)
    _expect(BagSource([tmp_path / 'bag'], '/odom').load(), STAMPS_NS, poses)
