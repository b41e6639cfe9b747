# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag of ROS 1. The format: http://wiki.ros.org/Bags/Format/2.0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import mmap
import struct

from trajectory_calibration.sources.channels import Channel, plain_type, Storage
from trajectory_calibration.sources.packing import unpack

_MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 5, 6, 7
_REINDEX = 'rosbag reindex writes a new index'


class Ros1File(Storage):
    """An open bag of ROS 1."""

    index_damage = f'its index is damaged or cut off ({{}}); {_REINDEX}'

    def __init__(self, data: mmap.mmap) -> None:
        if data[:len(_MAGIC)] != _MAGIC:
            kind = 'a bag of an older ROS' if data[:7] == b'#ROSBAG' else 'no bag of ROS 1'
            raise ValueError(f'it is {kind}; needed #ROSBAG V2.0')
        self._data = data
        super().__init__()

    def _index(self) -> Counter[int] | None:
        """Read connections and counts from the index at the end of the bag, if it has one."""
        _, head, _ = next(_records(self._data, len(_MAGIC)))
        connections, start = (_uint(head[name]) for name in (b'conn_count', b'index_pos'))
        if not start:
            self.note_damage(f'it was not closed and has no index; {_REINDEX}')
            return None
        counts: Counter[int] = Counter()
        for operation, fields, body in _records(self._data, start):
            if operation == _CONNECTION:
                self._declare_connection(fields, body)
            elif operation == _CHUNK_INFO:
                for connection, count in struct.iter_unpack('<II', body):
                    counts[connection] += count
        if len(self._declared) != connections:
            raise ValueError(f'{len(self._declared)} of {connections} connections')
        return counts

    def _declare_connection(self, fields: dict[bytes, bytes], body: bytes) -> None:
        """Declare a connection as a channel."""
        msgtype = plain_type(_fields(body)[b'type'].decode())
        self._declare(_uint(fields[b'conn']), Channel(
            fields[b'topic'].decode(), msgtype, 0, 'ros1'))

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        return self._messages(self._data, len(_MAGIC))

    def _messages(
        self, data: bytes | mmap.mmap, offset: int,
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages, also those in chunks, from an offset up to a damaged record."""
        with self.noting(f'it is cut off or damaged ({{}}); {_REINDEX}'):
            for operation, fields, body in _records(data, offset):
                if operation == _CHUNK:
                    yield from self._messages(self._chunk_records(fields, body), 0)
                elif operation == _CONNECTION:
                    with self.noting('a connection is damaged ({})'):
                        self._declare_connection(fields, body)
                elif operation == _MESSAGE:
                    key, time = _uint(fields.get(b'conn', b'')), fields.get(b'time', b'')
                    if key not in self._wanted or len(time) != 8:
                        self.note_damage('messages of a connection that is not declared')
                    elif self._wanted[key]:
                        sec, nanosec = struct.unpack('<II', time)
                        yield key, sec * 1_000_000_000 + nanosec, body

    def _chunk_records(self, fields: dict[bytes, bytes], body: bytes) -> bytes:
        """Return the records of a chunk; none if it cannot be decompressed."""
        size, chunk = 0, b''
        with self.noting('a chunk is damaged ({})'):
            size = _uint(fields[b'size'])
            chunk = unpack(body, fields[b'compression'].decode())
        if len(chunk) != size:
            self.note_damage('a chunk is damaged (wrong size)')
        return chunk


def _uint(data: bytes) -> int:
    return int.from_bytes(data, 'little')


def _records(
    data: bytes | mmap.mmap, offset: int,
) -> Iterator[tuple[int, dict[bytes, bytes], bytes]]:
    """Yield operation, header fields and body of each record."""
    while offset < len(data):
        (size,) = struct.unpack_from('<I', data, offset)
        start = offset + 4 + size
        (length,) = struct.unpack_from('<I', data, start)
        fields, offset = _fields(data[offset + 4:start]), start + 4 + length
        if offset > len(data):
            raise ValueError('a record ends beyond the file')
        yield fields[b'op'][0], fields, data[start + 4:offset]


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a record header, each stored as a length and ``name=value``."""
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
