# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Put serialized messages, from a topic or a bag, into a buffer.

Nothing here imports ROS. Building a message object costs ten times as much as the rest of a
callback, so the pose is parsed from the bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.sources.cdr import parse_path, parse_pose, PATH

if TYPE_CHECKING:
    from trajectory_calibration.sources.topics import TopicTrack


def feed_message(msgtype: str, buffer: PoseBuffer, message: bytes) -> None:
    """Put a serialized message of a trajectory type into a buffer; count it if it is damaged."""
    if msgtype == PATH:
        if (path := parse_path(message)) is not None:
            buffer.replace(path.stamps_ns, path.poses, path.frames)
            return
    elif (sample := parse_pose(message, msgtype)) is not None:
        buffer.append(*sample)
        return
    buffer.count_unreadable()


def feed_track(track: TopicTrack, buffer: PoseBuffer) -> None:
    """Put the track of a topic in a bag into a buffer, message by message as in the node."""
    for _ in range(track.unreadable):
        buffer.count_unreadable()
    buffer.count_refused(track.refused)
    if track.msgtype == PATH:
        # Each path replaces the one before; the track is the last one.
        frames = track.frames[0] if track.frames else ('', '')
        buffer.replace(track.stamps_ns, track.poses, frames)
        return
    frames_of_messages = [track.frames[k] for k in track.frame_index.tolist()]
    for sample in zip(track.stamps_ns.tolist(), frames_of_messages,
                      map(tuple, track.poses.tolist()), strict=True):
        buffer.append(*sample)
