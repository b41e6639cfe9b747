# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag of ROS 1. The format: http://wiki.ros.org/Bags/Format/2.0."""

from __future__ import annotations

from collections.abc import Iterator
import mmap
import struct

from trajectory_calibration.sources.channels import border, Channel, plain_type
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
        counts: dict[int, int] = {}
        whole = False
        with border(lambda reason: self.note_damage(
                f'its index is damaged or cut off ({reason}); {_REINDEX}')):
            fields, _, _ = _record(self._data, len(_MAGIC), len(self._data))
            connections = int.from_bytes(fields[b'conn_count'], 'little')
            start = int.from_bytes(fields[b'index_pos'], 'little')
            if not start:
                self.note_damage(f'it was not closed and has no index; {_REINDEX}')
                return None
            for operation, fields, body in _records(self._data, start, len(self._data)):
                if operation == _CONNECTION:
                    self._note(fields, body)
                elif operation == _CHUNK_INFO:
                    for connection, count in struct.iter_unpack('<II', body):
                        counts[connection] = counts.get(connection, 0) + count
            if len(self._declared) != connections:
                raise ValueError(f'{len(self._declared)} of {connections} connections')
            whole = True
        if whole:
            return counts
        # What was understood of it is not trusted.
        self._declared = {}
        return None

    def _note(self, fields: dict[bytes, bytes], body: bytes) -> None:
        """Keep a connection."""
        described = _fields(body)
        self._declared[int.from_bytes(fields[b'conn'], 'little')] = Channel(
            fields[b'topic'].decode(), plain_type(described[b'type'].decode()), 0, 'ros1')

    def _read(self, gathered: Gathered) -> Iterator[None]:
        for operation, fields, body in self._walk():
            if operation == _CONNECTION:
                with border(lambda reason: self.note_damage(
                        f'a connection is damaged ({reason})')):
                    self._note(fields, body)
            elif operation == _MESSAGE:
                key = int.from_bytes(fields.get(b'conn', b''), 'little')
                time = fields.get(b'time', b'')
                if key not in self._declared or len(time) != 8:
                    self.note_damage('messages of a connection that is not declared')
                    continue
                if key not in gathered.targets:
                    gathered.open(key, self._declared[key])
                target = gathered.targets[key]
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
            with border(lambda reason: self.note_damage(f'a chunk is damaged ({reason})')):
                size = int.from_bytes(fields[b'size'], 'little')
                chunk = unpack(body, fields[b'compression'].decode(), size)
            if len(chunk) != size:
                self.note_damage('a chunk is damaged (wrong size)')
            yield from self._whole(chunk, 0)

    def _whole(self, data: bytes | mmap.mmap, start: int) -> Iterator[_Record]:
        """Yield records up to one that is damaged, which is noted."""
        with border(lambda reason: self.note_damage(
                f'it is cut off or damaged ({reason}); {_REINDEX}')):
            yield from _records(data, start, len(data))


def _records(
    data: bytes | mmap.mmap, offset: int, end: int,
) -> Iterator[_Record]:
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
