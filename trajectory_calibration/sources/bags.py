# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories in bags: rosbag2 (sqlite3, mcap, compressed or not) and ROS 1.

Of a damaged bag, what is whole is used, with a note that says how much is missing.
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
from trajectory_calibration.sources.channels import border, Channel, Storage
from trajectory_calibration.sources.overlaps import without_repeats
from trajectory_calibration.sources.storage import (
    Bag,
    find_bag,
    open_storage,
    unpacked,
)
from trajectory_calibration.sources.topics import (
    join_tracks,
    TopicCollector,
    TopicTrack,
    transform_track,
    transform_tree,
)
from trajectory_calibration.sources.transforms import names_frames, TransformTree

# Called with the messages read so far and the messages expected.
Progress = Callable[[int, int], None]

_READABLE = ('cdr', 'ros1')


@dataclass(frozen=True)
class BagSource:
    """A topic of one or several bags as a trajectory.

    Attributes
    ----------
    bags : bag folders or files, of ROS 1, of ROS 2, or some of each.
    topic : of type Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped or Path;
        or ``tf:PARENT.CHILD``, the pose of a frame in another by the transforms of the bag.
    sensor_frame, world_frame : names that override those of the messages.

    """

    bags: Sequence[str | os.PathLike[str]]
    topic: str
    sensor_frame: str | None = None
    world_frame: str | None = None

    def load(self) -> Trajectory:
        """Read the topic.

        Raises
        ------
        SourceError
            A bag cannot be read, or the topic holds fewer than two usable poses.
        TopicError
            No such topic, or it cannot serve; the message lists those that can.

        """
        with open_bags(self.bags) as reader:
            track = reader.read([self.topic])[self.topic]
        return track.to_trajectory(self.sensor_frame, self.world_frame)


@contextmanager
def open_bags(paths: Iterable[str | os.PathLike[str]]) -> Iterator[BagReader]:
    """Open several bags together; they close with the ``with`` statement.

    Raise SourceError where a path is no bag, or nothing in any of them can be read.
    """
    # Patterns of the shell name a bag twice.
    once = {os.path.realpath(path): Path(path) for path in paths}
    bags = [find_bag(path) for path in once.values()]
    with ExitStack() as stack:
        yield BagReader([_OpenBag(bag, stack) for bag in bags])


class BagReader:
    """Several open bags.

    Attributes
    ----------
    channels : topics, types and counts over all bags, by name.

    """

    def __init__(self, bags: list[_OpenBag]) -> None:
        self._bags = bags
        if not any(item.storage for bag in bags for item in bag.files):
            raise SourceError(
                f'{"; ".join(self.notes)}: nothing in it can be read; copy it again from where it '
                'was recorded, or record anew')
        counts: Counter[Channel] = Counter()
        for bag in bags:
            for channel in bag.channels():
                counts[channel._replace(messages=0)] += channel.messages
        self.channels = [channel._replace(messages=counts[channel]) for channel in sorted(counts)]

    @property
    def notes(self) -> list[str]:
        """Return what is wrong with the bags as a whole, as far as they have been read."""
        return [note for bag in self._bags for note in bag.notes()]

    @property
    def serving(self) -> list[str]:
        """Return the topics that can serve as a trajectory."""
        topics = dict.fromkeys(channel.topic for channel in self.channels)
        return [topic for topic in topics if not self._fault(topic)]

    def read(
        self, names: Sequence[str], progress: Progress | None = None,
    ) -> dict[str, TopicTrack]:
        """Read topics and ``tf:PARENT.CHILD`` in one pass; the first carries the notes on bags.

        Raise TopicError where there is no such topic, or it cannot serve; the message lists those
        that can.
        """
        topics = {name: self._topic(name) for name in names if not names_frames(name)}
        types = {topic: self._serving_type(topic) for topic in topics.values()}
        for bag in self._bags:
            bag.found.clear()
        of_frames = any(map(names_frames, names))
        transforms = self._transform_topics() if of_frames else []
        if of_frames and not transforms:
            raise self._topic_error('no topic of transforms (/tf)')
        parts, tf = self._gather(types, transforms, progress)
        result = {}
        for name in names:
            if name in topics:
                topic = topics[name]
                track = join_tracks(topic, types[topic], without_repeats(parts[topic]))
            else:
                track = transform_track(name, transform_tree(tf), tf)
            warnings = [note for topic in ([topics[name]] if name in topics else transforms)
                        for bag in self._bags for note in bag.missing(topic)]
            if name == names[0]:
                warnings[:0] = self.notes
            result[name] = replace(track, warnings=tuple(warnings))
        return result

    def transforms(self, progress: Progress | None = None) -> TransformTree:
        """Return all transforms of the bags; none where they hold no such topic."""
        return transform_tree(self._gather({}, self._transform_topics(), progress)[1])

    def _gather(
        self, types: dict[str, str], transforms: list[str], progress: Progress | None,
    ) -> tuple[dict[str, list[tuple[str, TopicTrack]]], list[TopicCollector]]:
        """Read all bags once."""
        wanted = {**types, **dict.fromkeys(transforms, TF)}
        total = sum(channel.messages for channel in self.channels if channel.topic in wanted)
        count = 0

        def step(messages: int) -> None:
            nonlocal count
            count += messages
            if progress is not None:
                progress(min(count, total), total)

        parts: dict[str, list[tuple[str, TopicTrack]]] = {topic: [] for topic in types}
        tf: list[TopicCollector] = []
        for bag in self._bags:
            for item in bag.files:
                for topic, collector in item.read(wanted, step).items():
                    if collector.msgtype == TF:
                        tf += [collector] if collector.count else []
                    else:
                        parts[topic].append((str(bag.path), collector.track()))
                    bag.found[topic] += collector.count
        return parts, tf

    def _topic(self, name: str) -> str:
        """Return the name of a topic that was given with or without its leading slash."""
        topics = {channel.topic for channel in self.channels}
        other = name.removeprefix('/') if name.startswith('/') else f'/{name}'
        return other if name not in topics and other in topics else name

    def _serving_type(self, topic: str) -> str:
        fault = self._fault(topic)
        if fault:
            raise self._topic_error(fault)
        return next(channel.msgtype for channel in self.channels if channel.topic == topic)

    def _fault(self, topic: str) -> str:
        """Say why a topic cannot serve as a trajectory; nothing where it can."""
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
            return f'topic {topic} is {types[0]}, which cannot serve as a trajectory'
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
        return TopicError(f'{names}: {found}; topics that can serve: '
                          f'{", ".join(serving) or "none"}{notes}')


class _OpenFile:
    """A file of a bag: its storage, or None where nothing in it can be read, and its damage."""

    def __init__(self, path: Path, stack: ExitStack, *, count: bool) -> None:
        self.path, self.damage = path, ''
        self.storage: Storage | None = None
        try:
            with border(lambda reason: setattr(self, 'damage', reason)):
                self.storage = open_storage(path, stack, count=count)
                self.damage = self.storage.damage
        except SourceError as error:
            raise SourceError(f'{path}: {error}') from error

    def read(
        self, types: dict[str, str], step: Callable[[int], None],
    ) -> dict[str, TopicCollector]:
        """Return what the file holds of some topics."""
        if self.storage is None:
            return {}
        collectors = {topic: TopicCollector(topic, msgtype) for topic, msgtype in types.items()}
        for batch in self.storage.messages(types.keys()):
            if batch.channel.msgtype == types[batch.channel.topic]:
                collectors[batch.channel.topic].add(unpacked(batch))
                step(len(batch.messages))
        self.damage = self.storage.damage
        return collectors


class _OpenBag:
    """A bag, how each of its files fared, and how many messages of each topic were found."""

    def __init__(self, bag: Bag, stack: ExitStack) -> None:
        self.path, self._declared, self._notes = bag.path, bag.declared, bag.notes
        self.files = [_OpenFile(path, stack, count=not bag.declared) for path in bag.files]
        self.found: Counter[str] = Counter()

    def channels(self) -> list[Channel]:
        found = [channel for item in self.files if item.storage is not None
                 for channel in item.storage.channels]
        declared = dict(self._declared)
        return [channel._replace(messages=declared.pop(channel.topic, 0))
                for channel in found] if declared else found

    def notes(self) -> list[str]:
        return [f'{self.path}: {note}' for note in self._notes] + [
            f'{item.path} is damaged: {item.damage}' for item in self.files if item.damage]

    def missing(self, topic: str) -> list[str]:
        """Say how many messages of a topic were not read."""
        read = self.found[topic]
        expected = max(
            self._declared.get(topic, 0),
            sum(channel.messages for channel in self.channels() if channel.topic == topic))
        if expected > read:
            return [(f'{self.path}: read {read} of {counted(expected, "message")}, '
                     f'{expected - read} missing')]
        known = topic in self._declared or all(
            item.storage is not None and item.storage.counted for item in self.files)
        if any(item.damage for item in self.files) and not known:
            return [f'{self.path}: read {counted(read, "message")} of an unknown number']
        return []
