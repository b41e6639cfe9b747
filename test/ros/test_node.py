# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node in its own process, over real DDS."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

pytestmark = [needs_ros, pytest.mark.ros]

# The fastest solver; the others run where it matters that they do.
TAYLOR = ('-p', 'solver:=taylor')
DNL = ('-p', 'solver:=dnl', '-p', 'reference:=B5')


@pytest.mark.parametrize('types', [
    ('Odometry', 'Odometry'),
    ('PoseStamped', 'PoseWithCovarianceStamped'),
    ('Path', 'Odometry'),
    ('TransformStamped', 'TransformStamped'),
])
def test_extrinsic_of_noise_free_motion_is_exact(tmp_path, types):
    with ros.running(tmp_path, *TAYLOR, '-p', 'frame_b:=camera') as (_, client):
        client.publish_drive(*ros.drive(), types=types)
        extrinsic = client.latched()
        answer = client.call('calibrate')
        assert answer.success, answer.message
        client.wait(lambda: extrinsic, 'the extrinsic')
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-10)
    # Where the message names no sensor, the topic does.
    expected = 'lidar' if types[0] in ('Odometry', 'TransformStamped') else (
        f'{client.namespace[1:]}_trajectory_a')
    assert extrinsic[0].header.frame_id == expected
    assert extrinsic[0].child_frame_id == 'camera'
    assert f'{expected} -> camera: translation [0.33' in answer.message


def test_default_settings_calibrate_too(tmp_path):
    with ros.running(tmp_path) as (_, client):
        client.publish_drive(*ros.drive())
        extrinsic = client.latched()
        answer = client.call('calibrate')
        assert answer.success, answer.message
        client.wait(lambda: extrinsic, 'the extrinsic')
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-6)


ABSENT = """
raise ModuleNotFoundError("No module named '{0}'", name='{0}')
"""


def test_without_rosbags_and_casadi_the_default_solver_calibrates(tmp_path):
    absent = tmp_path / 'absent'
    absent.mkdir()
    for name in ('casadi', 'rosbags', 'apsw', 'ruamel', 'backports', 'joblib', 'matplotlib'):
        (absent / f'{name}.py').write_text(ABSENT.format(name))
    environment = {'PYTHONPATH': os.pathsep.join(
        [str(absent), *filter(None, [os.environ.get('PYTHONPATH')])])}
    with ros.running(tmp_path, environment=environment) as (node, client):
        client.publish_drive(*ros.drive())
        answer = client.call('calibrate')
        assert answer.success, answer.message
        assert client.set_parameter('solver', 'dnl').successful
        without = client.call('calibrate')
    assert (without.success, without.message) == (
        False, 'casadi is not installed; pip install casadi')
    assert 'Traceback' not in node.log


def test_a_failure_says_why_and_keeps_the_previous_answer(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        nothing = client.call('calibrate')
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
        extrinsic = client.latched()
        client.wait(lambda: extrinsic, 'the extrinsic')
        reset = client.call('reset')
        failed = client.call('calibrate')
        late = client.latched()
        client.wait(lambda: late, 'the latched extrinsic')
        client.wait(lambda: client.status('calibration').message.startswith(
            'calibration failed'), 'the failure in the diagnostics')
    assert not nothing.success and '0 poses received' in nothing.message
    assert reset.success and 'dropped 100 poses of a and 100 of b' in reset.message
    assert not failed.success and '0 poses received' in failed.message
    assert len(extrinsic) == 1
    assert late == extrinsic


def test_what_flat_ground_leaves_open_is_not_published_unless_allowed(tmp_path):
    with ros.running(tmp_path, '-p', 'solver:=drift_aware') as (_, client):
        client.publish_drive(*ros.drive(planar=True))
        extrinsic = client.latched()
        refused = client.call('calibrate')
        assert not refused.success
        assert 'not published: z of' in refused.message
        assert 'set allow_unobserved' in refused.message
        assert not extrinsic
        assert client.set_parameter('allow_unobserved', value=True).successful
        allowed = client.call('calibrate')
        assert allowed.success, allowed.message
        assert '\n - unobservable: z\n - ' in allowed.message
        assert '\n - serious: ' in allowed.message
        client.wait(lambda: extrinsic, 'the extrinsic')
    found = ros.matrix(extrinsic[0])
    assert np.allclose(found[:2, 3], ros.T_A_B[:2, 3], atol=1e-4)
    assert np.allclose(found[:3, :3], ros.T_A_B[:3, :3], atol=1e-6)


def test_advice_comes_through_again_once_there_is_more_motion_than_at_a_failure(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        def shown(begin):
            client.wait(lambda: client.status('calibration').message.startswith(begin), begin)
            return client.status('calibration').level
        client.wait(lambda: client.status('calibration') is not None, 'the diagnostics')
        assert not client.call('calibrate').success
        assert shown('calibration failed: ') == b'\x01'
        stamps_ns, poses_a, poses_b = ros.drive(poses=300)
        publishers = client.publish_drive(stamps_ns[:30], poses_a[:30], poses_b[:30])
        assert shown('waiting for motion seen by both sensors: 3 s') == b'\x00'
        assert '0 poses received' in client.value('calibration', 'last_failure')
        for publisher, poses, (frame, child) in zip(
                publishers, (poses_a, poses_b), (('map', 'lidar'), ('odom', 'camera')),
                strict=True):
            for stamp, pose in zip(stamps_ns[30:], poses[30:], strict=True):
                publisher.publish(ros.to_message('Odometry', stamp, pose, frame, child))
        assert shown('enough motion') == b'\x00'
        assert client.call('calibrate').success
        assert shown('calibrated') == b'\x00'
        assert client.value('calibration', 'last_failure') == ''


def test_a_reset_during_a_calibration_is_no_failure(tmp_path):
    with ros.running(tmp_path, '-p', 'solver:=dnlo', '-p', 'reference:=B1') as (node, client):
        client.publish_drive(*ros.drive(poses=2000))
        pending = client.start_call('calibrate')
        # Refused because the first is at work: requests of two services have no order.
        assert client.call('calibrate').message.startswith('busy')
        reset = client.start_call('reset')
        client.wait(reset.done, 'the reset')
        # It waits for the end of what it stopped.
        assert '0 poses received' in client.call('calibrate').message
        client.wait(pending.done, 'the answer of the first call')
        assert client.call('reset').success
        client.diagnostics.clear()
        client.wait_for_poses(0, 0)
        status = client.status('calibration')
    assert not pending.result().success and pending.result().message == 'stopped by a reset'
    assert (status.level, status.message[:18]) == (b'\x00', 'waiting for motion')
    assert node.log.count('calibration failed') == 1


def test_two_nodes_for_two_pairs_run_side_by_side(tmp_path):
    other = np.linalg.inv(ros.T_A_B)
    with (ros.running(tmp_path, *TAYLOR) as (_, one),
          ros.running(tmp_path, *TAYLOR, domain=one.domain) as (_, two)):
        stamps_ns, poses_a, poses_b = ros.drive()
        one.publish_drive(stamps_ns, poses_a, poses_b)
        two.publish_drive(stamps_ns, poses_b, poses_a)
        found = []
        for client in (one, two):
            extrinsic = client.latched()
            assert client.call('calibrate').success
            client.wait(lambda extrinsic=extrinsic: extrinsic, 'the extrinsic')
            found.append(ros.matrix(extrinsic[0]))
    assert np.allclose(found[0], ros.T_A_B, atol=1e-10)
    assert np.allclose(found[1], other, atol=1e-10)


def test_simulated_time_stamps_the_answer_and_stops_nothing(tmp_path):
    with ros.running(tmp_path, *TAYLOR, '-p', 'use_sim_time:=true') as (_, client):
        clock = client.node.create_publisher(ros.Clock, '/clock', 10)
        client.publish_drive(*ros.drive())
        client.wait(lambda: clock.get_subscription_count() > 0, 'the node on /clock')
        message = ros.Clock()
        message.clock.sec = 1234
        extrinsic = client.latched()

        def stamped():
            clock.publish(message)
            assert client.call('calibrate').success
            return extrinsic and extrinsic[-1].header.stamp.sec == 1234

        client.wait(stamped, 'an answer at the time of /clock')
    assert np.allclose(ros.matrix(extrinsic[-1]), ros.T_A_B, atol=1e-10)


@pytest.mark.parametrize('second', [-5, -2**31])
def test_a_negative_time_is_logged_and_the_next_one_taken(tmp_path, second):
    with ros.running(tmp_path, '-p', 'use_sim_time:=true') as (node, client):
        clock = client.node.create_publisher(ros.Clock, '/clock', 10)
        client.wait(lambda: clock.get_subscription_count() > 0, 'the node on /clock')
        times = []
        client.node.create_subscription(
            ros.DiagnosticArray, '/diagnostics',
            lambda message: times.append(message.header.stamp.sec), 10)
        message = ros.Clock()

        def logged():
            message.clock.sec = second
            clock.publish(message)
            return '/clock ignored: Seconds value must not be negative' in node.log

        def taken():
            message.clock.sec = 1234
            clock.publish(message)
            return 1234 in times
        client.wait(logged, 'the warning')
        client.wait(taken, 'the time')
        assert node.log.count('/clock ignored') == 1


def test_several_publishers_on_one_topic_are_a_warning_and_a_question(tmp_path):
    with ros.running(tmp_path) as (_, client):
        publishers = [client.publisher('trajectory_a') for _ in range(2)]
        stamps_ns, poses, _ = ros.drive(poses=30)
        for k, (stamp, pose) in enumerate(zip(stamps_ns, poses, strict=True)):
            publishers[k % 2].publish(ros.to_message('Odometry', stamp, pose))
        name = f'{client.namespace}/client'
        question = f'from 2 publishers ({name}, {name}): are they the same sensor'
        client.wait(lambda: client.status('trajectory_a') is not None, 'the diagnostics')
        client.wait(lambda: question in client.status('trajectory_a').message, 'the question')
        assert client.status('trajectory_a').level == b'\x01'
        client.node.destroy_publisher(publishers.pop())
        client.wait(lambda: 'publishers' not in client.status('trajectory_a').message, 'one')
        assert client.status('trajectory_a').level == b'\x00'


def test_reset_starts_a_new_collection(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        stamps_ns, poses_a, poses_b = ros.drive()
        publishers = client.publish_drive(stamps_ns, poses_a, poses_b)
        client.call('reset')
        client.wait_for_poses(0, 0)
        # The same stamps again: without the reset they would be late.
        for publisher, poses, (frame, child) in zip(
                publishers, (poses_a, poses_b), (('map', 'lidar'), ('odom', 'camera')),
                strict=True):
            for stamp, pose in zip(stamps_ns, poses, strict=True):
                publisher.publish(ros.to_message('Odometry', stamp, pose, frame, child))
        client.wait_for_poses(100, 100)
        assert client.call('calibrate').success


def test_receiving_goes_on_and_a_second_call_is_refused_while_solving(tmp_path):
    # Long enough that the solver process is still at work when the next calls arrive.
    with ros.running(tmp_path, '-p', 'solver:=dnlo', '-p', 'reference:=B1') as (_, client):
        stamps_ns, poses_a, poses_b = ros.drive(poses=3000)
        publishers = client.publish_drive(stamps_ns[:-50], poses_a[:-50], poses_b[:-50])
        first = client.start_call('calibrate')
        second = client.call('calibrate')
        assert not first.done()
        for stamp, pose in zip(stamps_ns[-50:], poses_a[-50:], strict=True):
            publishers[0].publish(ros.to_message('Odometry', stamp, pose, 'map', 'lidar'))
        for stamp, pose in zip(stamps_ns[-50:], poses_b[-50:], strict=True):
            publishers[1].publish(ros.to_message('Odometry', stamp, pose, 'odom', 'camera'))
        client.wait_for_poses(3000, 3000)
        client.wait(first.done, 'the first answer')
    assert not second.success and second.message.startswith('busy')
    assert first.result().success, first.result().message
    assert 'of 2,950 poses' in first.result().message


def test_reset_and_timeout_stop_a_calibration(tmp_path):
    with ros.running(tmp_path, *TAYLOR, '-p', 'calibration_timeout:=0.1') as (_, client):
        client.publish_drive(*ros.drive())
        # Starting an interpreter takes longer than that.
        late = client.call('calibrate')
        assert client.set_parameter('calibration_timeout', 60.0).successful
        pending = client.start_call('calibrate')
        # Refused because the first is at work: requests of two services have no order.
        assert client.call('calibrate').message.startswith('busy')
        reset = client.start_call('reset')
        client.wait(lambda: pending.done() and reset.done(), 'both answers')
        again = client.call('calibrate')
    assert not late.success and 'no answer within 0.1 s' in late.message
    assert not pending.result().success and 'reset' in pending.result().message
    assert not again.success and '0 poses received' in again.message


def test_bad_messages_are_counted_and_harmless(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (node, client):
        stamps_ns, poses_a, poses_b = ros.drive()
        a = client.publisher('trajectory_a')
        b = client.publisher('trajectory_b')
        second_ns = 1_000_000_000
        for k, (stamp, pose_a, pose_b) in enumerate(
                zip(stamps_ns, poses_a, poses_b, strict=True)):
            good = ros.to_message('Odometry', stamp, pose_a, 'map', 'lidar')
            a.publish(good)
            b.publish(ros.to_message('Odometry', stamp, pose_b, 'odom', 'camera'))
            if k == 40:
                bad = ros.to_message('Odometry', stamp + 1, pose_a, 'map', 'lidar')
                bad.pose.pose.position.x = float('nan')
                a.publish(bad)
                bad = ros.to_message('Odometry', stamp + 1, pose_a, 'map', 'lidar')
                bad.pose.pose.orientation.w += 0.5
                a.publish(bad)
                a.publish(good)
                for late_ns in (second_ns // 2, second_ns):
                    a.publish(ros.to_message('Odometry', stamp - late_ns, pose_a, 'map', 'lidar'))
                a.publish(ros.to_message('Odometry', 0, pose_a, 'map', 'lidar'))
                a.publish(ros.to_message('Odometry', stamp + 1, pose_a, 'earth', 'lidar'))
        client.wait_for_poses(100, 100)
        answer = client.call('calibrate')
        client.wait(lambda: 'poses refused' in node.log, 'the log to mention it')
        counts = {key: client.value('trajectory_a', f'refused: {key}') for key in (
            'not finite', 'not a unit quaternion', 'duplicate stamp', 'out of order',
            'no stamp', 'other frame')}
    assert answer.success, answer.message
    assert '7 poses refused' in answer.message
    assert counts == {
        'not finite': '1', 'not a unit quaternion': '1', 'duplicate stamp': '1',
        'out of order': '2', 'no stamp': '1', 'other frame': '1'}


@pytest.mark.parametrize('type_name', ['Odometry', 'PoseStamped', 'Path'])
def test_damaged_bytes_are_counted_and_good_messages_go_on(tmp_path, type_name):
    with ros.running(tmp_path, *TAYLOR) as (node, client):
        stamps_ns, poses_a, poses_b = ros.drive()
        a = client.publisher('trajectory_a', type_name)
        whole = ros.serialize_message(
            ros.to_path(stamps_ns[:50], poses_a[:50]) if type_name == 'Path' else
            ros.to_message(type_name, stamps_ns[0], poses_a[0], 'map', 'lidar'))
        # In the encapsulation, the stamp, the frame, the pose.
        damaged = [whole[:length] for length in (4, 9, 17, 21, 60)]
        # A frame longer than the message, another byte order than said.
        damaged.append(whole[:12] + b'\xff' * 4 + whole[16:])
        damaged.append(b'\x00\x00' + whole[2:])
        a.publish(whole)
        if type_name == 'Path':
            # Of Paths that wait, only the newest is read.
            client.wait(lambda: client.value('trajectory_a', 'messages') == '1', 'the Path')
        for count, message in enumerate(damaged, 1):
            a.publish(message)
            if type_name == 'Path' or count == len(damaged):
                client.wait(lambda count=count: client.value(
                    'trajectory_a', 'refused: unreadable') == str(count), 'the count')
        client.wait(lambda: f'{len(damaged)} unreadable' in node.log, 'the log')
        client.publish_drive(stamps_ns, poses_a, poses_b, types=(type_name, 'Odometry'))
        answer = client.call('calibrate')
        status, _ = node.stop()
    assert answer.success, answer.message
    assert f'{len(damaged)} unreadable' in answer.message
    assert 'of 100 poses' in answer.message
    assert (status, 'Traceback' in node.log) == (0, False), node.log


def test_a_bag_that_loops_starts_anew_and_says_what_it_forgot(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (node, client):
        stamps_ns, poses_a, poses_b = ros.drive(poses=150)
        a, b = client.publish_drive(stamps_ns, poses_a, poses_b)
        for stamp, pose_a, pose_b in zip(
                stamps_ns[:60], poses_a[:60], poses_b[:60], strict=True):
            a.publish(ros.to_message('Odometry', stamp, pose_a, 'map', 'lidar'))
            b.publish(ros.to_message('Odometry', stamp, pose_b, 'odom', 'camera'))
        client.wait(lambda: '150 poses were dropped' in client.status('trajectory_a').message,
                    'the loss')
        assert client.status('trajectory_a').level == b'\x01'
        client.wait_for_poses(60, 60)
        assert client.value('trajectory_a', 'clock jumps') == '1'
        answer = client.call('calibrate')
        log = node.log
    assert log.count('went back, 150 poses were dropped') == 2
    assert answer.success, answer.message
    assert 'of 60 poses' in answer.message


def test_a_republished_path_replaces_the_old_one(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        stamps_ns, poses_a, poses_b = ros.drive()
        path_a = client.publisher('trajectory_a', 'Path')
        path_b = client.publisher('trajectory_b', 'Path')
        # Before the loop closure b was bent; the optimised path is right.
        bent = poses_b @ ros.se3.exp_se3(np.linspace(0, 0.3, 100)[:, None] * np.ones(6))
        path_a.publish(ros.to_path(stamps_ns, poses_a))
        path_b.publish(ros.to_path(stamps_ns[:90], bent[:90]))
        client.wait_for_poses(100, 90)
        path_b.publish(ros.to_path(stamps_ns, poses_b))
        client.wait_for_poses(100, 100)
        extrinsic = client.latched()
        answer = client.call('calibrate')
        assert answer.success, answer.message
        client.wait(lambda: extrinsic, 'the extrinsic')
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-10)


def test_messages_without_stamps_are_named_as_the_cause(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        _, poses, _ = ros.drive(poses=20)
        a, b = client.publisher('trajectory_a'), client.publisher('trajectory_b', 'Path')
        for pose in poses:
            a.publish(ros.to_message('Odometry', 0, pose))
        b.publish(ros.to_path([0] * 20, poses))
        for name in ('trajectory_a', 'trajectory_b'):
            client.wait(lambda name=name: client.value(name, 'refused: no stamp') == '20', name)
            status = client.status(name)
            assert status.level == b'\x01' and '20 no stamp' in status.message
        answer = client.call('calibrate')
    assert not answer.success
    assert '0 poses received' in answer.message and '20 no stamp' in answer.message


def test_a_path_keeps_to_the_bounds_and_an_empty_one_replaces_nothing(tmp_path):
    with ros.running(tmp_path, *TAYLOR, '-p', 'max_age:=2.0') as (_, client):
        stamps_ns, poses, _ = ros.drive()
        a = client.publisher('trajectory_a', 'Path')
        a.publish(ros.to_path(stamps_ns, poses))
        client.wait(lambda: client.value('trajectory_a', 'poses') == '21', 'two seconds of it')
        a.publish(ros.to_path([], []))
        client.wait(lambda: client.value(
            'trajectory_a', 'refused: path without a usable pose') == '1', 'the count')
        assert client.value('trajectory_a', 'poses') == '21'
        a.publish(ros.to_path(stamps_ns, poses, 'elsewhere'))
        client.wait(lambda: client.value('trajectory_a', 'frame changes') == '1', 'the change')


def test_both_qualities_of_service_and_a_remapped_topic_match(tmp_path):
    arguments = ('-r', 'trajectory_a:=lidar_slam/odometry', '-p', 'topic_b:=visual_slam/pose')
    with ros.running(tmp_path, *TAYLOR, *arguments) as (node, client):
        a = client.publisher('lidar_slam/odometry', qos=ros.BEST_EFFORT)
        b = client.publisher('visual_slam/pose', 'PoseStamped')
        stamps_ns, poses_a, poses_b = ros.drive(poses=20)
        for stamp, pose_a, pose_b in zip(stamps_ns, poses_a, poses_b, strict=True):
            a.publish(ros.to_message('Odometry', stamp, pose_a))
            b.publish(ros.to_message('PoseStamped', stamp, pose_b))
        client.wait_for_poses(20, 20)
        log = node.log
    assert 'lidar_slam/odometry (best_effort)' in log
    assert 'visual_slam/pose (reliable)' in log


@pytest.mark.parametrize('arguments, topics', [
    (('-r', 'trajectory_a:=trajectory_b', '-r', 'trajectory_b:=trajectory_a'),
     ('trajectory_b', 'trajectory_a')),
    (('-p', 'topic_a:=slam', '-r', 'slam:=front', '-r', 'front:=rear'),
     ('front', 'trajectory_b')),
])
def test_a_name_is_remapped_once(tmp_path, arguments, topics):
    with ros.running(tmp_path, *TAYLOR, *arguments) as (_, client):
        publishers = [client.publisher(topic) for topic in topics]
        stamps_ns, poses_a, _ = ros.drive(poses=5)
        for publisher, sensor in zip(publishers, 'ab', strict=True):
            for stamp, pose in zip(stamps_ns, poses_a, strict=True):
                publisher.publish(ros.to_message('Odometry', stamp, pose, 'map', sensor))
        client.wait_for_poses(5, 5)
        for sensor, topic in zip('ab', topics, strict=True):
            assert client.value(f'trajectory_{sensor}', 'sensor_frame') == sensor
            status = client.status(f'trajectory_{sensor}')
            assert f'on {client.namespace}/{topic}: ' in status.message


def test_the_status_says_what_is_missing(tmp_path):
    with ros.running(tmp_path, '-p', 'type_b:=Odometry') as (_, client):
        client.wait(lambda: client.status('trajectory_a') is not None, 'diagnostics')
        client.wait(lambda: 'no publisher on' in client.status('trajectory_a').message, 'that')
        waiting = client.status('trajectory_a')
        # One participant cannot give a topic two types; two vehicles' worth of nodes can.
        other = ros.Client(client.domain, client.namespace)
        try:
            client.node.create_publisher(ros.TYPES['Odometry'], 'trajectory_a', 10)
            other.node.create_publisher(ros.TYPES['PoseStamped'], 'trajectory_a', 10)
            other.node.create_publisher(ros.TYPES['PoseStamped'], 'trajectory_b', 10)
            client.wait(lambda: 'set the type parameter' in client.status(
                'trajectory_a').message, 'two types')
            client.wait(lambda: 'the type parameter says nav_msgs/msg/Odometry' in client.status(
                'trajectory_b').message, 'the wrong type')
        finally:
            other.close()
    assert waiting.level == b'\x01'
    assert 'no publisher on' in waiting.message


def test_parameters_are_refused_or_taken_at_run_time(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        refused = [client.set_parameter(name, value) for name, value in (
            ('max_gap', -1.0), ('reference', 'B0'), ('solver', 'magic'), ('max_gap', 'long'),
            ('topic_a', 'elsewhere'), ('max_gaps', 1.0))]
        taken = [client.set_parameter(name, value) for name, value in (
            ('max_gap', 1), ('reference', 'B2'), ('frame_a', 'roof_lidar'))]
        client.publish_drive(*ros.drive())
        answer = client.call('calibrate')
        types = client.call('get_parameters', ros.GetParameters.Request(
            names=['max_gap', 'reference'])).values
    assert [result.successful for result in refused] == [False] * len(refused)
    assert all(result.reason for result in refused)
    assert 'needed' in refused[1].reason and 'taylor' in refused[2].reason
    assert all(result.successful for result in taken), taken
    assert answer.success and answer.message.startswith('roof_lidar -> camera')
    assert '98 motions of 100 poses' in answer.message
    assert types[0].integer_value == 1 and types[1].string_value == 'B2'


def test_a_prior_is_set_and_taken_out_one_parameter_at_a_time(tmp_path):
    height = ros.T_A_B[2, 3] + 0.01
    steps = [('prior_translation', f'-,-,{height}'), ('prior_translation_std', 0.001),
             ('prior_translation', f'-,-,{height}'), ('prior_rotation_std', '1'),
             ('prior_translation_std', ''), ('prior_translation', ''),
             ('prior_translation_std', '')]
    # A number in YAML, which ROS makes a double of.
    with ros.running(tmp_path, *DNL, '-p', 'prior_rotation_std:=0.5') as (_, client):
        client.publish_drive(*ros.drive(planar=True))
        results, answers = [], []
        for name, value in steps:
            results.append(client.set_parameter(name, value))
            answers.append(client.call('calibrate'))
    assert [result.successful for result in results] == [
        False, True, True, True, False, True, True]
    assert 'set prior_translation_std first' in results[0].reason
    # Flat ground leaves the height unobservable.
    assert [answer.success for answer in answers] == [
        False, False, True, True, True, False, False]


def test_results_are_saved_and_restored(tmp_path):
    folder = tmp_path / 'results'
    saving = (*TAYLOR, '-p', f'result_directory:={folder}')
    with ros.running(tmp_path, *saving) as (node, client):
        too_early = client.call('save')
        client.publish_drive(*ros.drive())
        answer = client.call('calibrate')
        again = client.call('save')
        (exports,) = (path for path in folder.iterdir() if path.is_dir())
        in_the_way = folder / exports.name.replace('_000002', '_000003')
        in_the_way.touch()
        half = client.call('save')
        (folder / f'{in_the_way.name}.yaml').unlink()
        client.wait(lambda: client.value('calibration', 'extrinsic'), 'the diagnostics')
        extrinsic_shown = client.value('calibration', 'extrinsic')
        node.stop()
    assert not too_early.success and 'nothing to save' in too_early.message
    assert not half.success
    assert half.message.startswith(
        f'saved in {in_the_way}.yaml; URDF and other exports: {in_the_way}')
    first, second = sorted(folder.glob('*.yaml'))
    assert answer.success
    # A line for each thing, apart even where `ros2 service call` prints a break as an escape.
    text, _, machine = answer.message.rpartition('\n')
    lines = text.split('\n - ')
    assert [line.partition(':')[0] for line in lines] == [
        'lidar -> camera', 'standard deviations', 'data', f'saved in {first}']
    assert all(len(line) < 120 for line in lines[:-1])
    # The last line is for programs.
    found = json.loads(machine)
    assert (found['frame_a'], found['frame_b']) == ('lidar', 'camera')
    assert np.allclose(found['translation_m'], ros.T_A_B[:3, 3], atol=1e-10)
    assert extrinsic_shown == lines[0]
    exports = second.with_suffix('')
    assert again.success
    assert again.message == f'saved in {second}; URDF and other exports in {exports}'
    assert 'lidar_to_camera' in (exports / 'extrinsic.urdf').read_text()
    # What a power cut may leave must not keep the vehicle from its last good result.
    second.write_text(second.read_text()[:100])
    # Files are named after the node: the same one finds its own.
    again = ros.running(
        tmp_path, *saving, '-p', 'restore:=true', namespace=client.namespace)
    with again as (node, late):
        extrinsic = late.latched()
        result = late.latched('trajectory_calibration/result', ros.String)
        late.wait(lambda: late.status('calibration') is not None, 'the diagnostics')
        assert late.status('calibration').level == b'\x01'
        assert 'is restored when poses of lidar and camera arrive' in late.status(
            'calibration').message
        assert not extrinsic
        late.publish_drive(*ros.drive(poses=3))
        late.wait(lambda: extrinsic and result, 'the restored extrinsic')
        late.wait(lambda: f'restored {first}' in node.log, 'the log')
        # It says what is missing for another answer, and which one is published.
        late.wait(lambda: late.status('calibration').message.startswith('waiting for motion'),
                  'the advice')
        assert late.value('calibration', 'extrinsic') == extrinsic_shown
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-10)
    assert extrinsic[0].child_frame_id == 'camera'
    assert json.loads(result[0].data)['frame_b'] == 'camera'


@pytest.mark.parametrize('given, restored', [('camera', True), ('camera_left', False)])
def test_a_result_of_other_frames_is_not_restored(tmp_path, given, restored):
    folder = tmp_path / 'results'
    arguments = (*TAYLOR, '-p', f'result_directory:={folder}')
    with ros.running(tmp_path, *arguments) as (_, client):
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
    # The frames are in the parameters: nothing needs to arrive.
    again = ros.running(
        tmp_path, *arguments, '-p', 'restore:=true', '-p', 'frame_a:=lidar', '-p',
        f'frame_b:={given}', namespace=client.namespace)
    with again as (node, late):
        extrinsic = late.latched()
        if restored:
            late.wait(lambda: extrinsic, 'the restored extrinsic')
            return
        late.wait(lambda: late.status('calibration') is not None, 'the diagnostics')
        status = late.status('calibration')
        sentence = ('holds lidar -> camera, the topics carry lidar and camera_left; correct the '
                    'topics')
        # However far the vehicle drives, the extrinsic that it needs is not there.
        late.publish_drive(*ros.drive())
        late.wait(lambda: int(late.value('calibration', 'motion_s')) >= 9, 'the motion')
        driven = late.status('calibration')
        assert not extrinsic
        assert late.call('calibrate').success
        late.wait(lambda: late.status('calibration').message == 'calibrated', 'the answer')
    assert sentence in node.log
    for said in (status, driven):
        assert said.level == b'\x01' and sentence in said.message


def test_clocks_that_differ_are_named_before_anybody_drives_in_vain(tmp_path):
    with ros.running(tmp_path, *TAYLOR) as (_, client):
        stamps_ns, poses_a, poses_b = ros.drive(poses=50)
        a, b = client.publisher('trajectory_a'), client.publisher('trajectory_b')
        for stamp, pose_a, pose_b in zip(stamps_ns, poses_a, poses_b, strict=True):
            a.publish(ros.to_message('Odometry', stamp, pose_a))
            b.publish(ros.to_message('Odometry', stamp + 3600 * 10**9, pose_b))
        client.wait_for_poses(50, 50)
        client.wait(lambda: 'apart' in client.value('calibration', 'advice'), 'the advice')
        advice = client.value('calibration', 'advice')
        client.set_parameter('time_offset', -3600.0)
        client.wait(lambda: client.value('calibration', 'overlap_s') == '4.900', 'the overlap')
        assert client.call('calibrate').success
    assert advice.startswith('the stamps of a and b are 3595.100 s apart')


def test_the_diagnostics_say_what_pairs_and_which_clock_offset_was_found(tmp_path):
    def values(client):
        return {v.key: v.value for v in client.status('calibration').values}

    with ros.running(tmp_path, *TAYLOR, '-p', 'time_offset:=0.2', '-p',
                     'time_offset_mode:=estimate') as (_, client):
        stamps_ns, poses_a, poses_b = ros.drive(poses=400, rate_hz=20.0)
        a, b = client.publisher('trajectory_a'), client.publisher('trajectory_b')
        for k, (stamp, pose_a, pose_b) in enumerate(
                zip(stamps_ns, poses_a, poses_b, strict=True)):
            if not 100 <= k < 130:
                a.publish(ros.to_message('Odometry', stamp, pose_a, 'map', 'lidar'))
            b.publish(ros.to_message('Odometry', stamp - 3 * 10**8, pose_b, 'odom', 'camera'))
        client.wait_for_poses(370, 400)
        client.wait(lambda: values(client)['association: pairs'] != '0', 'the pairs')
        before = values(client)
        answer = client.call('calibrate')
        assert answer.success, answer.message
        client.wait(lambda: values(client)['clock_offset_s'], 'the clock offset')
        after = values(client)
        client.call('reset')
        client.wait(lambda: not values(client)['clock_offset_s'], 'the reset')
    # With the setting, b begins two poses before a, and the gap of 1.55 s holds 30 of b.
    counts = [before[f'association: {name}'] for name in ('pairs', 'in gaps', 'outside')]
    assert counts == ['368', '30', '2']
    assert (before['time_offset'], before['clock_offset_s']) == ('0.2000', '')
    assert 'association of the last calibration' not in before
    assert float(after['clock_offset_s']) == pytest.approx(0.3, abs=2e-3)
    assert after['time_offset'] == '0.2000'
    assert ' pairs of 370 and 400 poses' in after['association of the last calibration']


def test_it_advises_and_calibrates_unasked_once_the_motion_is_enough(tmp_path):
    with ros.running(tmp_path, *TAYLOR, '-p', 'auto_calibrate:=true') as (node, client):
        extrinsic = client.latched()
        client.wait(lambda: client.status('calibration') is not None, 'the diagnostics')
        before = client.value('calibration', 'advice')
        client.publish_drive(*ros.drive(poses=300))
        client.wait(lambda: extrinsic, 'the extrinsic')
        client.wait(lambda: client.status('calibration').message == 'calibrated', 'the status')
        after = client.value('calibration', 'advice')
        client.call('reset')
        client.wait_for_poses(0, 0)
        assert node.log.count('enough motion') == 1
        assert client.status('calibration').message.startswith('waiting for motion')
        assert client.value('calibration', 'extrinsic')
    assert before.startswith('waiting for motion seen by both sensors: 0 s')
    assert after == 'enough motion: call ~/calibrate'
    assert len(extrinsic) == 1
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-10)


def test_on_flat_ground_it_calibrates_unasked_once_the_height_is_given(tmp_path):
    arguments = ('-p', 'auto_calibrate:=true', '-p', 'max_time_offset:=0.0')
    with ros.running(tmp_path, *arguments) as (_, client):
        extrinsic = client.latched()
        client.publish_drive(*ros.drive(poses=300, planar=True))
        client.wait(lambda: (client.value('calibration', 'advice') or '').startswith(
            'drive a ramp or a bank, or give prior_translation along z of lidar'), 'the advice')
        assert not extrinsic
        assert client.set_parameter('prior_translation_std', '0.005').successful
        height = f'-,-,{ros.T_A_B[2, 3]}'
        assert client.set_parameter('prior_translation', height).successful
        client.wait(lambda: extrinsic, 'the extrinsic')
    assert np.allclose(ros.matrix(extrinsic[0]), ros.T_A_B, atol=1e-4)


def test_the_monitor_warns_and_then_reports_an_error_when_a_sensor_was_moved(tmp_path):
    arguments = ('-p', 'monitor:=true', '-p', 'monitor_period:=1.0', '-p', 'max_time_offset:=0.0')
    with ros.running(tmp_path, *arguments) as (node, client):
        client.wait(lambda: client.status('monitor') is not None, 'the diagnostics')
        assert client.status('monitor').message.startswith('not checked yet')
        publishers = client.publish_drive(*ros.drive(poses=400))
        assert client.call('calibrate').success

        def shown(part, verdict, level):
            stamps_ns, poses_a, poses_b = ros.drive(poses=300, start_s=2000.0 * part, seed=part)
            if verdict == 'moved':
                poses_b = poses_b @ ros.se3.exp_se3([0.1, 0, 0, 0, 0, 0.1])
            for publisher, poses, (frame, child) in zip(
                    publishers, (poses_a, poses_b), (('map', 'lidar'), ('odom', 'camera')),
                    strict=True):
                for stamp, pose in zip(stamps_ns, poses, strict=True):
                    publisher.publish(ros.to_message('Odometry', stamp, pose, frame, child))
            client.wait(lambda: client.value('monitor', 'verdict') == verdict
                        and client.status('monitor').level == level, f'{verdict} at {level}')
        shown(1, 'holds', b'\x00')
        shown(2, 'moved', b'\x01')
        assert client.value('monitor', 'status') == '4'
        shown(3, 'moved', b'\x02')
        assert 'the published extrinsic: moved by ' in node.log


def test_a_node_without_saved_results_starts_all_the_same(tmp_path):
    arguments = ('-p', f'result_directory:={tmp_path}/new/results', '-p', 'restore:=true')
    with ros.running(tmp_path, *TAYLOR, *arguments) as (node, client):
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
        assert 'nothing restored: result_directory holds no result yet' in node.log


def test_the_log_says_within_seconds_which_topics_are_waited_for(tmp_path):
    with ros.running(tmp_path) as (node, client):
        a = client.publisher('trajectory_a')
        a.publish(ros.to_message('Odometry', 10**9, np.eye(4)))
        topic = f'{client.namespace}/trajectory_b'
        client.wait(lambda: all(words in node.log for words in (
            'waiting for trajectory_b', 'receiving ')), 'the log')
        log = node.log
    assert f'waiting for trajectory_b: no publisher on {topic}; start it' in log
    # It is said after three seconds, on a busy machine before the message of a is there.
    assert 'waiting for trajectory_a' not in log[log.index('receiving '):]


def test_messages_that_dds_lost_are_counted_and_shown():
    from trajectory_calibration.ros import topics
    with ros.connected() as client:
        subscription = topics.TrajectorySubscription(
            client.node, 'a', None, ros.PoseBuffer(ros.BufferLimits()), 10)
        for change in (3, 2):
            subscription._on_lost(SimpleNamespace(total_count_change=change))
        assert subscription.lost == 5
        monitor = ros.InputMonitor('a', ros.PoseBuffer(ros.BufferLimits()), 0.0, 'a')
        status = monitor.report(subscription.status, 1.0, subscription.lost)
    assert status.message.endswith('; 5 messages lost by DDS')
    assert {value.key: value.value for value in status.values}['messages lost'] == '5'
    assert status.hardware_id == 'a'


# Runs the node as its process does, with one list of arguments after the other.
STARTS = """
import json, sys
from trajectory_calibration.ros.run import main
for arguments in json.load(sys.stdin):
    sys.argv[1:] = ['--ros-args', *arguments]
    status = main(lambda: False)
    print(f'ended with {status}', file=sys.stderr, flush=True)
"""
REFUSED = [
    (('-p', 'max_gap:=-1.0'), 'max_gap is -1.0, needed 0 to 3600'),
    (('-p', 'solver:=magic'), "solver 'magic' is unknown"),
    (('-p', 'max_gaps:=1.0'), "parameter 'max_gaps' is unknown"),
    (('-p', 'type_a:=sensor_msgs/msg/Imu'), 'cannot be used as a trajectory'),
    (('-p', 'topic_a:=trajectory_b'), 'topic_a and topic_b are both'),
    (('-p', 'restore:=true'), 'restore needs result_directory'),
    (('-p', 'result_directory:=/proc/here'), 'result_directory /proc/here cannot be made'),
    (('-p', 'result_directory:=~nobody_here/x'), '~nobody_here/x names the home of nobody'),
    (('-p', 'topic_a:=a//b'), 'is not a name of a topic'),
    (('-p', 'frame_a:=[]'), 'if one is an empty list, correct it'),
    (('-p', os.fsdecode(b'frame_a:=\xff')), "can't encode character"),
    (('-p', 'use_sim_timer:=true'), "parameter 'use_sim_timer' is unknown"),
    (('-p', 'use_sim_time:=5'), 'use_sim_time is 5, needed true or false'),
    (('-p', 'use_sim_time:=maybe'), "use_sim_time is 'maybe', needed true or false"),
    (('-p', 'start_type_description_service:=maybe'),
     "start_type_description_service is 'maybe', needed true or false"),
    (('--params-file', 'nowhere.yaml'), 'nowhere.yaml'),
]


@pytest.fixture(scope='module')
def refusals(tmp_path_factory):
    """Return what the node said at each of these starts, and the status it ended with."""
    environment = {**os.environ, **ros.ENVIRONMENT, 'ROS_DOMAIN_ID': '1',
                   'ROS_LOG_DIR': str(tmp_path_factory.mktemp('log'))}
    done = subprocess.run(
        [sys.executable, '-c', STARTS], input=json.dumps([words for words, _ in REFUSED]),
        env=environment, capture_output=True, text=True, check=False, timeout=ros.LIMIT_S)
    *logs, rest = re.split(r'ended with (\S+)\n', done.stderr)
    assert (done.returncode, rest) == (0, ''), done.stderr
    return dict(zip((words for words, _ in REFUSED), zip(logs[::2], logs[1::2], strict=True),
                    strict=True))


@pytest.mark.parametrize('arguments, sentence', REFUSED)
def test_invalid_arguments_at_the_start_end_the_node_with_a_sentence(
        refusals, arguments, sentence):
    log, status = refusals[arguments]
    assert (status, 'Traceback' in log) == ('2', False), log
    assert sentence in log


@pytest.mark.parametrize('domain, arguments, sentence', [
    (1, ('-p', 'max_gap:=-1.0'), 'max_gap is -1.0, needed 0 to 3600'),
    (900, (), 'ROS_DOMAIN_ID is 900, needed 0 to 232'),
])
def test_a_refusal_is_the_status_of_the_process(tmp_path, domain, arguments, sentence):
    node = ros.NodeProcess(tmp_path, domain, '/test_start', arguments)
    try:
        assert node.process.wait(ros.LIMIT_S) == 2
    finally:
        node.process.kill()
    assert sentence in node.log
    assert 'Traceback' not in node.log


@pytest.mark.parametrize('number, times', [
    (signal.SIGINT, 1), (signal.SIGTERM, 1), (signal.SIGHUP, 1),
    pytest.param(signal.SIGINT, 50, marks=pytest.mark.slow),
    pytest.param(signal.SIGTERM, 50, marks=pytest.mark.slow)])
def test_signals_end_the_node_cleanly(tmp_path, number, times):
    for _ in range(times):
        with ros.running(tmp_path) as (node, client):
            client.wait(lambda client=client: client.status('calibration') is not None, 'the node')
            status, seconds = node.stop(number)
        assert (status, 'Traceback' in node.log) == (0, False), node.log
        assert seconds < 1.0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signals_that_go_on_change_nothing(tmp_path, number):
    with ros.running(tmp_path) as (node, client):
        client.wait(lambda: client.status('calibration') is not None, 'the node')
        # Through all of the end, of which Python's own is the last part.
        deadline_s = time.monotonic() + ros.LIMIT_S
        while node.process.poll() is None and time.monotonic() < deadline_s:
            node.process.send_signal(number)
            time.sleep(0.005)
    assert (node.process.returncode, 'Traceback' in node.log) == (0, False), node.log


def test_a_signal_while_solving_is_an_answer_and_leaves_no_process_behind(tmp_path):
    with ros.running(tmp_path, '-p', 'solver:=dnlo', '-p', 'reference:=B1') as (node, client):
        client.publish_drive(*ros.drive(poses=2000))
        pending = client.start_call('calibrate')
        children = []

        def solving():
            listing = subprocess.run(
                ['ps', '-o', 'pid=', '--ppid', str(node.process.pid)],
                capture_output=True, text=True, check=False).stdout
            children[:] = listing.split()
            return children
        client.wait(lambda: client.status('calibration').message.startswith('calibrating for'),
                    'the progress')
        client.wait(solving, 'the solver process')
        # Its CPU time would hold that of the solver.
        status, _ = node.stop()
        client.wait(pending.done, 'the answer')
    assert (status, 'Traceback' in node.log) == (0, False), node.log
    assert not pending.result().success
    assert pending.result().message == 'stopped: the node is shutting down'
    alive = subprocess.run(['ps', '-o', 'pid=', '-p', ','.join(children)],
                           capture_output=True, text=True, check=False).stdout
    assert alive.split() == []
