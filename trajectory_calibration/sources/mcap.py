# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""An mcap file. The format: https://mcap.dev/spec."""

from __future__ import annotations

from collections.abc import Iterator
import mmap
import struct
from zlib import crc32

from trajectory_calibration.sources.channels import Channel, plain_type, Storage
from trajectory_calibration.sources.packing import unpack

_MAGIC = b'\x89MCAP0\r\n'
_FOOTER = 0x02
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x03, 0x04, 0x05, 0x06
_CHUNK_INDEX, _STATISTICS, _DATA_END = 0x08, 0x0B, 0x0F
_HEAD = struct.Struct('<BQ')
# The time is unsigned. Read as signed it is the same before 2262, and a damaged one fits int64.
_MESSAGE_HEAD = struct.Struct('<BQHIqQ')
_FOOTER_BYTES = 29


class McapFile(Storage):
    """An open mcap file."""

    def __init__(self, data: mmap.mmap) -> None:
        if data[:len(_MAGIC)] != _MAGIC:
            raise ValueError('it is no mcap file')
        self._data = data
        self._schemas: dict[int, str] = {}
        self._chunks: list[int] = []
        self._counts: dict[int, int] | None = None
        super().__init__()

    def _index(self) -> dict[int, int] | None:
        """Read the summary section after the data."""
        end = len(self._data) - len(_MAGIC) - _FOOTER_BYTES
        if end < 0 or self._data[-len(_MAGIC):] != _MAGIC or self._data[end] != _FOOTER:
            self.note_damage('its end is missing')
            return None
        start, crc = _uint(self._data, end + 9, 8), _uint(self._data, end + 25, 4)
        if not start:
            return None
        if crc and crc32(self._data[start:end + 25]) != crc:
            raise ValueError('wrong checksum')
        list(self._records(self._data, start, end))
        if not crc:
            self._check_index()
        return self._counts

    def _check_index(self) -> None:
        """Raise ValueError if the channels of the first chunk differ from those of the index."""
        indexed = dict(self._declared)
        chunk = next((place for opcode, *place in self._data_records() if opcode == _CHUNK), None)
        if chunk:
            list(self._records(*self._chunk_records(*chunk)))
        if self._declared != indexed:
            raise ValueError('it differs from the data')

    def _store(self, opcode: int, body: bytes) -> None:
        """Store the schema, channel, counts or chunk offset of a record."""
        if opcode == _SCHEMA and len(body) >= 2:
            self._schemas[_uint(body, 0, 2)] = _string(body, 2)[0]
        elif opcode == _CHANNEL and len(body) >= 4:
            topic, end = _string(body, 4)
            encoding, _ = _string(body, end)
            self._declare(_uint(body, 0, 2), Channel(
                topic, plain_type(self._schemas.get(_uint(body, 2, 2), '')), 0, encoding))
        elif opcode == _STATISTICS:
            self._counts = dict(struct.iter_unpack('<HQ', body[46:46 + _uint(body, 42, 4)]))
        elif opcode == _CHUNK_INDEX:
            self._chunks.append(_uint(body, 16, 8))

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        for opcode, start, end in self._data_records():
            if opcode == _CHUNK:
                with self.noting('records inside a chunk are damaged'):
                    yield from self._records(*self._chunk_records(start, end))
            else:
                yield from self._records(self._data, start, end)

    def _data_records(self) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, start and end of each record of the data section; skip damaged ones."""
        offset, last = len(_MAGIC), len(self._data)
        while offset + _HEAD.size <= last:
            opcode, size = _HEAD.unpack_from(self._data, offset)
            end = offset + _HEAD.size + size
            if opcode in (_DATA_END, _FOOTER):
                return
            known = 0 < opcode < _DATA_END
            if known and (end <= last or opcode == _CHUNK):
                yield opcode, offset, min(end, last)
            # Opcodes from 0x80 on are extensions.
            if end <= last and (known or opcode >= 0x80):
                offset = end
                continue
            self.note_damage(f'its record at byte {offset} is damaged or cut off')
            # An intact index gives the offset of the next chunk.
            offset = min((chunk for chunk in self._chunks if self.counted and chunk > offset),
                         default=last)
        self.note_damage('its end is missing')

    def _chunk_records(self, start: int, end: int) -> tuple[bytes, int, int]:
        """Return the records of a chunk, and their start and end offset.

        A damaged chunk gives no records; a truncated one gives its first records if it is not
        compressed.
        """
        compression, size, crc, data = '', 0, 0, b''
        damaged = f'its chunk at byte {start} is damaged'
        with self.noting(f'{damaged} ({{}})'):
            record = self._data[start + _HEAD.size:end]
            size, crc = struct.unpack_from('<QI', record, 16)
            compression, at = _string(record, 28)
            data = unpack(record[at + 8:at + 8 + _uint(record, at, 8)], compression)
        if len(data) != size or (crc and crc32(data) != crc):
            self.note_damage(f'{damaged} (wrong size or checksum)')
            # The beginning of a truncated last chunk is intact.
            data = data if len(data) < size and not compression else b''
        # Padding: a message head is unpacked also at the last, shorter record.
        return data + bytes(_MESSAGE_HEAD.size), 0, len(data)

    def _records(
        self, data: bytes | mmap.mmap, offset: int, end: int,
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages between two offsets; store the other records."""
        wanted = self._wanted
        while offset + _MESSAGE_HEAD.size <= len(data) and offset < end:
            opcode, size, channel_id, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(data, offset)
            start, offset = offset, offset + _HEAD.size + size
            if offset > end or not 0 < opcode < _DATA_END:
                raise ValueError('a record is cut off')
            if opcode == _MESSAGE:
                if wanted.get(channel_id):
                    yield channel_id, time_ns, data[start + _MESSAGE_HEAD.size:offset]
                elif channel_id not in wanted:
                    self.note_damage('messages of a channel that is not declared')
            else:
                self._store(opcode, data[start + _HEAD.size:offset])


def _uint(data: bytes | mmap.mmap, offset: int, size: int) -> int:
    return int.from_bytes(data[offset:offset + size], 'little')


def _string(data: bytes, offset: int) -> tuple[str, int]:
    """Return the string at an offset, and the offset after it."""
    end = offset + 4 + _uint(data, offset, 4)
    return data[offset + 4:end].decode(errors='replace'), end
