# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""TF as an input and as an output, where tf2_msgs is installed; what is said where it is not."""

import importlib.util
import itertools

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

from trajectory_calibration.geometry import se3

TF2 = importlib.util.find_spec('tf2_msgs') is not None
pytestmark = [needs_ros, pytest.mark.ros]
needs_tf2 = pytest.mark.skipif(not TF2, reason='tf2_msgs is missing')

TAYLOR = ('-p', 'solver:=taylor')
PUBLISH = (*TAYLOR, '-p', 'publish_tf:=true')


class Tf:
    """Publishes transforms as the nodes of a vehicle do."""

    def __init__(self, client):
        from tf2_msgs.msg import TFMessage
        self.message, self.client = TFMessage, client
        latched = ros.QoSProfile(depth=100, durability=ros.DurabilityPolicy.TRANSIENT_LOCAL)
        self._static = client.node.create_publisher(TFMessage, '/tf_static', latched)
        self._moving = client.node.create_publisher(TFMessage, '/tf', 1000)
        self._statics, self._found = [], False

    def wait_for_listener(self, publisher):
        """Wait until the node and the publisher have found each other."""
        self.client.wait(lambda: publisher.get_subscription_count() > 0, 'the listener')
        self.client.meet()

    def static(self, parent, child, T):
        self.wait_for_listener(self._static)
        self._statics.append(ros.to_transform(0, T, parent, child))
        self._static.publish(self.message(transforms=self._statics))

    def moving(self, stamp_ns, *edges):
        if not self._found:
            self.wait_for_listener(self._moving)
            self._found = True
        self._moving.publish(self.message(transforms=[
            ros.to_transform(stamp_ns, T, parent, child) for parent, child, T in edges]))


@pytest.mark.skipif(TF2, reason='tf2_msgs is installed')
@pytest.mark.parametrize('argument, what', [
    ('publish_tf:=true', 'publish_tf'), ('topic_a:=tf:map.base_link', 'a topic tf:PARENT.CHILD')])
def test_without_tf2_msgs_the_start_is_refused_with_the_command(tmp_path, argument, what):
    node = ros.NodeProcess(tmp_path, 1, '/test_start', ('-p', argument))
    try:
        assert node.process.wait(ros.LIMIT_S) == 2
    finally:
        node.process.kill()
    assert f'{what} needs tf2_msgs: tf2_msgs is not installed; sudo apt install' in node.log
    assert 'Traceback' not in node.log


@needs_tf2
def test_the_latest_extrinsic_is_on_tf_static(tmp_path):
    with ros.running(tmp_path, *PUBLISH) as (_, client):
        tf = Tf(client)
        heard = client.latched('/tf_static', tf.message)
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
        client.wait(lambda: heard, 'the transform')
        answer = client.call('calibrate')
        client.wait(lambda: len(heard) == 2, 'two transforms')
    latest = heard[-1].transforms[0]
    assert (latest.header.frame_id, latest.child_frame_id) == ('lidar', 'camera')
    assert np.allclose(ros.matrix(latest), ros.T_A_B, atol=1e-10)
    assert '\n - on /tf_static: lidar -> camera\n' in answer.message


@needs_tf2
@pytest.mark.parametrize('edges, published, words', [
    ((('base_link', 'camera'),), ('base_link', 'lidar'), 'already has the parent base_link'),
    ((('base_link', 'lidar'), ('base_link', 'camera')), None,
     'the vehicle already connects lidar and camera'),
])
def test_no_frame_gets_a_second_parent(tmp_path, edges, published, words):
    with ros.running(tmp_path, *PUBLISH) as (node, client):
        tf = Tf(client)
        for k, (parent, child) in enumerate(edges):
            tf.static(parent, child, se3.exp_se3(np.full(6, 0.1 + 0.1 * k)))
        heard = client.latched('/tf_static', tf.message)
        client.publish_drive(*ros.drive())
        answer = client.call('calibrate')
        client.wait(lambda: words in (client.value('calibration', 'tf') or ''), words)
        today = client.value('calibration', 'vehicle_today')
        again = client.call('calibrate')
        client.spin(0.5)
        new = [(item.header.frame_id, item.child_frame_id, item)
               for message in heard for item in message.transforms
               if (item.header.frame_id, item.child_frame_id) not in edges]
    assert answer.success, answer.message
    assert 'Traceback' not in node.log
    if published is None:
        assert not new
        assert today.startswith("differs from the vehicle's own transform lidar -> camera by ")
        assert today in again.message
        return
    assert {item[:2] for item in new} == {published}
    T_base_camera = se3.exp_se3(np.full(6, 0.1))
    assert np.allclose(
        se3.inverse(ros.matrix(new[-1][2])) @ T_base_camera, ros.T_A_B, atol=1e-10)


@needs_tf2
def test_a_name_that_nobody_gave_never_reaches_tf(tmp_path):
    with ros.running(tmp_path, *PUBLISH) as (_, client):
        tf = Tf(client)
        heard = client.latched('/tf_static', tf.message)
        client.publish_drive(*ros.drive(), types=('Odometry', 'PoseStamped'))
        assert client.call('calibrate').success
        client.wait(lambda: 'set frame_b' in client.value('calibration', 'tf'), 'the reason')
        assert not heard


@needs_tf2
def test_a_chain_of_transforms_gives_the_answer_of_the_odometry(tmp_path):
    stamps_ns, poses_a, poses_b = ros.drive(poses=200)
    rng = np.random.default_rng(2)
    odom_drift = se3.exp_se3(np.cumsum(rng.normal(size=(200, 6)) * 0.01, axis=0))
    answers = []
    for topic in ('trajectory_a', 'tf:map.base_link'):
        with ros.running(tmp_path, *TAYLOR, '-p', f'topic_a:={topic}', '-p', 'frame_a:=base_link',
                         '-p', 'max_time_offset:=0.0') as (_, client):
            b = client.publisher('trajectory_b')
            if topic == 'trajectory_a':
                a = client.publisher(topic)
            else:
                tf = Tf(client)
            for k, stamp in enumerate(stamps_ns):
                T_map_base = poses_a[k]
                if topic == 'trajectory_a':
                    a.publish(ros.to_message('Odometry', stamp, T_map_base, 'map', 'base_link'))
                else:
                    T_map_odom = T_map_base @ se3.inverse(odom_drift[k])
                    tf.moving(stamp, ('map', 'odom', T_map_odom),
                              ('odom', 'base_link', odom_drift[k]))
                b.publish(ros.to_message('Odometry', stamp, poses_b[k], 'odom', 'camera'))
            client.wait_for_poses(200, 200)
            extrinsic = client.latched()
            answer = client.call('calibrate')
            assert answer.success, answer.message
            client.wait(lambda extrinsic=extrinsic: extrinsic, 'the extrinsic')
            answers.append(ros.matrix(extrinsic[0]))
            if topic != 'trajectory_a':
                assert 'tf:map.base_link from /tf' in client.status('trajectory_a').message
    assert np.abs(answers[0] - answers[1]).max() < 1e-9
    assert np.allclose(answers[0], ros.T_A_B, atol=1e-9)


@needs_tf2
def test_a_bag_of_transforms_that_loops_starts_anew_and_bad_ones_are_counted(tmp_path):
    stamps_ns, poses_a, _ = ros.drive(poses=100)
    with ros.running(tmp_path, '-p', 'topic_a:=tf:map.base_link') as (_, client):
        tf = Tf(client)
        client.wait(lambda: client.node.count_subscribers('/tf') > 0, 'the listener')
        client.spin(0.5)
        far = np.eye(4)
        far[0, 3] = 2e9
        for count, poses in ((100, poses_a), (60, poses_a[:60])):
            for stamp, pose in zip(stamps_ns, poses, strict=False):
                tf.moving(stamp, ('map', 'base_link', pose))
            tf.moving(stamps_ns[count - 1] + 1, ('map', 'base_link', far))
            client.wait(lambda count=count: client.value(
                'trajectory_a', 'poses') == str(count), 'the poses')
        assert client.value('trajectory_a', 'clock jumps') == '1'
        assert client.value('trajectory_a', 'refused: too far away') == '2'
        assert client.call('reset').success
        for stamp, pose in zip(stamps_ns, poses_a, strict=True):
            tf.moving(stamp, ('map', 'base_link', pose))
        client.wait(lambda: client.value('trajectory_a', 'poses') == '100', 'the poses again')
        assert client.value('trajectory_a', 'clock jumps') == '0'


@needs_tf2
def test_static_transforms_of_many_senders_that_come_at_once_are_all_heard(tmp_path):
    names = ['base_link', *(f'link_{k}' for k in range(300))]
    with ros.running(tmp_path, '-p', f'topic_a:=tf:map.{names[-1]}') as (_, client):
        tf = Tf(client)
        latched = ros.QoSProfile(depth=1000, durability=ros.DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = client.node.create_publisher(tf.message, '/tf_static', latched)
        for parent, child in itertools.pairwise(names):
            publisher.publish(tf.message(transforms=[
                ros.to_transform(0, np.eye(4), parent, child)]))
        stamps_ns, poses, _ = ros.drive(poses=20)
        for stamp, pose in zip(stamps_ns, poses, strict=True):
            tf.moving(stamp, ('map', 'base_link', pose))
        client.wait(lambda: client.value('trajectory_a', 'poses') == '20', 'the poses')


@needs_tf2
def test_what_a_chain_waits_for_is_in_the_diagnostics(tmp_path):
    with ros.running(tmp_path, '-p', 'topic_a:=tf:map.base_link') as (_, client):
        tf = Tf(client)
        client.wait(lambda: client.status('trajectory_a') is not None, 'the diagnostics')

        def missing():
            tf.moving(10**9, ('map', 'odom', np.eye(4)))
            client.spin(0.1)
            return 'no frame base_link' in client.status('trajectory_a').message
        client.wait(missing, 'the missing link')
        assert client.status('trajectory_a').level == b'\x01'


@pytest.mark.skipif(importlib.util.find_spec('tf2_py') is None, reason='tf2_ros is missing')
def test_a_tf2_listener_finds_the_extrinsic(tmp_path):
    from rclpy.time import Time
    from tf2_ros import Buffer, TransformListener
    with ros.running(tmp_path, *PUBLISH) as (_, client):
        Tf(client).static('base_link', 'camera', se3.exp_se3(np.full(6, 0.1)))
        buffer = Buffer()
        listener = TransformListener(buffer, client.node)
        client.publish_drive(*ros.drive())
        assert client.call('calibrate').success
        client.wait(lambda: buffer.can_transform('lidar', 'camera', Time()), 'the transform')
        found = buffer.lookup_transform('lidar', 'camera', Time())
        del listener
    assert np.allclose(ros.matrix(found), ros.T_A_B, atol=1e-9)
