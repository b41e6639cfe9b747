# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A sqlite3 file of rosbag2, read row by row in the order in which the rows were written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack
import json
from pathlib import Path
import sqlite3

from trajectory_calibration.sources.channels import Batch, Channel, plain_type, Storage

# Few enough rows for the cache; enough messages to make NumPy's overhead vanish.
_BLOCK, _BATCH = 256, 4096


class SqliteFile(Storage):
    """An open sqlite3 file; ``Storage`` says what it offers.

    The counts of its channels are those of its rows; zero where they were not to be counted.
    """

    def __init__(self, path: Path, *, count: bool) -> None:
        self._connection = sqlite3.connect(
            f'{path.absolute().as_uri()}?mode=ro&immutable=1', uri=True)
        with ExitStack() as failed:
            failed.callback(self.close)
            # Without it, sqlite refuses a file that is shorter than its header says. The file
            # is open read-only: nothing is written.
            self._connection.execute('PRAGMA writable_schema = ON')
            self._connection.execute('PRAGMA mmap_size = 2147483648')
            self._topics = {
                topic_id: Channel(str(name), plain_type(str(msgtype)), 0, str(encoding))
                for topic_id, name, msgtype, encoding in self._connection.execute(
                    'SELECT id, name, type, serialization_format FROM topics')}
            failed.pop_all()
        self.channels = self._counted() if count else list(self._topics.values())

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics in the order of the file."""
        wanted = [key for key, channel in self._topics.items() if channel.topic in topics]
        gathered: dict[int, tuple[list[int], list[bytes]]] = {key: ([], []) for key in wanted}
        for rows in self._rows(wanted):
            for _, topic_id, time, message in rows:
                received, messages = gathered[topic_id]
                received.append(time)
                messages.append(message)
            for topic_id, lists in gathered.items():
                if len(lists[0]) >= _BATCH:
                    yield Batch(self._topics[topic_id], *lists)
                    gathered[topic_id] = [], []
        for topic_id, lists in gathered.items():
            if lists[0]:
                yield Batch(self._topics[topic_id], *lists)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _counted(self) -> list[Channel]:
        """Return the channels with the numbers of their rows."""
        counts: Counter[int] = Counter()
        with self.noting():
            counts.update(dict(self._connection.execute(
                'SELECT topic_id, COUNT(*) FROM messages NOT INDEXED GROUP BY topic_id')))
            # The index of the times, where there is one, is a second list of all rows.
            ((indexed,),) = self._connection.execute('SELECT COUNT(*) FROM messages')
            missing = indexed - sum(counts.values())
            if missing > 0:
                self.note_damage(f'its table lacks {missing} of the {indexed} rows of its index')
        if self.damage and not counts:
            for rows in self._rows(list(self._topics)):
                counts.update(row[1] for row in rows)
        if set(counts) - set(self._topics):
            self.note_damage('messages of a topic that is not declared')
        return [channel._replace(messages=counts[key])
                for key, channel in self._topics.items()]

    def _rows(self, topic_ids: list[int]) -> Iterator[list[tuple[int, int, int, bytes]]]:
        """Yield ids, topics, times and messages of some topics.

        Damaged pages are stepped over by ever longer strides.
        """
        after, stride, size = 0, 1, _BLOCK
        wanted = json.dumps(topic_ids)
        # Behind so many rows of which none can be read, there are none left.
        while stride < 2**32:
            try:
                cursor = self._connection.execute(
                    'SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? AND topic_id '
                    'IN (SELECT value FROM json_each(?)) ORDER BY id', (after, wanted))
                while rows := cursor.fetchmany(size):
                    # A damaged page may give any number for a row: never go back.
                    after, stride = max(after, rows[-1][0]), 1
                    whole = [row for row in rows
                             if type(row[2]) is int and type(row[3]) is bytes]
                    if len(whole) < len(rows):
                        self.note_damage('some of its rows hold no message')
                    yield whole
            except sqlite3.Error as error:
                self.note_damage(str(error))
            else:
                return
            if size > 1:
                # A block is lost with its first damaged row: from here on one by one.
                size = 1
                continue
            after += stride
            stride *= 2
