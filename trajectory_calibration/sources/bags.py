"""Trajectories in bags: rosbag2 (sqlite3, mcap, compressed or not) and ROS 1.

Needs the package ``rosbags``, which loads here and nowhere else. Of a damaged bag, what can be
read is used, with a warning that says how much is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, field
import os
from pathlib import Path

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import pip_name, SourceError, TopicError
from trajectory_calibration.sources.cdr import TRAJECTORY_TYPES

try:
    from trajectory_calibration.sources.recovery import RecoveredMcap, RecoveredSqlite
    from trajectory_calibration.sources.storage import (
        Bag,
        Channel,
        DAMAGE,
        describe_damage,
        find_bag,
        is_ros1,
        Message,
        RosbagsStorage,
        Storage,
    )
    from trajectory_calibration.sources.topics import join_tracks, TopicCollector, TopicTrack
except ModuleNotFoundError as error:
    # A machine with ROS from apt has no rosbags, and needs it for nothing else.
    raise SourceError(
        f'bags need the Python package {pip_name(error)}, which is not installed; install it '
        'with: pip install rosbags') from error

# Called with the messages read so far and the messages expected.
Progress = Callable[[int, int], None]

_RECOVERY: dict[str, Callable[[Path], Storage]] = {
    '.mcap': RecoveredMcap, '.db3': RecoveredSqlite}
_PROGRESS_EVERY = 8192


@dataclass(frozen=True)
class BagSource:
    """A topic of one or several bags as a trajectory.

    Attributes
    ----------
    bags : bag folders or files, of ROS 1, of ROS 2, or some of each.
    topic : of type Odometry, PoseStamped, PoseWithCovarianceStamped or Path.
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
    opened = [_OpenBag(find_bag(Path(path))) for path in paths]
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
        counts: dict[tuple[str, str], int] = {}
        for bag in bags:
            for topic, msgtype, messages in bag.channels():
                counts[topic, msgtype] = counts.get((topic, msgtype), 0) + messages
        self.channels = [Channel(*key, counts[key]) for key in sorted(counts)]

    @property
    def notes(self) -> list[str]:
        """Return what is wrong with the bags as a whole, as far as they have been read."""
        return [note for bag in self._bags for note in bag.notes()]

    def read(
        self, topics: Sequence[str], progress: Progress | None = None,
    ) -> dict[str, TopicTrack]:
        """Read some topics in one pass; the first track carries the notes on the bags.

        Raises
        ------
        TopicError
            No such topic, or it cannot serve; the message lists those that can.

        """
        types = {topic: self._serving_type(topic) for topic in topics}
        total = sum(channel.messages for channel in self.channels if channel.topic in types)
        meter = _Meter(progress, total)
        parts: dict[str, list[TopicTrack]] = {topic: [] for topic in types}
        warnings: dict[str, list[str]] = {topic: [] for topic in types}
        for bag in self._bags:
            tracks = bag.read(types, meter)
            for topic in types:
                found = [track[topic] for track in tracks if topic in track]
                parts[topic] += found
                warnings[topic] += bag.missing(
                    topic, sum(track.messages for track in found))
        for topic in list(types)[:1]:
            warnings[topic][:0] = self.notes
        return {
            topic: join_tracks(topic, msgtype, parts[topic], tuple(warnings[topic]))
            for topic, msgtype in types.items()}

    def _serving_type(self, topic: str) -> str:
        types = [channel.msgtype for channel in self.channels if channel.topic == topic]
        if len(types) == 1 and types[0] in TRAJECTORY_TYPES:
            return types[0]
        if not types:
            found = f'no topic {topic}'
        elif len(types) > 1:
            found = f'topic {topic} has several types ({", ".join(types)})'
        else:
            found = f'topic {topic} is {types[0]}, which cannot serve as a trajectory'
        serving = ', '.join(
            f'{channel.topic} ({channel.msgtype.split("/")[-1]}, {channel.messages} messages)'
            for channel in self.channels if channel.msgtype in TRAJECTORY_TYPES)
        names = ', '.join(str(item.bag.path) for item in self._bags)
        notes = f'; {"; ".join(self.notes)}' if self.notes else ''
        raise TopicError(f'{names}: {found}; topics that can serve: {serving or "none"}{notes}')


@dataclass
class _OpenFile:
    """A file of a bag: its storage, or None where nothing in it can be read, and its damage."""

    path: Path
    storage: Storage | None = None
    damage: str = ''
    recovered: bool = False


@dataclass
class _OpenBag:
    """A bag, and how each of its files fared."""

    bag: Bag
    files: list[_OpenFile] = field(default_factory=list)

    def open(self) -> None:
        for path in self.bag.files:
            item = _OpenFile(path)
            self.files.append(item)
            try:
                item.storage = RosbagsStorage(path)
            except DAMAGE as error:
                item.damage = describe_damage(error)
                item.storage = _recover(path)
                item.recovered = True

    def close(self) -> None:
        for item in self.files:
            if item.storage is not None:
                item.storage.close()

    def channels(self) -> list[Channel]:
        return [channel for item in self.files if item.storage is not None
                for channel in item.storage.channels]

    def notes(self) -> list[str]:
        return [f'{self.bag.path}: {note}' for note in self.bag.notes] + [
            f'{item.path} is damaged ({item.damage})' for item in self.files if item.damage]

    def read(self, types: dict[str, str], meter: _Meter) -> list[dict[str, TopicTrack]]:
        """Return the tracks of each file."""
        result = []
        for item in self.files:
            if item.storage is None:
                continue
            tracks, damage = _read_storage(item.storage, types, item.path, meter)
            declared = sum(
                channel.messages for channel in item.storage.channels if channel.topic in types)
            if (damage or _messages(tracks) < declared) and not item.recovered:
                item.damage = damage or 'fewer messages than its index declares'
                other = _recover(item.path)
                if other is not None:
                    recovered, _ = _read_storage(other, types, item.path, meter)
                    other.close()
                    tracks = max(tracks, recovered, key=_messages)
            result.append(tracks)
        return result

    def missing(self, topic: str, read: int) -> list[str]:
        """Say how many messages of a topic were not read, after ``read``."""
        expected = max(
            self.bag.declared.get(topic, 0),
            sum(channel.messages for channel in self.channels() if channel.topic == topic))
        found = f'{self.bag.path}: read {read}'
        if expected > read:
            return [f'{found} of {expected} messages, {expected - read} are missing']
        if any(item.damage for item in self.files) and topic not in self.bag.declared:
            return [f'{found} messages; how many are missing is not known']
        return []


class _Meter:
    """Counts messages and reports now and then."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._count = progress, total, 0

    def step(self) -> None:
        self._count += 1
        if self._progress is not None and self._count % _PROGRESS_EVERY == 0:
            self._progress(min(self._count, self._total), self._total)


def _read_storage(
    storage: Storage, types: dict[str, str], path: Path, meter: _Meter,
) -> tuple[dict[str, TopicTrack], str]:
    """Return the tracks of a file up to its end or its damage, and the damage."""
    ros1 = is_ros1(path)
    collectors = {
        topic: TopicCollector(topic, msgtype, ros1=ros1) for topic, msgtype in types.items()}
    damage: list[str] = []
    for topic, msgtype, received_ns, data in _whole(storage.messages(types.keys()), damage):
        if msgtype == types[topic]:
            collectors[topic].add(data, received_ns)
            meter.step()
    tracks = {topic: collector.track() for topic, collector in collectors.items()}
    return tracks, ''.join(damage)


def _whole(messages: Iterator[Message], damage: list[str]) -> Iterator[Message]:
    """Yield messages up to the damage and note it; errors of whoever takes them pass by."""
    try:
        yield from messages
    except DAMAGE as error:
        damage.append(describe_damage(error))


def _recover(path: Path) -> Storage | None:
    """Open a damaged file with the reader that trusts nothing, if it finds any message."""
    if path.suffix not in _RECOVERY:
        return None
    try:
        storage = _RECOVERY[path.suffix](path)
    except DAMAGE:
        return None
    if storage.channels:
        return storage
    storage.close()
    return None


def _messages(tracks: dict[str, TopicTrack]) -> int:
    return sum(track.messages for track in tracks.values())
