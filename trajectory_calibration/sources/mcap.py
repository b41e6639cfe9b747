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
# The time is unsigned, but before 2262 that is the same, and NumPy takes what is damaged.
_MESSAGE_HEAD = struct.Struct('<BQHIqQ')
_FOOTER_BYTES = 29


class McapFile(Storage):
    """An open mcap file."""

    def __init__(self, data: mmap.mmap) -> None:
        if data[:len(_MAGIC)] != _MAGIC:
            raise ValueError('it does not begin as an mcap file does')
        self._data = data
        self._schemas: dict[int, str] = {}
        self._chunks: list[int] = []
        self._counts: dict[int, int] | None = None
        super().__init__()

    def _index(self) -> dict[int, int] | None:
        """Read what stands behind the data."""
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
            self._confirm()
        return self._counts

    def _confirm(self) -> None:
        """Raise ValueError where the channels of the first chunk are not those of the index."""
        indexed = dict(self._declared)
        chunk = next((place for opcode, *place in self._walk() if opcode == _CHUNK), None)
        if chunk:
            list(self._records(*self._unpacked(*chunk)))
        if self._declared != indexed:
            raise ValueError('it differs from the data')

    def _note(self, opcode: int, body: bytes) -> None:
        """Keep what a record says of channels and chunks."""
        if opcode == _SCHEMA and len(body) >= 2:
            self._schemas[_uint(body, 0, 2)] = _text(body, 2)[0]
        elif opcode == _CHANNEL and len(body) >= 4:
            topic, end = _text(body, 4)
            encoding, _ = _text(body, end)
            self._declare(_uint(body, 0, 2), Channel(
                topic, plain_type(self._schemas.get(_uint(body, 2, 2), '')), 0, encoding))
        elif opcode == _STATISTICS:
            self._counts = dict(struct.iter_unpack('<HQ', body[46:46 + _uint(body, 42, 4)]))
        elif opcode == _CHUNK_INDEX:
            self._chunks.append(_uint(body, 16, 8))

    def _read(self) -> Iterator[tuple[int, int, bytes]]:
        for opcode, start, end in self._walk():
            if opcode == _CHUNK:
                with self.noting('records inside a chunk are damaged'):
                    yield from self._records(*self._unpacked(start, end))
            else:
                yield from self._records(self._data, start, end)

    def _walk(self) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, start and end of each record of the data, over what is damaged."""
        offset, last = len(_MAGIC), len(self._data)
        while offset + _HEAD.size <= last:
            opcode, size = _HEAD.unpack_from(self._data, offset)
            end = offset + _HEAD.size + size
            if opcode in (_DATA_END, _FOOTER):
                return
            known = 0 < opcode < _DATA_END
            if known and (end <= last or opcode == _CHUNK):
                yield opcode, offset, min(end, last)
            # From 0x80 on, opcodes are for extensions.
            if end <= last and (known or opcode >= 0x80):
                offset = end
                continue
            self.note_damage(f'its record at byte {offset} is damaged or cut off')
            # The index, where it is whole, tells where the next chunk begins.
            offset = min((chunk for chunk in self._chunks if self.counted and chunk > offset),
                         default=last)
        self.note_damage('its end is missing')

    def _unpacked(self, start: int, end: int) -> tuple[bytes, int, int]:
        """Return the records of a chunk, where they begin, and where they end.

        None where it is damaged, what is there if cut.
        """
        compression, size, crc, data = '', 0, 0, b''
        damaged = f'its chunk at byte {start} is damaged'
        with self.noting(f'{damaged} ({{}})'):
            record = self._data[start + _HEAD.size:end]
            size, crc = struct.unpack_from('<QI', record, 16)
            compression, at = _text(record, 28)
            data = unpack(record[at + 8:at + 8 + _uint(record, at, 8)], compression)
        if len(data) != size or (crc and crc32(data) != crc):
            self.note_damage(f'{damaged} (wrong size or checksum)')
            # Of a last chunk that is cut off, the beginning is whole.
            data = data if len(data) < size and not compression else b''
        # The head of a message may be read beyond the end.
        return data + bytes(_MESSAGE_HEAD.size), 0, len(data)

    def _records(
        self, data: bytes | mmap.mmap, offset: int, end: int,
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages between two offsets; keep what the other records say."""
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
                self._note(opcode, data[start + _HEAD.size:offset])


def _uint(data: bytes | mmap.mmap, offset: int, size: int) -> int:
    return int.from_bytes(data[offset:offset + size], 'little')


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """Return the string at an offset and where it ends."""
    end = offset + 4 + _uint(data, offset, 4)
    return data[offset + 4:end].decode(errors='replace'), end
