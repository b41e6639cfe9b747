# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories in bags: rosbag2 (sqlite3, mcap, compressed or not) and ROS 1.

The intact messages of a damaged bag are used; a note gives the number of missing ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, replace
import os
from pathlib import Path

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import counted, SourceError, TopicError
from trajectory_calibration.sources.cdr import TF, TRAJECTORY_TYPES
from trajectory_calibration.sources.channels import Channel, Unreadable
from trajectory_calibration.sources.overlaps import without_repeats
from trajectory_calibration.sources.storage import Bag, find_bag, unpacked
from trajectory_calibration.sources.topics import (
    join_tracks,
    TopicCollector,
    TopicTrack,
    transform_track,
    transform_tree,
)
from trajectory_calibration.sources.transforms import names_frames, TransformTree

# Arguments: messages read so far, messages expected.
Progress = Callable[[int, int], None]

# Topic -> the bag and the messages of each file.
_Found = dict[str, list[tuple[Bag, TopicCollector]]]

_READABLE = ('cdr', 'ros1')


@dataclass(frozen=True)
class BagSource:
    """A topic of one or several bags as a trajectory.

    Attributes
    ----------
    bags : bag folders or files, of ROS 1, ROS 2, or both.
    topic : of type Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped or Path;
        or ``tf:PARENT.CHILD``, the pose of CHILD in PARENT from the transforms of the bag.
    sensor_frame, world_frame : override the names in the messages.

    """

    bags: Sequence[str | os.PathLike[str]]
    topic: str
    sensor_frame: str | None = None
    world_frame: str | None = None

    def load(self) -> Trajectory:
        """Read the topic.

        Raise SourceError if a bag cannot be read or the topic has fewer than two usable poses;
        TopicError if it does not exist or is no trajectory. The message lists the usable topics.
        """
        with open_bags(self.bags) as reader:
            track = reader.read([self.topic])[self.topic]
        return track.to_trajectory(self.sensor_frame, self.world_frame)


@contextmanager
def open_bags(paths: Iterable[str | os.PathLike[str]]) -> Iterator[BagReader]:
    """Open several bags together; they close with the ``with`` statement.

    Raise SourceError if a path is no bag, or none of the files can be read.
    """
    # A shell pattern can match the same bag twice.
    once = {os.path.realpath(path): Path(path) for path in paths}
    bags = [find_bag(path) for path in once.values()]
    with ExitStack() as stack:
        for bag in bags:
            bag.open(stack)
        yield BagReader(bags)


class BagReader:
    """Several open bags.

    Attributes
    ----------
    channels : topics, types and message counts over all bags, sorted by name.

    """

    def __init__(self, bags: list[Bag]) -> None:
        self._bags = bags
        if all(isinstance(storage, Unreadable) for bag in bags for storage in bag.files.values()):
            raise SourceError(
                f'{"; ".join(self.notes)}: nothing in it can be read; copy it again from where it '
                'was recorded, or record again')
        counts: Counter[Channel] = Counter()
        for bag in bags:
            for channel in bag.channels():
                counts[channel._replace(messages=0)] += channel.messages
        self.channels = [channel._replace(messages=counts[channel]) for channel in sorted(counts)]

    @property
    def notes(self) -> list[str]:
        """Return the damage found in the bags so far."""
        return [note for bag in self._bags for note in bag.all_notes()]

    @property
    def serving(self) -> list[str]:
        """Return the topics that can be used as a trajectory."""
        topics = dict.fromkeys(channel.topic for channel in self.channels)
        return [topic for topic in topics if not self._fault(topic)]

    def read(
        self, names: Sequence[str], progress: Progress | None = None,
    ) -> dict[str, TopicTrack]:
        """Read topics and ``tf:PARENT.CHILD`` in one pass.

        The first track also has the notes on damaged bags. Raise TopicError if a topic does not
        exist or is no trajectory; the message lists the usable topics.
        """
        topics = {name: self._topic(name) for name in names if not names_frames(name)}
        for topic in topics.values():
            if fault := self._fault(topic):
                raise self._topic_error(fault)
        types = {channel.topic: channel.msgtype for channel in self.channels
                 if channel.topic in topics.values()}
        of_frames = any(map(names_frames, names))
        transforms = self._transform_topics() if of_frames else []
        if of_frames and not transforms:
            raise self._topic_error('no topic of transforms (/tf)')
        found = self._gather(types | dict.fromkeys(transforms, TF), progress)
        result = {}
        for name in names:
            if name in topics:
                topic = topics[name]
                track = join_tracks(topic, types[topic], without_repeats([
                    (str(bag.path), part) for bag, collector in found[topic]
                    for part in collector.tracks()]))
            else:
                tf = _filled(found, transforms)
                track = transform_track(name, transform_tree(tf), tf)
            warnings = [note for topic in ([topics[name]] if name in topics else transforms)
                        for bag in self._bags for note in bag.missing(topic, sum(
                            collector.count for other, collector in found[topic]
                            if other is bag))]
            if name == names[0]:
                warnings[:0] = self.notes
            result[name] = replace(track, warnings=tuple(warnings))
        return result

    def transforms(self) -> TransformTree:
        """Return all transforms of the bags; an empty tree if they have no TF topic."""
        topics = self._transform_topics()
        return transform_tree(_filled(self._gather(dict.fromkeys(topics, TF), None), topics))

    def _gather(self, types: dict[str, str], progress: Progress | None) -> _Found:
        """Read the topics (name -> type) from all bags in one pass."""
        total = sum(channel.messages for channel in self.channels if channel.topic in types)
        count = 0
        found: _Found = {topic: [] for topic in types}
        for bag in self._bags:
            for storage in bag.files.values():
                for topic, msgtype in types.items():
                    found[topic].append((bag, TopicCollector(topic, msgtype)))
                for batch in storage.messages(types.keys()):
                    _, collector = found[batch.channel.topic][-1]
                    if batch.channel.msgtype != collector.msgtype:
                        continue
                    collector.add(unpacked(batch))
                    count += len(batch.messages)
                    if progress is not None:
                        progress(min(count, total), total)
        return found

    def _topic(self, name: str) -> str:
        """Return the topic's name in the bags, which may differ by a leading slash."""
        topics = {channel.topic for channel in self.channels}
        other = name.removeprefix('/') if name.startswith('/') else f'/{name}'
        return other if name not in topics and other in topics else name

    def _fault(self, topic: str) -> str:
        """Return why a topic cannot be used as a trajectory, '' if it can."""
        channels = [channel for channel in self.channels if channel.topic == topic]
        types = [channel.msgtype for channel in channels]
        encodings = sorted({channel.encoding for channel in channels})
        if not types:
            return f'no topic {topic}'
        if len(set(types)) > 1:
            return f'topic {topic} has several types ({", ".join(types)})'
        if types[0] == TF:
            return f'topic {topic} holds transforms; name a pair of frames, tf:PARENT.CHILD'
        if types[0] not in TRAJECTORY_TYPES:
            return f'topic {topic} is {types[0]}, which cannot be used as a trajectory'
        if set(encodings) <= set(_READABLE):
            return ''
        return (f'topic {topic} is written as {", ".join(encodings)}, and only '
                f'{" and ".join(_READABLE)} can be read')

    def _transform_topics(self) -> list[str]:
        return list(dict.fromkeys(
            channel.topic for channel in self.channels
            if channel.msgtype == TF and channel.encoding in _READABLE))

    def _topic_error(self, found: str) -> TopicError:
        serving = [
            f'{channel.topic} ({channel.msgtype.split("/")[-1]}, '
            f'{counted(channel.messages, "message")})'
            for channel in self.channels
            if channel.msgtype in TRAJECTORY_TYPES and channel.encoding in _READABLE]
        if self._transform_topics():
            serving.append('tf:PARENT.CHILD (inspect lists the frames)')
        names = ', '.join(str(bag.path) for bag in self._bags)
        notes = f'; {"; ".join(self.notes)}' if self.notes else ''
        return TopicError(f'{names}: {found}; usable topics: '
                          f'{", ".join(serving) or "none"}{notes}')


def _filled(found: _Found, topics: Sequence[str]) -> list[TopicCollector]:
    return [collector for topic in topics for _, collector in found[topic] if collector.count]
