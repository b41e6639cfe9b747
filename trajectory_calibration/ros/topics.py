"""A subscription that finds its type and its quality of service from the publishers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.ros.buffer import PoseBuffer
from trajectory_calibration.ros.conversions import Reader, READERS


@dataclass(frozen=True)
class TopicStatus:
    """What a person should know about one input.

    Attributes
    ----------
    text : one sentence.
    ready : whether messages can arrive.

    """

    text: str
    ready: bool = False


class TrajectorySubscription:
    """One input of the node: watches a topic and fills a buffer from it.

    Parameters
    ----------
    node : Node
        That subscribes.
    topic : str
        As in the parameter; remapped by ROS.
    reader : Reader or None
        The type to subscribe to; None takes what the publishers offer.
    buffer : PoseBuffer
        That takes the poses.
    depth : int
        Messages that may wait while the node is busy.

    Raises
    ------
    ConfigError
        ``topic`` is not a name that ROS accepts.

    """

    def __init__(
        self, node: Node, topic: str, reader: Reader | None, buffer: PoseBuffer, depth: int,
    ) -> None:
        self._node = node
        self._topic = topic
        self._wanted = reader
        self._buffer = buffer
        self._depth = depth
        self._reader: Reader | None = None
        self._profile: QoSProfile | None = None
        self._subscription: Subscription | None = None
        try:
            self.topic = node.resolve_topic_name(topic)
        except RuntimeError as error:
            raise ConfigError(f'{topic!r} is not a name of a topic: {error}') from error
        self.status = TopicStatus(f'waiting for a publisher on {self.topic}')

    def update(self) -> None:
        """Look at the publishers and subscribe, or subscribe anew, as they require."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if not publishers:
            self.status = TopicStatus(
                f'no publisher on {self.topic}; start it, or set or remap the topic')
            return
        offered = sorted({publisher.topic_type for publisher in publishers})
        reader = self._wanted or self._only_reader(offered)
        if reader is None:
            return
        if reader.name not in offered:
            self.status = TopicStatus(
                f'{self.topic} carries {" and ".join(offered)}, the parameter says '
                f'{reader.name}; correct it or set auto')
            return
        profile = _matching_profile(
            [publisher for publisher in publishers if publisher.topic_type == reader.name],
            self._depth)
        if reader is not self._reader or profile != self._profile:
            self._subscribe(reader, profile)
        several = f' from {len(publishers)} publishers' if len(publishers) > 1 else ''
        self.status = TopicStatus(f'{reader.name} on {self.topic}{several}', ready=True)

    def _only_reader(self, offered: Sequence[str]) -> Reader | None:
        """Return the reader of the one usable type on offer, or say in the status why not."""
        usable = [READERS[name] for name in offered if name in READERS]
        if len(usable) == 1:
            return usable[0]
        carries = f'{self.topic} carries {" and ".join(offered)}'
        self.status = TopicStatus(
            f'{carries}; set the type parameter to one of them' if usable else
            f'{carries}, which is no trajectory; needed one of {", ".join(READERS)}')
        return None

    def _subscribe(self, reader: Reader, profile: QoSProfile) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        if self._reader is not None and reader is not self._reader:
            # Another kind of message is another source: its poses do not continue the old ones.
            self._buffer.clear()
        self._reader, self._profile = reader, profile
        read, buffer = reader.read, self._buffer
        self._subscription = self._node.create_subscription(
            reader.message_type, self._topic, lambda message: read(message, buffer), profile)
        self._node.get_logger().info(
            f'receiving {reader.name} on {self.topic} ({profile.reliability.name.lower()})')


def _matching_profile(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the most that all publishers offer: reliable, and what they keep for latecomers."""
    reliable = all(
        publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        for publisher in publishers)
    latched = all(
        publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        for publisher in publishers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
