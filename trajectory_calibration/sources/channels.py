# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every container gives: channels, batches of their messages, and what is damaged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import NamedTuple

from trajectory_calibration.errors import MissingPackageError, SourceError

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


class Storage(ABC):
    """An open file of a bag.

    Attributes
    ----------
    channels : topics, types and counts.
    damage : what was found wrong so far; empty where nothing was.
    counted : whether the counts come from an index, and reading can give fewer.

    """

    channels: list[Channel]
    damage = ''
    counted = False

    @abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics, those that are whole, in the order of the file."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def note_damage(self, what: str) -> None:
        """Keep what is wrong, of several things the first."""
        self.damage = self.damage or what

    def noting(self, what: str = '{}') -> AbstractContextManager[None]:
        """Run what a damaged file may break, and note ``what`` with the reason in its place."""
        return border(lambda reason: self.note_damage(what.format(reason)))


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
