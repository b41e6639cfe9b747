# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the node. Message type and quality of service are taken from the publishers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from rclpy.event_handler import QoSMessageLostInfo
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.online.feed import feed_message
from trajectory_calibration.ros.frames import VehicleTransforms
from trajectory_calibration.ros.messages import MESSAGE_TYPES, subscribe
from trajectory_calibration.sources.cdr import PATH
from trajectory_calibration.sources.transforms import ChainFollower


class TopicStatus(NamedTuple):
    """The state of one input in words."""

    text: str
    # Whether messages can arrive, and what to check even then.
    ready: bool = False
    doubt: str = ''


class TrajectorySubscription:
    """One input of the node: subscribes to a topic and fills a buffer.

    ``msgtype`` None selects the type of the publishers. ``depth`` is the queue depth, for Paths
    1. ``lost`` counts the messages reported as lost by DDS.
    """

    def __init__(
        self, node: Node, topic: str, msgtype: str | None, buffer: PoseBuffer, depth: int,
    ) -> None:
        # ROS remaps the given name itself, so it gets the original; messages show the resolved.
        self._node, self._name, self._wanted = node, topic, msgtype
        self._topic = resolve_topic(node, topic)
        self._buffer, self._depth = buffer, depth
        self._msgtype: str | None = None
        self._profile: QoSProfile | None = None
        self._subscription: Subscription | None = None
        self.lost = 0
        self.status = TopicStatus(f'waiting for a publisher on {self._topic}')

    def update(self) -> None:
        """Subscribe, or subscribe again, if the publishers require it."""
        publishers = self._node.get_publishers_info_by_topic(self._name)
        if not publishers:
            self.status = TopicStatus(
                f'no publisher on {self._topic}; start it, or correct the topic')
            return
        offered = sorted({publisher.topic_type for publisher in publishers})
        msgtype = self._wanted or self._only_type(offered)
        if msgtype is None:
            return
        if msgtype not in offered:
            self.status = TopicStatus(
                f'{self._topic} carries {" and ".join(offered)}, the type parameter says '
                f'{msgtype}; correct it, or set auto')
            return
        profile = self._choose_profile(
            msgtype, [publisher for publisher in publishers if publisher.topic_type == msgtype])
        if msgtype != self._msgtype or profile != self._profile:
            self._subscribe(msgtype, profile)
        self.status = TopicStatus(
            f'{msgtype} on {self._topic}', ready=True, doubt=_doubt(publishers))

    def _choose_profile(
        self, msgtype: str, publishers: Sequence[TopicEndpointInfo],
    ) -> QoSProfile:
        # Each Path replaces the previous one, so queued ones only cost memory and time.
        profile = _matching_profile(publishers, 1 if msgtype == PATH else self._depth)
        if msgtype != self._msgtype or msgtype == PATH or self._profile is None:
            return profile
        # Messages kept for late subscribers were received already. Received again, they would
        # look like a clock jump. A volatile subscription matches such publishers, too.
        if (profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                and profile.reliability == self._profile.reliability):
            return self._profile
        profile.durability = DurabilityPolicy.VOLATILE
        return profile

    def _on_lost(self, event: QoSMessageLostInfo) -> None:
        self.lost += event.total_count_change

    def _only_type(self, offered: Sequence[str]) -> str | None:
        """Return the only usable type, or None with the reason in the status."""
        usable = [name for name in offered if name in MESSAGE_TYPES]
        if len(usable) == 1:
            return usable[0]
        carries = f'{self._topic} carries {" and ".join(offered)}'
        self.status = TopicStatus(
            f'{carries}; set the type parameter to one of them' if usable else
            f'{carries}, which holds no trajectory; needed one of {", ".join(MESSAGE_TYPES)}')
        return None

    def _subscribe(self, msgtype: str, profile: QoSProfile) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        if self._msgtype is not None and msgtype != self._msgtype:
            # Another message type is another source, whose poses do not continue the old ones.
            self._buffer.clear()
        self._msgtype, self._profile = msgtype, profile
        self._subscription = subscribe(
            self._node, MESSAGE_TYPES[msgtype], self._name,
            partial(feed_message, msgtype, self._buffer), profile, self._on_lost)
        self._node.get_logger().info(
            f'receiving {msgtype} on {self._topic} ({profile.reliability.name.lower()})')


class TransformSubscription:
    """One input of the node that is a pair of frames of /tf, ``tf:map.base_link``."""

    # Lost messages of /tf are not counted.
    lost = 0

    def __init__(
        self, name: str, frames: tuple[str, str], transforms: VehicleTransforms,
        buffer: PoseBuffer,
    ) -> None:
        self._name, self._frames, self._buffer = name, frames, buffer
        self._transforms = transforms
        self._follower = ChainFollower(*frames)
        transforms.followers.append(self._follower)
        self.status = TopicStatus(f'waiting for {name}')

    def update(self) -> None:
        """Append the new poses since the last call to the buffer."""
        self._transforms.update()
        stamps_ns, poses, refused = self._follower.take()
        self._buffer.count_refused(refused)
        rows = np.hstack([poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3])])
        for stamp_ns, pose in zip(stamps_ns.tolist(), map(tuple, rows.tolist()), strict=True):
            self._buffer.append(stamp_ns, self._frames, pose)
        waiting = self._follower.waiting_for
        self.status = (TopicStatus(f'{self._name}: {waiting}') if waiting else
                       TopicStatus(f'{self._name} from /tf', ready=True))


def resolve_topic(node: Node, topic: str) -> str:
    """Return the full name of a topic after remapping; raise ConfigError if it is invalid."""
    try:
        return node.resolve_topic_name(topic)
    except RuntimeError as error:
        raise ConfigError(f'{topic!r} is not a name of a topic: {error}') from error


def _doubt(publishers: Sequence[TopicEndpointInfo]) -> str:
    """Return a question if there are several publishers: two mixed odometries look like jumps."""
    if len(publishers) < 2:
        return ''
    nodes = sorted(f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'
                   for publisher in publishers)
    return (f'{len(publishers)} publishers ({", ".join(nodes)}): are they the same sensor, with '
            'the same origin? If not, give each its own topic')


def _matching_profile(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strongest profile that all publishers offer: reliable, transient local."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(item.reliability == ReliabilityPolicy.RELIABLE for item in profiles)
    latched = all(item.durability == DurabilityPolicy.TRANSIENT_LOCAL for item in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
