# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag of ROS 1. The format: http://wiki.ros.org/Bags/Format/2.0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import mmap
import struct

from trajectory_calibration.sources.channels import Channel, plain_type
from trajectory_calibration.sources.packing import unpack
from trajectory_calibration.sources.records import Gathered, RecordFile

_MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 5, 6, 7
_REINDEX = 'rosbag reindex writes a new index'

_Record = tuple[int, dict[bytes, bytes], bytes]


class Ros1File(RecordFile):
    """An open bag of ROS 1."""

    def _index(self) -> dict[int, int] | None:
        """Read connections and counts from the end of the bag, if they are there."""
        if self._data[:len(_MAGIC)] != _MAGIC:
            kind = 'a bag of an older ROS' if self._data[:7] == b'#ROSBAG' else 'no bag of ROS 1'
            raise ValueError(f'it begins as {kind} does; needed #ROSBAG V2.0')
        counts: Counter[int] | None = None
        with self.noting(f'its index is damaged or cut off ({{}}); {_REINDEX}'):
            fields, _, _ = _record(self._data, len(_MAGIC), len(self._data))
            connections, start = (_uint(fields[name]) for name in (b'conn_count', b'index_pos'))
            if not start:
                self.note_damage(f'it was not closed and has no index; {_REINDEX}')
                return None
            found: Counter[int] = Counter()
            for operation, fields, body in _records(self._data, start, len(self._data)):
                if operation == _CONNECTION:
                    self._note(fields, body)
                elif operation == _CHUNK_INFO:
                    for connection, count in struct.iter_unpack('<II', body):
                        found[connection] += count
            if len(self._declared) != connections:
                raise ValueError(f'{len(self._declared)} of {connections} connections')
            counts = found
        if counts is None:
            # What was understood of it is not trusted.
            self._declared.clear()
        return counts

    def _note(self, fields: dict[bytes, bytes], body: bytes) -> None:
        """Keep a connection."""
        msgtype = plain_type(_fields(body)[b'type'].decode())
        self._declared[_uint(fields[b'conn'])] = Channel(
            fields[b'topic'].decode(), msgtype, 0, 'ros1')

    def _read(self, gathered: Gathered) -> Iterator[None]:
        for operation, fields, body in self._walk():
            if operation == _CONNECTION:
                with self.noting('a connection is damaged ({})'):
                    self._note(fields, body)
            elif operation == _MESSAGE:
                key, time = _uint(fields.get(b'conn', b'')), fields.get(b'time', b'')
                if key not in self._declared or len(time) != 8:
                    self.note_damage('messages of a connection that is not declared')
                    continue
                target = gathered[key]
                if target is not None:
                    received, messages = target
                    sec, nanosec = struct.unpack('<II', time)
                    received.append(sec * 1_000_000_000 + nanosec)
                    if messages is not None:
                        messages.append(body)
                    gathered.count += 1
            yield

    def _walk(self) -> Iterator[_Record]:
        """Yield the records of the bag and of its chunks, up to where it is damaged."""
        for operation, fields, body in self._whole(self._data, len(_MAGIC)):
            if operation != _CHUNK:
                yield operation, fields, body
                continue
            size, chunk = 0, b''
            with self.noting('a chunk is damaged ({})'):
                size = _uint(fields[b'size'])
                chunk = unpack(body, fields[b'compression'].decode(), size)
            if len(chunk) != size:
                self.note_damage('a chunk is damaged (wrong size)')
            yield from self._whole(chunk, 0)

    def _whole(self, data: bytes | mmap.mmap, start: int) -> Iterator[_Record]:
        """Yield records up to one that is damaged, which is noted."""
        with self.noting(f'it is cut off or damaged ({{}}); {_REINDEX}'):
            yield from _records(data, start, len(data))


def _uint(data: bytes) -> int:
    return int.from_bytes(data, 'little')


def _records(data: bytes | mmap.mmap, offset: int, end: int) -> Iterator[_Record]:
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
