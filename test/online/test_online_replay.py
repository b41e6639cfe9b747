# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A replay of a bag gives the node's answer."""

import json
from pathlib import Path

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

from trajectory_calibration.cli.main import main

pytestmark = [needs_ros, pytest.mark.ros]
CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'calibration.yaml'


def noisy_drive(poses=150):
    """Return serialized messages of both topics in the order of their publication."""
    rng = np.random.default_rng(5)
    stamps_ns, poses_a, poses_b = ros.drive(poses)
    messages = []
    for k, stamp in enumerate(stamps_ns):
        for topic, type_name, pose, frames in (
                # The odometry begins anew in another frame.
                ('/trajectory_a', 'Odometry', poses_a[k], ('map' if k >= 15 else '', 'lidar')),
                ('/trajectory_b', 'PoseStamped', poses_b[k], ('odom', ''))):
            noise = ros.se3.exp_se3(rng.normal(size=6) * 0.003)
            messages.append((topic, type_name, stamp, pose @ noise, frames))
            if k % 40 == 20:
                # Late, a stray stamp, and another frame.
                messages.append((topic, type_name, stamp - 10**9, pose, frames))
                messages.append((topic, type_name, 7, pose, frames))
                messages.append((topic, type_name, stamp + 1, pose, ('earth', frames[1])))
    return [(topic, type_name, int(stamp), ros.serialize_message(
        ros.to_message(type_name, stamp, pose, *frames)))
        for topic, type_name, stamp, pose, frames in messages]


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a bag with the messages, and the messages."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2', reason='rosbags is missing')
    typestores = pytest.importorskip('rosbags.typesys')
    store = typestores.get_typestore(typestores.Stores.ROS2_JAZZY)
    messages = noisy_drive()
    path = tmp_path_factory.mktemp('replay') / 'drive'
    packages = {'Odometry': 'nav_msgs', 'PoseStamped': 'geometry_msgs'}
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections = {}
        for k, (topic, type_name, _, data) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, f'{packages[type_name]}/msg/{type_name}', typestore=store)
            writer.write(connections[topic], 10**15 + k, data)
    return path, messages


@pytest.mark.parametrize('solver', ['taylor', 'dnlo'])
def test_the_replay_of_a_bag_is_the_answer_of_the_node_bit_for_bit(
        bag, tmp_path, capsys, solver):
    path, messages = bag
    with ros.running(tmp_path, '-p', f'solver:={solver}', '-p', 'frame_b:=camera') as (_, client):
        publishers = {
            '/trajectory_a': client.publisher('trajectory_a', 'Odometry'),
            '/trajectory_b': client.publisher('trajectory_b', 'PoseStamped')}
        for topic, _, _, data in messages:
            publishers[topic].publish(data)
        # Of the new frame, after the message of a third among its first.
        client.wait_for_poses(129, 150)
        extrinsic = client.latched()
        answer = client.call('calibrate')
        client.wait(lambda: extrinsic, 'the extrinsic')
    t, q = extrinsic[0].transform.translation, extrinsic[0].transform.rotation
    arguments = ['replay', str(path), '--params-file', str(CONFIG), '-p', f'solver:={solver}',
                 '-p', 'frame_b:=camera']
    assert main([*arguments, '--format', 'json']) == 0
    replayed = json.loads(capsys.readouterr().out)['T_a_b']
    assert replayed['translation'] == [t.x, t.y, t.z]
    assert replayed['rotation_xyzw'] == [q.x, q.y, q.z, q.w]
    assert main(arguments) == 0
    assert capsys.readouterr().out == f'{answer.message}\n'
    for why in ('stray stamp', 'out of order', 'other frame'):
        assert why in answer.message


@pytest.mark.parametrize('arguments, status, sentence', [
    (['-p', 'topic_b:=/nothing'], 1, 'no topic /nothing; usable topics: /trajectory_a'),
    (['-p', 'type_a:=Path'], 1, 'type_a is nav_msgs/msg/Path'),
    (['-p', 'max_gap:=-1'], 2, 'max_gap is -1.0'),
    (['-p', 'max_gap'], 2, 'needed NAME:=VALUE'),
    (['--params-file', 'nowhere.yaml'], 2, 'nowhere.yaml cannot be read'),
    (['--params-file', str(Path(__file__))], 2, 'cannot be read as parameters'),
])
def test_wrong_usage_is_a_sentence(bag, capsys, arguments, status, sentence):
    assert main(['replay', str(bag[0]), *arguments]) == status
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize('content', [
    'words', '[/**]', '5', '', '/**: x', '/**: {ros__parameters: ab}', '/**: {}',
    '/**: {ros__parameters: [[solver, dnl]]}', '7: {}\n/**: 1',
    '/other_node: {ros__parameters: {solver: dnl}}'])
def test_a_file_without_parameters_is_refused(tmp_path, capsys, content):
    path = tmp_path / 'parameters.yaml'
    path.write_text(content)
    assert main(['replay', str(tmp_path), '--params-file', str(path)]) == 2
    assert 'holds no parameters of trajectory_calibration; needed' in capsys.readouterr().err


@pytest.mark.parametrize('value', ['2023-13-45', '!!int x', '"\\U99999999"', '[' * 1000],
                         ids=['date', 'tag', 'character', 'depth'])
def test_a_parameter_that_is_no_yaml_is_refused(tmp_path, capsys, value):
    assert main(['replay', str(tmp_path), '-p', f'max_gap:={value}']) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: -p 'max_gap:=") and ' cannot be read: ' in err


def test_parameters_of_this_node_only_are_taken(bag, tmp_path, capsys):
    path = tmp_path / 'parameters.yaml'
    path.write_text(
        # As `ros2 param dump` writes a name with a dot.
        '/front/trajectory_calibration:\n  ros__parameters:\n    solver: taylor\n'
        '    diagnostic_updater: {period: 0.5}\n'
        '/**:\n  ros__parameters: {solver: park, reference: B2, use_sim_time: true}\n'
        '/other_node:\n  ros__parameters: {solver: nonsense}\n')
    assert main(['replay', str(bag[0]), '--params-file', str(path), '--format', 'yaml']) == 0
    out = capsys.readouterr().out
    assert 'solver: taylor' in out and 'reference: B2' in out
