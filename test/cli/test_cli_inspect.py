# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration inspect``: what is there, and whether its motion suffices."""

import json
from pathlib import Path

from bag_writing import BagFile, make_track
from cli_helpers import make_pair, run, write_pair, write_pair_bag
import numpy as np
import pytest

from trajectory_calibration import Trajectory
from trajectory_calibration.geometry.se3 import exp_so3, from_rotation_translation
from trajectory_calibration.outputs.inspection import inspect_trajectory
from trajectory_calibration.sources.files import read_text


def test_a_file(tmp_path, capsys):
    a, _, _ = write_pair(tmp_path)
    status, out, err = run(capsys, 'inspect', a)
    assert (status, err) == (0, '')
    lines = out.splitlines()
    assert lines[0] == a
    words = dict(line.split(maxsplit=1) for line in lines[1:])
    # No format of files carries names.
    assert words['frames'] == 'not named in the file'
    assert words['poses'] == '80, 10.00 Hz, no gaps'
    assert words['time'] == '7.900 s from 1700000000.000'
    assert words['motion'].startswith('sufficient: ')


def test_a_file_is_read_once(tmp_path, monkeypatch, capsys):
    reads = []

    def counted(path):
        reads.append(path)
        return read_text(path)

    monkeypatch.setattr('trajectory_calibration.sources.files.read_text', counted)
    a = write_pair(tmp_path)[0]
    status, out, _ = run(capsys, 'inspect', a, '--format', 'json')
    assert (status, reads) == (0, [Path(a)])
    assert 'xyzw' in json.loads(out)['inputs'][0]['trajectories'][0]['read_as']


def test_the_order_of_the_quaternion_is_said_and_asked_about(tmp_path, capsys):
    time = np.arange(300) * 0.1
    yaw = 0.5 + 2 * np.sin(0.3 * time)
    moved = 0.5 * np.column_stack([np.cos(yaw), np.sin(yaw), 0 * yaw])
    poses = np.column_stack([
        np.cumsum(moved, axis=0), 0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)])
    path = tmp_path / 'a.txt'
    for order, doubts in (([0, 1, 2, 3, 4, 5, 6], 0), ([0, 1, 2, 6, 3, 4, 5], 1)):
        path.write_text('\n'.join(
            ' '.join(map(repr, row)) for row in np.column_stack(
                [1e9 + time, poses[:, order]]).tolist()), encoding='utf-8')
        _, out, _ = run(capsys, 'inspect', path)
        assert out.count('is w first in the quaternions?') == doubts
        assert 't,x,y,z,qx,qy,qz,qw' in out
        assert 'assumed: xyzw' in out
    _, out, _ = run(capsys, 'inspect', path, '--quaternion-order', 'wxyz')
    assert 'is w first' not in out
    # A heading leaves nothing to assume.
    path.write_text('# t x y z qw qx qy qz\n' + path.read_text(encoding='utf-8'), encoding='utf-8')
    _, out, _ = run(capsys, 'inspect', path)
    assert 't,x,y,z,qw,qx,qy,qz (from the heading)' in out
    assert 'assumed' not in out
    # What is carried moves along all of its axes in either order.
    stamps_ns, carried, _ = make_pair(200)
    turn = np.column_stack([2 * np.sin(1e-9 * (stamps_ns % 10**11) * k) for k in (0.7, 1.1, 1.3)])
    carried[:, :3, :3] = exp_so3(turn)
    assert inspect_trajectory(Trajectory(stamps_ns, carried), 'x', 'file')['findings'] == []


def test_planar_motion_is_said_in_words(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path, planar=True)
    status, out, _ = run(capsys, 'inspect', a)
    assert status == 0
    assert ('insufficient: it turned about z only: the translation along z will not be '
            'determined; drive a ramp or a bank') in ' '.join(out.split())
    # Sensor b is mounted askew: its axis has no name.
    _, out, _ = run(capsys, 'inspect', b)
    assert 'it turned about (' in out


def test_a_file_names_no_frame_in_json(tmp_path, capsys):
    a, _, _ = write_pair(tmp_path)
    _, out, _ = run(capsys, 'inspect', a, '--format', 'json')
    found = json.loads(out)['inputs'][0]['trajectories'][0]
    assert (found['sensor_frame'], found['world_frame']) == (None, None)


def test_json_of_a_bag(tmp_path, capsys):
    bag = write_pair_bag(tmp_path / 'bag')
    status, out, err = run(capsys, 'inspect', bag, '--format', 'json')
    assert (status, err) == (0, '')
    found = json.loads(out)['inputs'][0]
    assert found['path'] == bag
    assert found['notes'] == []
    camera, lidar = found['trajectories']
    assert (lidar['name'], lidar['kind']) == ('/lidar/odom', 'nav_msgs/msg/Odometry')
    assert (lidar['sensor_frame'], lidar['world_frame']) == ('lidar', 'map')
    assert (lidar['poses'], lidar['messages'], lidar['gaps']) == (80, 80, 0)
    assert lidar['rate_hz'] == pytest.approx(10.0)
    assert camera['kind'] == 'geometry_msgs/msg/PoseStamped'
    assert found['other'] == [
        {'topic': '/words', 'msgtype': 'std_msgs/msg/String', 'messages': 1}]


def test_text_of_a_bag_names_what_cannot_serve_and_why(tmp_path, capsys):
    stamps_ns, poses = make_track(3)
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/once', bag.messages.pose(stamps_ns[0], poses[0]), 1)
        bag.add('/words', bag.messages.text('hello'), 2)
        for stamp, pose in zip(stamps_ns, poses * [1, 1, 1, 1, 1, 1, np.nan], strict=True):
            bag.add('/lost', bag.messages.pose(stamp, pose), stamp)
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/good', bag.messages.pose(stamp, pose, 'odom'), stamp)
        bag.add('/good', bag.messages.pose(stamps_ns[0] + 5, poses[0] * np.inf, 'odom'), 9)
    with np.errstate(invalid='ignore'):
        status, out, _ = run(capsys, 'inspect', tmp_path / 'bag')
    assert status == 0
    assert ('/good  (geometry_msgs/msg/PoseStamped)\n'
            '  note: good: /good: dropped 1 pose: not finite') in out
    assert 'warning' not in out
    assert 'good in odom' in out
    _, found, _ = run(capsys, 'inspect', tmp_path / 'bag', '--format', 'json')
    good, = json.loads(found)['inputs'][0]['trajectories']
    assert [one['level'] for one in good['findings']] == ['note']
    assert [one['text'] for one in good['findings']] == good['warnings']
    assert '3 of 4 messages' in out
    cannot = out[out.index('Topics that cannot serve'):]
    assert '/once   /once: poses in 1 of 1 message, needed at least 2' in cannot
    assert '/lost   /lost: poses in 0 of 3 messages' in cannot
    assert '/words  std_msgs/msg/String, 1 message\n' in cannot


def test_a_damaged_bag_is_inspected_with_a_warning(tmp_path, capsys):
    bag = write_pair_bag(tmp_path / 'bag')
    file = tmp_path / 'bag/bag.mcap'
    file.write_bytes(file.read_bytes()[:40000])
    status, out, _ = run(capsys, 'inspect', bag)
    assert status == 0
    out = ' '.join(out.split())
    assert f'warning: {file} is damaged' in out
    assert 'of 80 messages' in out


def test_what_is_wrong_with_a_bag_is_said_once(tmp_path, capsys):
    bag = write_pair_bag(tmp_path / 'bag')
    (tmp_path / 'bag/metadata.yaml').unlink()
    _, out, _ = run(capsys, 'inspect', bag)
    assert out.count('metadata.yaml is missing') == 1
    _, out, _ = run(capsys, 'calibrate', '/lidar/odom', '/camera/pose', '--bag', bag, '--solver',
                    'park', '--reference', 'B5', '--format', 'json')
    assert [note.split(': ', 2)[2] for note in json.loads(out)['warnings']] == [
        f'{bag}: metadata.yaml is missing: read bag.mcap']


def test_the_last_message_of_a_path(tmp_path, capsys):
    stamps_ns, poses = make_track(5)
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/path', bag.messages.path(stamps_ns[:3], poses[:3]), 1)
        bag.add('/path', bag.messages.path(stamps_ns, poses), 2)
    _, out, _ = run(capsys, 'inspect', tmp_path / 'bag')
    assert 'poses         5 in the last of 2 messages, 10.00 Hz' in out


def test_several_paths(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path)
    status, out, _ = run(capsys, 'inspect', a, b, write_pair_bag(tmp_path / 'bag'))
    assert status == 0
    assert out.count('sufficient: ') == 4
    assert run(capsys, 'inspect', a, b, '--bag', tmp_path / 'bag')[1] == out


def test_kitti_needs_its_times(tmp_path, capsys):
    path = tmp_path / 'poses.txt'
    path.write_text('1 0 0 0 0 1 0 0 0 0 1 0\n' * 3, encoding='utf-8')
    (tmp_path / 'times.txt').write_text('0\n1\n2\n', encoding='utf-8')
    status, _, err = run(capsys, 'inspect', path)
    assert status == 1
    assert 'give the file of their times as well' in err
    status, out, _ = run(capsys, 'inspect', path, '--times', tmp_path / 'times.txt')
    assert status == 0
    assert 'it hardly turned' in out


def test_nothing_there(tmp_path, capsys):
    status, out, err = run(capsys, 'inspect', tmp_path / 'none')
    assert (status, out) == (1, '')
    assert err == f'error: {tmp_path}/none cannot be read: No such file or directory\n'


@pytest.mark.parametrize('order', [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_what_can_be_read_is_shown_before_the_error(tmp_path, capsys, order):
    a, b, _ = write_pair(tmp_path)
    paths = [(a, f'{tmp_path}/none', b)[k] for k in order]
    status, out, err = run(capsys, 'inspect', *paths)
    assert status == 1
    assert out.count('sufficient: ') == 2
    assert err == f'error: {tmp_path}/none cannot be read: No such file or directory\n'
    status, out, err = run(capsys, 'inspect', *paths, f'{tmp_path}/x.mcap', '--format', 'json')
    assert status == 1
    assert {found['path'] for found in json.loads(out)['inputs']} == {a, b}
    assert err.count('\n') == 1
    assert f'{tmp_path}/none' in err
    assert f'{tmp_path}/x.mcap' in err


def _inspect(turn, seconds=60.0, rate=10.0, noise=0.0):
    """Inspect a trajectory whose rotation vector after t seconds is ``turn(t)``."""
    time = np.arange(0, seconds, 1 / rate)
    rng = np.random.default_rng(4)
    phi = np.stack([turn(t) for t in time]) + rng.normal(0, noise, (len(time), 3))
    poses = from_rotation_translation(exp_so3(phi), np.outer(time, [1, 0, 0]))
    return inspect_trajectory(
        Trajectory(np.round(time * 1e9).astype(np.int64), poses), 'x', 'file')


@pytest.mark.parametrize('rate', [1.0, 10.0, 200.0])
def test_the_verdict_does_not_depend_on_the_rate(rate):
    def spatial(t):
        return np.array([0.3 * np.sin(t), 0.3 * np.cos(0.7 * t), 0.2 * t])

    assert _inspect(spatial, rate=rate)['motion'] == 'sufficient'
    assert _inspect(lambda t: np.array([0, 0, 0.2 * t]), rate=rate)['motion'] == 'insufficient'
    gentle = _inspect(
        lambda t: np.array([0.04 * np.sin(t), 0.02 * np.cos(t), 0.2 * t]), rate=rate)
    assert gentle['motion'] == 'weak'
    assert 'turned mostly about z' in gentle['advice']


def test_noise_is_not_motion():
    still = _inspect(lambda _: np.zeros(3), noise=0.005)
    assert still['motion'] == 'insufficient'
    assert 'hardly turned' in still['advice']
    planar = _inspect(lambda t: np.array([0, 0.2 * t, 0]), noise=0.005)
    assert planar['motion'] == 'insufficient'
    assert 'turned about y only' in planar['advice']


def test_gaps_and_path_length():
    stamps_ns, poses, _ = make_pair(80)
    keep = np.r_[0:30, 50:80]
    found = inspect_trajectory(Trajectory(stamps_ns[keep], poses[keep]), 'x', 'file')
    assert (found['poses'], found['gaps']) == (60, 1)
    assert found['longest_gap_s'] == pytest.approx(2.1)
    steps = np.linalg.norm(np.diff(poses[keep, :3, 3], axis=0), axis=1)
    assert found['path_length_m'] == pytest.approx(steps.sum())


def test_two_poses():
    found = inspect_trajectory(
        Trajectory(np.array([0, 10**9]), np.stack([np.eye(4)] * 2)), 'x', 'file')
    assert (found['rate_hz'], found['motion']) == (1.0, 'insufficient')


def test_the_frames_of_a_bag_and_the_pairs_that_can_serve(tmp_path, capsys):
    stamps_ns, poses = make_track(40)
    with BagFile(tmp_path / 'bag') as bag:
        bag.add('/tf_static', bag.messages.tf((0, [1, 0, 0, 0, 0, 0, 1], 'base', 'lidar')), 1)
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            bag.add('/tf', bag.messages.tf((stamp, pose, 'odom', 'base')), stamp)
    _, out, _ = run(capsys, 'inspect', tmp_path / 'bag')
    assert 'tf:odom.base  (tf2_msgs/msg/TFMessage)' in out
    assert 'base in odom' in out
    assert 'base, lidar, odom' in out
    assert 'base -> lidar (static), odom -> base' in out
    assert 'cannot serve' not in out
    _, out, _ = run(capsys, 'inspect', tmp_path / 'bag', '--format', 'json')
    assert json.loads(out)['inputs'][0]['transforms']['pairs'] == ['tf:odom.base']


def test_a_file_of_another_layout(tmp_path, capsys):
    a, _, _ = write_pair(tmp_path)
    lines = Path(a).read_text(encoding='utf-8').splitlines()
    rows = [line.split() for line in lines if not line.startswith('#')]
    path = tmp_path / 'swapped.txt'
    path.write_text('\n'.join(' '.join([row[0], *row[4:], *row[1:4]]) for row in rows),
                    encoding='utf-8')
    status, _, err = run(capsys, 'inspect', path)
    assert status == 1
    assert '--columns t,qx,qy,qz,qw,x,y,z or --columns t,qw,qx,qy,qz,x,y,z' in err
    status, out, _ = run(capsys, 'inspect', path, '--columns', 't,qx,qy,qz,qw,x,y,z')
    assert status == 0
    assert 'sufficient' in out
