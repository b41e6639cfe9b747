# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of records, mcap and bags of ROS 1: read from their start, their index as a check only.

A file without an index, or cut off, or with damaged chunks, then needs no reader of its own: what
is whole is read, and what the index declares tells how much is missing. rosbags refuses such
files, and mcap files of other profiles.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator
import mmap
from pathlib import Path

from trajectory_calibration.sources.channels import Batch, Channel, Storage

# Messages that wait until they become numbers: enough to make NumPy's overhead vanish.
_BLOCK = 8192


class RecordFile(Storage):
    """An open file of records; ``Storage`` says what it offers.

    Its channels are those of the index, and so are their counts; counted without one.
    """

    def __init__(self, path: Path) -> None:
        self._declared: dict[int, Channel] = {}
        with path.open('rb') as stream:
            # Mapped, not read: a bag may be larger than the memory.
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        counts = self._index()
        self.counted = counts is not None
        if counts is None:
            counts = Counter()
            for key, received, _ in self._batches(None):
                counts[key] += len(received)
        self.channels = [channel._replace(messages=counts.get(key, 0))
                         for key, channel in self._declared.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics, in the order of the file within each of them."""
        for key, received, messages in self._batches(topics):
            yield Batch(self._declared[key], received, messages)

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    @abstractmethod
    def _index(self) -> dict[int, int] | None:
        """Declare the channels of the index; return the messages of each, None without a count.

        Raise ValueError where it is not such a file.
        """

    @abstractmethod
    def _read(self, gathered: Gathered) -> Iterator[None]:
        """Gather all whole messages, and yield now and then; declare channels on the way."""

    def _batches(
        self, topics: Collection[str] | None,
    ) -> Iterator[tuple[int, list[int], list[bytes]]]:
        """Yield channel, times and messages; without the messages where no topics are given."""
        gathered = Gathered(self._declared, topics)
        for _ in self._read(gathered):
            if gathered.count >= _BLOCK:
                yield from gathered.taken()
        yield from gathered.taken()


class Gathered(dict[int, tuple[list[int], list[bytes] | None] | None]):
    """Where times and messages of a channel go until they are taken.

    None for channels that nobody wants or declares; no list for messages that are only counted.
    To be cleared where channels are declared anew. ``count`` is how many are waiting.
    """

    def __init__(self, declared: dict[int, Channel], topics: Collection[str] | None) -> None:
        super().__init__()
        self.count = 0
        self._declared, self._topics = declared, topics
        self._lists: dict[int, tuple[list[int], list[bytes]]] = {}

    def __missing__(self, key: int) -> tuple[list[int], list[bytes] | None] | None:
        channel = self._declared.get(key)
        target = None
        if channel is not None and (self._topics is None or channel.topic in self._topics):
            received, messages = self._lists.setdefault(key, ([], []))
            target = received, None if self._topics is None else messages
        self[key] = target
        return target

    def taken(self) -> Iterator[tuple[int, list[int], list[bytes]]]:
        """Yield channel, times and messages, and begin anew."""
        lists, self._lists, self.count = self._lists, {}, 0
        self.clear()
        for key, (received, messages) in lists.items():
            if received:
                yield key, received, messages
