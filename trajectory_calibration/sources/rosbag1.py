# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag of ROS 1, read record by record from its start, with its index as a check only.

A bag that was not closed, or is cut off, needs no reader of its own then: what is whole is read.
The format: http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
import mmap
from pathlib import Path
import struct

from trajectory_calibration.sources.channels import Batch, Channel, plain_type
from trajectory_calibration.sources.packing import unpack

_MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_REINDEX = 'rosbag reindex writes a new index'
_BLOCK = 8192


class Ros1File:
    """An open bag of ROS 1.

    Attributes
    ----------
    channels : topics, types and how many messages the index declares; counted without one.
    damage : what was found wrong, empty so far if nothing.
    counted : whether the counts are those of the index.

    """

    def __init__(self, path: Path) -> None:
        self.damage = ''
        self._channels: dict[int, Channel] = {}
        with path.open('rb') as stream:
            # Mapped, not read: a bag may be larger than the memory.
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        if self._data[:len(_MAGIC)] != _MAGIC:
            kind = 'a bag of an older ROS' if self._data[:7] == b'#ROSBAG' else 'no bag of ROS 1'
            raise ValueError(f'it begins as {kind} does; needed #ROSBAG V2.0')
        counts = self._index()
        self.counted = counts is not None
        if counts is None:
            counts = {}
            for connection, received, _ in self._batches(None):
                counts[connection] = counts.get(connection, 0) + len(received)
        self.channels = [channel._replace(messages=counts.get(key, 0))
                         for key, channel in self._channels.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics, in the order of the file within each of them."""
        for connection, received, messages in self._batches(topics):
            yield Batch(self._channels[connection], received, messages)

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def _index(self) -> dict[int, int] | None:
        """Read connections and counts from the end of the bag, if they are there."""
        try:
            fields, _, _ = _record(self._data, len(_MAGIC), len(self._data))
            connections = int.from_bytes(fields[b'conn_count'], 'little')
            start = int.from_bytes(fields[b'index_pos'], 'little')
            if not start:
                self.damage = f'it was not closed and has no index; {_REINDEX}'
                return None
            counts: dict[int, int] = {}
            for operation, fields, body in _records(self._data, start, len(self._data)):
                if operation == _CONNECTION:
                    self._note(fields, body)
                elif operation == _CHUNK_INFO:
                    for connection, count in struct.iter_unpack('<II', body):
                        counts[connection] = counts.get(connection, 0) + count
        except Exception as error:  # noqa: BLE001
            # Whatever the first wrong length or character of a damaged file hits; what was
            # understood so far is not trusted.
            self.damage = (f'its index is damaged or cut off ({error or type(error).__name__}); '
                           f'{_REINDEX}')
            self._channels = {}
            return None
        if len(self._channels) != connections:
            self.damage = f'its index is cut off; {_REINDEX}'
            self._channels = {}
            return None
        return counts

    def _note(self, fields: dict[bytes, bytes], body: bytes) -> None:
        """Keep a connection."""
        described = _fields(body)
        self._channels[int.from_bytes(fields[b'conn'], 'little')] = Channel(
            fields[b'topic'].decode(), plain_type(described[b'type'].decode()), 0, 'ros1')

    def _batches(
        self, topics: Collection[str] | None,
    ) -> Iterator[tuple[int, list[int], list[bytes]]]:
        """Yield connection, times and messages; without the messages where no topics are given."""
        gathered: dict[int, tuple[list[int], list[bytes]]] = {}
        count = 0
        for operation, fields, body in self._walk():
            if operation == _CONNECTION:
                try:
                    self._note(fields, body)
                except Exception:  # noqa: BLE001
                    # As in _index.
                    self._damaged('a connection is damaged')
            elif operation == _MESSAGE:
                connection = int.from_bytes(fields.get(b'conn', b''), 'little')
                channel, time = self._channels.get(connection), fields.get(b'time', b'')
                if channel is None or len(time) != 8:
                    self._damaged('messages of a connection that is not declared')
                elif topics is None or channel.topic in topics:
                    received, messages = gathered.setdefault(connection, ([], []))
                    sec, nanosec = struct.unpack('<II', time)
                    received.append(sec * 1_000_000_000 + nanosec)
                    if topics is not None:
                        messages.append(body)
                    count += 1
            if count >= _BLOCK:
                for key, lists in gathered.items():
                    yield key, *lists
                gathered, count = {}, 0
        for key, lists in gathered.items():
            yield key, *lists

    def _walk(self) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
        """Yield the records of the bag and of its chunks, up to where it is damaged."""
        for operation, fields, body in self._whole(self._data, len(_MAGIC), len(self._data)):
            if operation != _CHUNK:
                yield operation, fields, body
                continue
            try:
                size = int.from_bytes(fields[b'size'], 'little')
                chunk = unpack(body, fields[b'compression'].decode(), size)
            except Exception as error:  # noqa: BLE001
                # As in _index: a damaged chunk makes its decompressor raise anything.
                self._damaged(f'a chunk is damaged ({error or type(error).__name__})')
                continue
            if len(chunk) != size:
                self._damaged('a chunk is damaged (wrong size)')
            yield from self._whole(chunk, 0, len(chunk))

    def _whole(
        self, data: bytes | mmap.mmap, start: int, end: int,
    ) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
        """Yield records up to one that is damaged, which is noted."""
        records = _records(data, start, end)
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except Exception as error:  # noqa: BLE001
                # As in _index.
                self._damaged('it is cut off or damaged '
                              f'({error or type(error).__name__}); {_REINDEX}')
                return
            yield record

    def _damaged(self, what: str) -> None:
        self.damage = self.damage or what


def _records(
    data: bytes | mmap.mmap, offset: int, end: int,
) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    """Yield operation, header fields and body of each record."""
    while offset < end:
        fields, body, offset = _record(data, offset, end)
        yield fields[b'op'][0], fields, body


def _record(
    data: bytes | mmap.mmap, offset: int, end: int,
) -> tuple[dict[bytes, bytes], bytes, int]:
    """Return header fields and body of a record, and where the next one begins."""
    (size,) = struct.unpack_from('<I', data, offset)
    start = offset + 4 + size
    (length,) = struct.unpack_from('<I', data, start)
    stop = start + 4 + length
    if stop > end:
        raise ValueError('a record ends beyond the file')
    return _fields(data[offset + 4:start]), data[start + 4:stop], stop


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header, each a length and ``name=value``."""
    fields: dict[bytes, bytes] = {}
    offset = 0
    while offset < len(header):
        (size,) = struct.unpack_from('<I', header, offset)
        name, separator, value = header[offset + 4:offset + 4 + size].partition(b'=')
        if not separator:
            raise ValueError('a field has no name')
        fields[name] = value
        offset += 4 + size
    return fields
