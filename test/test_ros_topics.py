"""What is subscribed to, for what publishers offer."""

from types import SimpleNamespace

import pytest

from trajectory_calibration.ros.buffer import BufferLimits, PoseBuffer

topics = pytest.importorskip(
    'trajectory_calibration.ros.topics',
    reason='rclpy is missing: source ROS 2 Jazzy or install ros-jazzy-rclpy')

ODOMETRY, PATH = 'nav_msgs/msg/Odometry', 'nav_msgs/msg/Path'
DEPTH = 5000


class Graph:
    """A node whose publishers are made up; it notes what is subscribed to."""

    def __init__(self):
        self.publishers, self.profiles = [], []

    def get_publishers_info_by_topic(self, _topic):
        return self.publishers

    def resolve_topic_name(self, topic):
        return topic

    def create_subscription(self, _type, _topic, _callback, profile, **_options):
        self.profiles.append(profile)

    def destroy_subscription(self, _subscription):
        pass

    def get_logger(self):
        return SimpleNamespace(info=lambda _text: None)


def offer(msgtype=ODOMETRY, *, reliable=True, latched=False):
    """Return what a publisher is known by."""
    reliability, durability = topics.ReliabilityPolicy, topics.DurabilityPolicy
    return SimpleNamespace(topic_type=msgtype, qos_profile=topics.QoSProfile(
        depth=1,
        reliability=reliability.RELIABLE if reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if latched else durability.VOLATILE))


def subscribed(*offers):
    """Return what is subscribed with while these are offered, one list after the other."""
    graph = Graph()
    subscription = topics.TrajectorySubscription(
        graph, '/a', None, PoseBuffer(BufferLimits()), DEPTH)
    for graph.publishers in offers:
        subscription.update()
        assert subscription.status.ready
    return graph.profiles


@pytest.mark.parametrize('msgtype, depth', [(ODOMETRY, DEPTH), (PATH, 1)])
def test_poses_wait_while_the_node_is_busy_and_of_paths_only_the_newest(msgtype, depth):
    (profile,) = subscribed([offer(msgtype)])
    assert profile.depth == depth


@pytest.mark.parametrize('msgtype, expected', [
    (ODOMETRY, ['TRANSIENT_LOCAL', 'VOLATILE']),
    (PATH, ['TRANSIENT_LOCAL', 'VOLATILE', 'TRANSIENT_LOCAL'])])
def test_what_publishers_keep_is_asked_for_once_unless_it_is_a_path(msgtype, expected):
    latched, other = offer(msgtype, latched=True), offer(msgtype)
    profiles = subscribed([latched], [latched, latched], [latched, other], [latched])
    assert [profile.durability.name for profile in profiles] == expected


def test_another_reliability_asks_for_nothing_twice_and_another_type_does():
    best_effort = offer(latched=True, reliable=False)
    profiles = subscribed([offer(latched=True)], [best_effort], [offer(PATH, latched=True)])
    assert [(profile.reliability.name, profile.durability.name) for profile in profiles] == [
        ('RELIABLE', 'TRANSIENT_LOCAL'), ('BEST_EFFORT', 'VOLATILE'),
        ('RELIABLE', 'TRANSIENT_LOCAL')]
