# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every container gives: channels, batches of their messages, and what is damaged.

All of them are read from their start, and their index serves as a check: a file without one, or
cut off, or with damaged parts, then needs no reader of its own. What is whole is read, and what
the index declares tells how much is missing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import NamedTuple

from trajectory_calibration.errors import MissingPackageError, SourceError

_OLD_NAMES = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}
# Messages that wait until they become numbers: enough to make NumPy's overhead vanish.
_BATCH = 4096


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


class Storage(ABC):
    """An open file of a bag.

    Attributes
    ----------
    channels : topics, types and counts.
    damage : what was found wrong so far; empty where nothing was.
    counted : whether the counts come from an index, and reading can give fewer.

    """

    damage = ''
    index_damage = 'its index is damaged: {}'

    def __init__(self) -> None:
        # Channels by their number in the file, and whether their messages are asked for.
        self._declared: dict[int, Channel] = {}
        self._wanted: dict[int, bool] = {}
        self._topics: Collection[str] | None = ()
        counts: Mapping[int, int] | None = None
        with self.noting(self.index_damage):
            counts = self._index()
        self.counted = counts is not None
        if counts is None:
            # What was understood of the index is not trusted.
            self._declared.clear()
            self._want(None)
            counts = Counter(key for key, _, _ in self._read())
        self.channels = [channel._replace(messages=counts.get(key, 0))
                         for key, channel in self._declared.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the whole messages of some topics, of each in the order of the file."""
        self._want(topics)
        gathered: dict[int, tuple[list[int], list[bytes]]] = defaultdict(lambda: ([], []))
        for key, received_ns, message in self._read():
            received, messages = gathered[key]
            received.append(received_ns)
            messages.append(message)
            if len(messages) == _BATCH:
                yield Batch(self._declared[key], *gathered.pop(key))
        for key, lists in gathered.items():
            yield Batch(self._declared[key], *lists)

    @abstractmethod
    def _index(self) -> Mapping[int, int] | None:
        """Declare the channels of the index; return the messages of each, None without a count.

        May raise any exception where the index is damaged.
        """

    @abstractmethod
    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, time and data of the whole messages that are ``_wanted``.

        Declare channels on the way.
        """

    def _declare(self, key: int, channel: Channel) -> None:
        self._declared[key] = channel
        self._wanted[key] = self._topics is None or channel.topic in self._topics

    def _want(self, topics: Collection[str] | None) -> None:
        """Ask for the messages of some topics; of all for None."""
        self._topics = topics
        self._wanted.clear()
        for key, channel in self._declared.items():
            self._declare(key, channel)

    def note_damage(self, what: str) -> None:
        """Keep what is wrong, of several things the first."""
        self.damage = self.damage or what

    def noting(self, what: str = '{}') -> AbstractContextManager[None]:
        """Run what a damaged file may break, and note ``what`` with the reason in its place."""
        return border(lambda reason: self.note_damage(what.format(reason)))


class Unreadable(Storage):
    """A file of a bag in which nothing can be read."""

    def _index(self) -> None:
        return None

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        return iter(())


@contextmanager
def border(note: Callable[[str], None]) -> Iterator[None]:
    """Run what a damaged file may break; hand the reason to ``note`` and go on behind it.

    sqlite3, struct, mmap, YAML and the decompressors raise 17 kinds of errors there, and none
    means more than that something is damaged. What this package says itself passes.
    """
    try:
        yield
    except (MissingPackageError, SourceError):
        raise
    except Exception as error:  # noqa: BLE001
        note((str(error).splitlines() or [type(error).__name__])[0][:120])


def plain_type(msgtype: str) -> str:
    """Return a type as ROS 2 names it: nav_msgs/Odometry as nav_msgs/msg/Odometry."""
    package, _, name = msgtype.partition('/')
    full = msgtype if '/' in name or not name else f'{package}/msg/{name}'
    return _OLD_NAMES.get(full, full)
