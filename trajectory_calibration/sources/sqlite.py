# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A sqlite3 file of rosbag2, read by ascending row id, the order of writing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
import json
from pathlib import Path
import sqlite3

from trajectory_calibration.sources.channels import Channel, plain_type, Storage

# Rows per fetch: small enough for the CPU cache.
_BLOCK = 256


def connect(path: Path) -> sqlite3.Connection:
    """Open a file read-only, also if it is truncated or still being written."""
    connection = sqlite3.connect(f'{path.absolute().as_uri()}?mode=ro&immutable=1', uri=True)
    # Without it, sqlite rejects a file that is shorter than its header states. The connection is
    # read-only, so nothing is written.
    connection.execute('PRAGMA writable_schema = ON')
    connection.execute('PRAGMA mmap_size = 2147483648')
    return connection


class SqliteFile(Storage):
    """An open sqlite3 file.

    The message counts are row counts, or zero without ``count``.
    """

    index_damage = '{}'

    def __init__(self, connection: sqlite3.Connection, *, count: bool) -> None:
        self._connection, self._count = connection, count
        super().__init__()
        # A lost row may be missing from the row count as well.
        self.counted = False

    def _index(self) -> Mapping[int, int]:
        """Declare the topics; return the number of rows of each."""
        self._declare_topics()
        if not self._count:
            return {}
        counts: Counter[int] = Counter(dict(self._connection.execute(
            'SELECT topic_id, COUNT(*) FROM messages NOT INDEXED GROUP BY topic_id')))
        with self.noting():
            # The index on the timestamp, if it exists, is a second list of all rows.
            ((indexed,),) = self._connection.execute('SELECT COUNT(*) FROM messages')
            missing = indexed - sum(counts.values())
            if missing > 0:
                self.note_damage(f'its table lacks {missing} of the {indexed} rows of its index')
        if set(counts) - set(self._declared):
            self.note_damage('messages of a topic that is not declared')
        return counts

    def _declare_topics(self) -> None:
        for key, name, msgtype, encoding in self._connection.execute(
                'SELECT id, name, type, serialization_format FROM topics'):
            self._declare(key, Channel(str(name), plain_type(str(msgtype)), 0, str(encoding)))

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages; skip damaged pages with increasing strides."""
        self._declare_topics()
        wanted = json.dumps([key for key, wanted in self._wanted.items() if wanted])
        after, stride, size = 0, 1, _BLOCK
        # After this many unreadable row ids, no readable row follows.
        while stride < 2**32:
            try:
                cursor = self._connection.execute(
                    'SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? AND topic_id '
                    'IN (SELECT value FROM json_each(?)) ORDER BY id', (after, wanted))
                while rows := cursor.fetchmany(size):
                    # A damaged page may contain any row id: never go back.
                    after, stride = max(after, rows[-1][0]), 1
                    for _, key, time, message in rows:
                        if type(time) is int and type(message) is bytes:
                            yield key, time, message
                        else:
                            self.note_damage('some of its rows hold no message')
            except sqlite3.Error as error:
                self.note_damage(str(error))
            else:
                return
            # A damaged row makes its whole block unreadable: continue row by row.
            if size > 1:
                size = 1
            else:
                after += stride
                stride *= 2
