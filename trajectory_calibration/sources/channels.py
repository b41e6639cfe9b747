# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The interface of all bag files: channels, batches of messages, and damage.

Every file is read from its start, and its index serves as a check only. So a file without an
index, truncated or damaged needs no separate reader: the intact messages are read, and the index
tells how many are missing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import NamedTuple

from trajectory_calibration.errors import MissingPackageError, SourceError

_OLD_NAMES = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}
# Messages per batch: enough to make NumPy's overhead negligible.
_BATCH = 4096


class Channel(NamedTuple):
    """A topic in a file: name, type, number of messages, serialization format."""

    topic: str
    msgtype: str
    messages: int
    encoding: str = 'cdr'


class Batch(NamedTuple):
    """Messages of one channel: receive times in nanoseconds, and serialized data."""

    channel: Channel
    received_ns: list[int]
    messages: list[bytes]


class Storage(ABC):
    """An open file of a bag.

    Attributes
    ----------
    channels : topics, types and message counts.
    damage : the first damage found so far, '' if none.
    counted : whether the counts come from an index, so that fewer messages may be readable.

    """

    damage = ''
    index_damage = 'its index is damaged: {}'

    def __init__(self) -> None:
        # By channel number in the file: the channel, and whether its messages are requested.
        self._declared: dict[int, Channel] = {}
        self._wanted: dict[int, bool] = {}
        self._topics: Collection[str] | None = ()
        counts: Mapping[int, int] | None = None
        with self.noting(self.index_damage):
            counts = self._index()
        self.counted = counts is not None
        if counts is None:
            # A partly readable index is not trusted.
            self._declared.clear()
            self._want(None)
            counts = Counter(key for key, _, _ in self._read())
        self.channels = [channel._replace(messages=counts.get(key, 0))
                         for key, channel in self._declared.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the intact messages of some topics, each topic in file order."""
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
        """Declare the channels of the index; return their message counts, None if it has none.

        May raise any exception if the index is damaged.
        """

    @abstractmethod
    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, receive time and data of the intact messages that are ``_wanted``.

        Declare each channel when it is found.
        """

    def _declare(self, key: int, channel: Channel) -> None:
        self._declared[key] = channel
        self._wanted[key] = self._topics is None or channel.topic in self._topics

    def _want(self, topics: Collection[str] | None) -> None:
        """Request the messages of some topics, or of all for None."""
        self._topics = topics
        self._wanted.clear()
        for key, channel in self._declared.items():
            self._declare(key, channel)

    def note_damage(self, what: str) -> None:
        """Record the damage; only the first report is kept."""
        self.damage = self.damage or what

    def noting(self, what: str = '{}') -> AbstractContextManager[None]:
        """Return a context that records errors as damage: ``what``, formatted with the reason."""
        return errors_noted(lambda reason: self.note_damage(what.format(reason)))


class Unreadable(Storage):
    """A bag file that cannot be read at all."""

    def _index(self) -> None:
        return None

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        return iter(())


@contextmanager
def errors_noted(note: Callable[[str], None]) -> Iterator[None]:
    """Suppress errors of reading a damaged file; pass the reason to ``note``.

    sqlite3, struct, mmap, YAML and the decompressors raise 17 kinds of errors, all of which mean
    only that the file is damaged. The errors of this package are not suppressed.
    """
    try:
        yield
    except (MissingPackageError, SourceError):
        raise
    except Exception as error:  # noqa: BLE001
        note((str(error).splitlines() or [type(error).__name__])[0][:120])


def plain_type(msgtype: str) -> str:
    """Return the ROS 2 name of a message type: nav_msgs/Odometry -> nav_msgs/msg/Odometry."""
    package, _, name = msgtype.partition('/')
    full = msgtype if '/' in name or not name else f'{package}/msg/{name}'
    return _OLD_NAMES.get(full, full)
