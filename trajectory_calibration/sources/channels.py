# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every container gives: channels, batches of their messages, and names of types."""

from __future__ import annotations

from typing import NamedTuple

_OLD_NAMES = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}


class Channel(NamedTuple):
    """A topic in a file: its name, its type, how many messages, how they are serialised."""

    topic: str
    msgtype: str
    messages: int
    encoding: str = 'cdr'


class Batch(NamedTuple):
    """Messages of one channel: times of reception in nanoseconds, and the serialised data."""

    channel: Channel
    received_ns: list[int]
    messages: list[bytes]


def plain_type(msgtype: str) -> str:
    """Return a type as ROS 2 names it: nav_msgs/Odometry as nav_msgs/msg/Odometry."""
    package, _, name = msgtype.partition('/')
    full = msgtype if '/' in name or not name else f'{package}/msg/{name}'
    return _OLD_NAMES.get(full, full)
