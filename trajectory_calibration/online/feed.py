# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a message to a pose in a buffer; the same for a topic and for a bag.

Nothing here imports ROS. Building a message object costs ten times what the rest of a callback
does, so the pose is read where it lies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.sources.cdr import parse_path, parse_pose, PATH

if TYPE_CHECKING:
    from trajectory_calibration.sources.topics import TopicTrack


class PoseFeed:
    """Puts the serialized messages of one topic, of a trajectory type, into a buffer."""

    def __init__(self, msgtype: str, buffer: PoseBuffer) -> None:
        self._msgtype, self._buffer = msgtype, buffer

    def __call__(self, message: bytes) -> None:
        """Take one message; what is wrong with it is counted by the buffer."""
        if self._msgtype != PATH:
            sample = parse_pose(message, self._msgtype)
            if sample is not None:
                self._buffer.append(*sample)
                return
        elif (path := parse_path(message)) is not None:
            self._buffer.replace(path.stamps_ns, path.poses, path.frames)
            return
        self._buffer.count_unreadable()


def feed_track(track: TopicTrack, buffer: PoseBuffer) -> None:
    """Put what a bag holds of a topic into a buffer, message by message as the node would."""
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
