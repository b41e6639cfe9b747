# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is subscribed to, for what publishers offer."""

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer

pytestmark = [needs_ros, pytest.mark.ros]
if ros is not None:
    from trajectory_calibration.ros import messages, topics

DEPTH = 5000


def offer(type_name='Odometry', *, reliable=True, latched=False):
    """Return the type and the profile of a publisher."""
    reliability, durability = topics.ReliabilityPolicy, topics.DurabilityPolicy
    return type_name, topics.QoSProfile(
        depth=1,
        reliability=reliability.RELIABLE if reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if latched else durability.VOLATILE)


def known(publishers):
    """Return what tells publishers apart: types, reliabilities and durabilities."""
    return sorted((type_name.rpartition('/')[2], profile.reliability, profile.durability)
                  for type_name, profile in publishers)


def wait_for(client, offered):
    """Wait until a client sees these publishers, and no others."""
    client.wait(lambda: known(offered) == known(
        (info.topic_type, info.qos_profile)
        for info in client.node.get_publishers_info_by_topic('a')), 'the publishers')


def subscribed(*offers):
    """Return what is subscribed with while these are offered, one list after the other."""
    with (ros.connected() as client,
          ros.connected(client.namespace, client.domain) as vehicle):
        subscription = topics.TrajectorySubscription(
            client.node, 'a', None, PoseBuffer(BufferLimits()), DEPTH)
        assert subscription.status.text == f'waiting for a publisher on {client.namespace}/a'
        publishers, subscriptions = [], []
        for offered in offers:
            for publisher in publishers:
                vehicle.node.destroy_publisher(publisher)
            publishers = [vehicle.node.create_publisher(ros.TYPES[type_name], 'a', profile)
                          for type_name, profile in offered]
            wait_for(client, offered)
            subscription.update()
            assert subscription.status.ready
            (current,) = (item for item in client.node.subscriptions
                          if item.topic_name == f'{client.namespace}/a')
            if current not in subscriptions:
                subscriptions.append(current)
        return [item.qos_profile for item in subscriptions]


@pytest.mark.parametrize('type_name, depth', [('Odometry', DEPTH), ('Path', 1)])
def test_poses_wait_while_the_node_is_busy_and_of_paths_only_the_newest(type_name, depth):
    (profile,) = subscribed([offer(type_name)])
    assert profile.depth == depth


@pytest.mark.parametrize('type_name, expected', [
    ('Odometry', ['TRANSIENT_LOCAL', 'VOLATILE']),
    ('Path', ['TRANSIENT_LOCAL', 'VOLATILE', 'TRANSIENT_LOCAL'])])
def test_what_publishers_keep_is_asked_for_once_unless_it_is_a_path(type_name, expected):
    latched, other = offer(type_name, latched=True), offer(type_name)
    profiles = subscribed([latched], [latched, latched], [latched, other], [latched])
    assert [profile.durability.name for profile in profiles] == expected


def test_another_reliability_asks_for_nothing_twice_and_another_type_does():
    best_effort = offer(latched=True, reliable=False)
    profiles = subscribed([offer(latched=True)], [best_effort], [offer('Path', latched=True)])
    assert [(profile.reliability.name, profile.durability.name) for profile in profiles] == [
        ('RELIABLE', 'TRANSIENT_LOCAL'), ('BEST_EFFORT', 'VOLATILE'),
        ('RELIABLE', 'TRANSIENT_LOCAL')]


def test_what_waits_is_taken_at_one_wake():
    # To wake costs ten times what a pose does.
    taken, woken = [], 0
    with ros.connected() as client:
        messages.subscribe(client.node, ros.TYPES['PoseStamped'], 'a', taken.append,
                           topics.QoSProfile(depth=40))
        publisher = client.publisher('a', 'PoseStamped')
        for stamp_ns in range(1, 101):
            publisher.publish(ros.to_message('PoseStamped', stamp_ns, np.eye(4)))
        while len(taken) < 40:
            before = len(taken)
            client.executor.spin_once(timeout_sec=1.0)
            woken += len(taken) > before
    # As many as the queue holds, the newest ones.
    newest = ros.serialize_message(ros.to_message('PoseStamped', 100, np.eye(4)))
    assert (woken, len(taken), taken[-1]) == (1, 40, newest)
