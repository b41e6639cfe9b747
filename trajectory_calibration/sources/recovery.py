"""Messages out of bag files that no longer open: what a crash or a full disk left whole.

The reader of a healthy bag trusts its index. These trust nothing: they walk the records of an
mcap file from its start, or the rows of a sqlite3 file by number, keep what is whole, and step
over what is not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
import mmap
from pathlib import Path
import sqlite3
import struct
from zlib import crc32

from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from trajectory_calibration.sources.storage import Channel, DAMAGE, Message

_MCAP_MAGIC = b'\x89MCAP0\r\n'
# Rows in a row without one that can be read, after which there are none left.
_LONGEST_STRIDE = 2**32
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F


class RecoveredMcap:
    """An mcap file, read record by record from its start.

    Attributes
    ----------
    channels : topics that hold whole messages, and how many.

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._topics: dict[int, tuple[str, str]] = {}
        counts: dict[tuple[str, str], int] = {}
        for channel_id, _, _ in self._messages():
            key = self._topics[channel_id]
            counts[key] = counts.get(key, 0) + 1
        self.channels = [Channel(*key, count) for key, count in counts.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the whole messages of some topics in the order of the file."""
        for channel_id, stamp_ns, data in self._messages():
            topic, msgtype = self._topics[channel_id]
            if topic in topics:
                yield topic, msgtype, stamp_ns, data

    def close(self) -> None:
        """Do nothing: the file is open only while it is read."""

    def _messages(self) -> Iterator[tuple[int, int, bytes]]:
        # Mapped, not read: a bag may be larger than the memory.
        with (self._path.open('rb') as stream,
              mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data):
            if data[:len(_MCAP_MAGIC)] == _MCAP_MAGIC:
                yield from self._scan(data)

    def _scan(self, data: mmap.mmap) -> Iterator[tuple[int, int, bytes]]:
        """Yield channel, time and data of each message; note the channels on the way."""
        schemas: dict[int, str] = {}
        for opcode, record in _records(data, len(_MCAP_MAGIC)):
            inner = _records(_chunk(record), 0) if opcode == _CHUNK else [(opcode, record)]
            for kind, body in inner:
                if kind == _SCHEMA and len(body) >= 2:
                    schemas[_uint(body, 0, 2)] = _text(body, 2)[0]
                elif kind == _CHANNEL and len(body) >= 4:
                    topic, end = _text(body, 4)
                    if _text(body, end)[0] == 'cdr':
                        self._topics[_uint(body, 0, 2)] = (
                            topic, schemas.get(_uint(body, 2, 2), ''))
                elif kind == _MESSAGE and len(body) >= 22:
                    channel_id, _, stamp_ns, _ = struct.unpack_from('<HIQQ', body)
                    if channel_id in self._topics:
                        yield channel_id, stamp_ns, body[22:]


class RecoveredSqlite:
    """A sqlite3 bag, read row by row in the order they were written.

    Attributes
    ----------
    channels : topics that hold whole messages, and how many.

    """

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(
            f'{path.absolute().as_uri()}?mode=ro&immutable=1', uri=True)
        self._topics: dict[int, tuple[str, str]] = {}
        counts: dict[tuple[str, str], int] = {}
        try:
            # Without it, sqlite refuses a file that is shorter than its header says. The file
            # is open read-only: nothing is written.
            self._connection.execute('PRAGMA writable_schema = ON')
            for topic_id, name, msgtype in self._connection.execute(
                    'SELECT id, name, type FROM topics'):
                self._topics[topic_id] = str(name), str(msgtype)
            for topic_id, _, _ in self._rows():
                key = self._topics[topic_id]
                counts[key] = counts.get(key, 0) + 1
        except DAMAGE:
            self._connection.close()
            raise
        self.channels = [Channel(*key, count) for key, count in counts.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in the order of the file."""
        for topic_id, stamp_ns, data in self._rows():
            topic, msgtype = self._topics[topic_id]
            if topic in topics:
                yield topic, msgtype, stamp_ns, data

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _rows(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield the rows, stepping over damaged pages by ever longer strides."""
        after, stride = 0, 1
        while stride < _LONGEST_STRIDE:
            with suppress(*DAMAGE):
                for row_id, topic_id, stamp_ns, data in self._connection.execute(
                        'SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? '
                        'ORDER BY id', (after,)):
                    # A damaged page may give any number for a row: never go back.
                    after, stride = max(after, row_id), 1
                    whole = isinstance(stamp_ns, int) and isinstance(data, bytes)
                    if whole and topic_id in self._topics:
                        yield topic_id, stamp_ns, data
                return
            after += stride
            stride *= 2


def _records(data: bytes | mmap.mmap, offset: int) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of each record; of a last one that is cut off, what is there.

    Only a chunk is of any use when cut off: its readers check the sizes of what is inside.
    """
    while offset + 9 <= len(data):
        opcode, size = struct.unpack_from('<BQ', data, offset)
        if opcode in (0, _DATA_END):
            return
        if offset + 9 + size > len(data) and opcode != _CHUNK:
            return
        yield opcode, data[offset + 9:offset + 9 + size]
        offset += 9 + size


def _chunk(record: bytes) -> bytes:
    """Return the records inside a chunk; none where it is damaged."""
    if len(record) < 40:
        return b''
    size, crc = struct.unpack_from('<QI', record, 16)
    compression, start = _text(record, 28)
    stored = record[start + 8:start + 8 + _uint(record, start, 8)]
    try:
        data = DECOMPRESSORS[compression](stored, size)
    except DAMAGE:
        return b''
    cut_off = len(data) < size and not compression
    return data if cut_off or (len(data) == size and crc in (0, crc32(data))) else b''


def _uint(data: bytes, offset: int, size: int) -> int:
    return int.from_bytes(data[offset:offset + size], 'little')


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """Return the string at an offset and where it ends."""
    end = offset + 4 + _uint(data, offset, 4)
    return data[offset + 4:end].decode(errors='replace'), end
