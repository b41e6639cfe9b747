# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A chain of transforms gives the answer of the Odometry; what a replay leaves unobservable."""

import json

import numpy as np
import pytest

from trajectory_calibration.cli.main import main
from trajectory_calibration.geometry import se3


def simulated(poses, axes=range(3)):
    """Return the stamps of a drive at 10 Hz and the (N, 4, 4) poses of both sensors."""
    rng = np.random.default_rng(3)
    time_s = np.arange(poses) / 10
    twists = np.zeros((poses, 6))
    twists[:, 0] = 0.1
    for axis in axes:
        twists[:, 3 + axis] = 0.05 * np.sin(rng.uniform(0.3, 1.2) * time_s + axis)
    T_w_a = np.empty((poses, 4, 4))
    T_w_a[0] = np.eye(4)
    for k, step in enumerate(se3.exp_se3(twists)[1:], 1):
        T_w_a[k] = T_w_a[k - 1] @ step
    return (1000 + time_s) * 1e9, T_w_a, T_w_a @ se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])


def transform_bags(folder, poses=200, axes=range(3)):
    """Write one drive twice: as Odometry, and as map -> odom -> base_link of /tf.

    The odometry drifts, and its correction in the map jumps as at loop closures.
    """
    bag_writing = pytest.importorskip('bag_writing', reason='rosbags is missing')
    stamps_ns, poses_a, poses_b = simulated(poses, axes)
    rng = np.random.default_rng(8)
    T_odom_base = poses_a @ se3.exp_se3(np.cumsum(rng.normal(size=(poses, 6)) * 0.01, axis=0))
    T_map_odom = poses_a @ se3.inverse(T_odom_base)
    jumps = (np.arange(poses) // 40 * 40).clip(0)
    T_map_odom = T_map_odom[jumps]
    T_map_base = T_map_odom @ T_odom_base
    for name in ('odometry', 'tf'):
        with bag_writing.BagFile(folder / name) as bag:
            make = bag.messages
            for k, stamp_ns in enumerate(stamps_ns.astype(np.int64).tolist()):
                camera = make.odometry(stamp_ns, row(poses_b[k]), 'odom', 'camera')
                bag.add('/camera', camera, stamp_ns)
                if name == 'odometry':
                    lidar = make.odometry(stamp_ns, row(T_map_base[k]), 'map', 'base_link')
                    bag.add('/lidar', lidar, stamp_ns)
                else:
                    bag.add('/tf', make.tf(
                        (stamp_ns, row(T_map_odom[k]), 'map', 'odom'),
                        (stamp_ns, row(T_odom_base[k]), 'odom', 'base_link')), stamp_ns)
    return folder / 'odometry', folder / 'tf'


def row(T):
    """Return x, y, z, qx, qy, qz, qw of a (4, 4) pose."""
    return [*T[:3, 3], *se3.rotation_to_quaternion(T[:3, :3])]


@pytest.mark.parametrize('command', [
    ['replay', '{bag}', '-p', 'topic_a:={a}', '-p', 'topic_b:=/camera', '-p', 'solver:=taylor'],
    ['calibrate', '{a}', '/camera', '--bag', '{bag}', '--solver', 'taylor'],
])
def test_a_chain_of_transforms_gives_the_answer_of_the_odometry(tmp_path, capsys, command):
    found = []
    for bag, topic in zip(transform_bags(tmp_path), ('/lidar', 'tf:map.base_link'), strict=True):
        words = [word.format(bag=bag, a=topic) for word in command]
        assert main([*words, '--format', 'json']) == 0
        found.append(json.loads(capsys.readouterr().out))
    odometry, chain = found
    assert (chain['frame_a'], chain['frame_b']) == ('base_link', 'camera')
    for key in ('translation', 'rotation_xyzw'):
        assert np.abs(np.subtract(
            odometry['T_a_b'][key], chain['T_a_b'][key])).max() < 1e-9


def test_a_replay_prints_an_answer_with_an_open_direction_and_ends_with_its_status(
        tmp_path, capsys):
    bag, _ = transform_bags(tmp_path, axes=[2])
    words = ['replay', str(bag), '-p', 'topic_a:=/lidar', '-p', 'topic_b:=/camera']
    assert main(words) == 3
    shown = capsys.readouterr()
    assert shown.err == ''
    assert shown.out.startswith('base_link -> camera: translation [')
    assert ', unknown] m, rotation xyzw [' in shown.out
    assert '\n - unobservable: z\n' in shown.out
    assert main([*words, '--format', 'json']) == 3
    assert json.loads(capsys.readouterr().out)['T_a_b']['status']['z'] == 'unobserved'
