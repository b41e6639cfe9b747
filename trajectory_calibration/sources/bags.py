# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories in bags: rosbag2 (sqlite3, mcap, compressed or not) and ROS 1.

Of a damaged bag, what is whole is used, with a note that says how much is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, field, replace
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
    unpacked_file,
)
from trajectory_calibration.sources.topics import (
    join_tracks,
    TopicCollector,
    TopicTrack,
    transform_track,
    transform_tree,
    TransformCollector,
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

    Raises
    ------
    SourceError
        A path is no bag, or nothing in any of them can be read.

    """
    # Patterns of the shell name a bag twice.
    once = {os.path.realpath(path): Path(path) for path in paths}
    opened = [_OpenBag(find_bag(path)) for path in once.values()]
    with ExitStack() as stack:
        for bag in opened:
            stack.callback(bag.close)
            bag.open()
        yield BagReader(opened)


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
        counts: dict[tuple[str, str, str], int] = {}
        for bag in bags:
            for channel in bag.channels():
                key = channel.topic, channel.msgtype, channel.encoding
                counts[key] = counts.get(key, 0) + channel.messages
        self.channels = [Channel(topic, msgtype, counts[topic, msgtype, encoding], encoding)
                         for topic, msgtype, encoding in sorted(counts)]

    @property
    def notes(self) -> list[str]:
        """Return what is wrong with the bags as a whole, as far as they have been read."""
        return [note for bag in self._bags for note in bag.notes()]

    @property
    def serving(self) -> list[str]:
        """Return the topics that can serve as a trajectory."""
        types: dict[str, set[str]] = {}
        for channel in self.channels:
            types.setdefault(channel.topic, set()).add(
                channel.msgtype if _can_serve(channel) else '')
        return [topic for topic, found in types.items() if len(found) == 1 and '' not in found]

    def read(
        self, names: Sequence[str], progress: Progress | None = None,
    ) -> dict[str, TopicTrack]:
        """Read topics and ``tf:PARENT.CHILD`` in one pass; the first carries the notes on bags.

        Raises
        ------
        TopicError
            No such topic, or it cannot serve; the message lists those that can.

        """
        chains = [name for name in names if names_frames(name)]
        topics = {name: self._topic(name) for name in names if name not in chains}
        types = {topic: self._serving_type(topic) for topic in topics.values()}
        for bag in self._bags:
            bag.found.clear()
        transforms = self._transform_topics(required=True) if chains else []
        parts, tf = self._gather(types, transforms, progress)
        result = {}
        for name in names:
            wanted = transforms if name in chains else [topics[name]]
            warnings = [note for topic in wanted for note in self._missing(topic)]
            if name == names[0]:
                warnings[:0] = self.notes
            if name in chains:
                track = transform_track(name, transform_tree(tf), tf)
            else:
                topic = topics[name]
                track = join_tracks(topic, types[topic], without_repeats(parts[topic]))
            result[name] = replace(track, warnings=tuple(warnings))
        return result

    def transforms(self, progress: Progress | None = None) -> TransformTree:
        """Return all transforms of the bags; none where they hold no such topic."""
        _, tf = self._gather({}, self._transform_topics(required=False), progress)
        return transform_tree(tf)

    def _gather(
        self, types: dict[str, str], transforms: list[str], progress: Progress | None,
    ) -> tuple[dict[str, list[tuple[str, TopicTrack]]], list[TransformCollector]]:
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
        tf: list[TransformCollector] = []
        for bag in self._bags:
            for item in bag.files:
                for topic, collector in item.read(wanted, step).items():
                    if isinstance(collector, TransformCollector):
                        tf.append(collector)
                    else:
                        parts[topic].append((str(bag.bag.path), collector.track()))
                    bag.found[topic] = bag.found.get(topic, 0) + collector.count
        return parts, [collector for collector in tf if collector.count]

    def _missing(self, topic: str) -> list[str]:
        return [note for bag in self._bags for note in bag.missing(topic)]

    def _topic(self, name: str) -> str:
        """Return the name of a topic that was given with or without its leading slash."""
        topics = {channel.topic for channel in self.channels}
        other = name.removeprefix('/') if name.startswith('/') else f'/{name}'
        return other if name not in topics and other in topics else name

    def _serving_type(self, topic: str) -> str:
        channels = [channel for channel in self.channels if channel.topic == topic]
        types = [channel.msgtype for channel in channels]
        if len(set(types)) == 1 and types[0] in TRAJECTORY_TYPES:
            encodings = {channel.encoding for channel in channels}
            if encodings <= set(_READABLE):
                return types[0]
            found = (f'topic {topic} is written as {", ".join(sorted(encodings))}, and only '
                     f'{" and ".join(_READABLE)} can be read')
        elif not types:
            found = f'no topic {topic}'
        elif len(set(types)) > 1:
            found = f'topic {topic} has several types ({", ".join(types)})'
        elif types[0] == TF:
            found = f'topic {topic} holds transforms; name a pair of frames, tf:PARENT.CHILD'
        else:
            found = f'topic {topic} is {types[0]}, which cannot serve as a trajectory'
        raise self._topic_error(found)

    def _transform_topics(self, *, required: bool) -> list[str]:
        found = [channel.topic for channel in self.channels
                 if channel.msgtype == TF and channel.encoding in _READABLE]
        if required and not found:
            raise self._topic_error('no topic of transforms (/tf)')
        return list(dict.fromkeys(found))

    def _topic_error(self, found: str) -> TopicError:
        serving = [
            f'{channel.topic} ({channel.msgtype.split("/")[-1]}, '
            f'{counted(channel.messages, "message")})'
            for channel in self.channels if _can_serve(channel)]
        if self._transform_topics(required=False):
            serving.append('tf:PARENT.CHILD (inspect lists the frames)')
        names = ', '.join(str(item.bag.path) for item in self._bags)
        notes = f'; {"; ".join(self.notes)}' if self.notes else ''
        return TopicError(f'{names}: {found}; topics that can serve: '
                          f'{", ".join(serving) or "none"}{notes}')


def _can_serve(channel: Channel) -> bool:
    return channel.msgtype in TRAJECTORY_TYPES and channel.encoding in _READABLE


@dataclass
class _OpenFile:
    """A file of a bag: its storage, or None where nothing in it can be read, and its damage."""

    path: Path
    storage: Storage | None = None
    damage: str = ''
    _stack: ExitStack = field(default_factory=ExitStack)

    def open(self, *, count: bool) -> None:
        try:
            with border(lambda reason: setattr(self, 'damage', reason)):
                path, damage = unpacked_file(self.path, self._stack)
                self.storage = open_storage(path, count=count)
                self._stack.callback(self.storage.close)
                self.damage = self.storage.damage = damage or self.storage.damage
        except SourceError as error:
            raise SourceError(f'{self.path}: {error}') from error

    def close(self) -> None:
        self._stack.close()

    def read(
        self, types: dict[str, str], step: Callable[[int], None],
    ) -> dict[str, TopicCollector | TransformCollector]:
        """Return what the file holds of some topics."""
        if self.storage is None:
            return {}
        collectors: dict[str, TopicCollector | TransformCollector] = {
            topic: TransformCollector(topic) if msgtype == TF else TopicCollector(topic, msgtype)
            for topic, msgtype in types.items()}
        for batch in self.storage.messages(types.keys()):
            if batch.channel.msgtype == types[batch.channel.topic]:
                collectors[batch.channel.topic].add(unpacked(batch))
                step(len(batch.messages))
        self.damage = self.storage.damage
        return collectors


@dataclass
class _OpenBag:
    """A bag, how each of its files fared, and how many messages of each topic were found."""

    bag: Bag
    files: list[_OpenFile] = field(default_factory=list)
    found: dict[str, int] = field(default_factory=dict)

    def open(self) -> None:
        for path in self.bag.files:
            item = _OpenFile(path)
            self.files.append(item)
            item.open(count=not self.bag.declared)

    def close(self) -> None:
        for item in self.files:
            item.close()

    def channels(self) -> list[Channel]:
        found = [channel for item in self.files if item.storage is not None
                 for channel in item.storage.channels]
        declared = dict(self.bag.declared)
        return [channel._replace(messages=declared.pop(channel.topic, 0))
                for channel in found] if declared else found

    def notes(self) -> list[str]:
        return [f'{self.bag.path}: {note}' for note in self.bag.notes] + [
            f'{item.path} is damaged: {item.damage}' for item in self.files if item.damage]

    def missing(self, topic: str) -> list[str]:
        """Say how many messages of a topic were not read."""
        read = self.found.get(topic, 0)
        expected = max(
            self.bag.declared.get(topic, 0),
            sum(channel.messages for channel in self.channels() if channel.topic == topic))
        found = f'{self.bag.path}: read {read}'
        if expected > read:
            return [f'{found} of {counted(expected, "message")}, {expected - read} missing']
        known = topic in self.bag.declared or all(
            item.storage is not None and item.storage.counted for item in self.files)
        if any(item.damage for item in self.files) and not known:
            return [f'{self.bag.path}: read {counted(read, "message")} of an unknown number']
        return []
