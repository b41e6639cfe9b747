# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""An mcap file, read record by record from its start, with its index as a check only.

A file without an index, or cut off, or with damaged chunks, then needs no reader of its own: what
is whole is read, and what the statistics at the end declare tells how much is missing.
The format: https://mcap.dev/spec.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
import mmap
from pathlib import Path
import struct
from zlib import crc32

from trajectory_calibration.sources.channels import Batch, Channel, plain_type
from trajectory_calibration.sources.packing import unpack

_MAGIC = b'\x89MCAP0\r\n'
_FOOTER = 0x02
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x03, 0x04, 0x05, 0x06
_CHUNK_INDEX, _STATISTICS, _DATA_END = 0x08, 0x0B, 0x0F
# Opcodes from here on are for extensions.
_PRIVATE = 0x80
_HEAD = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<BQHIQQ')
_FOOTER_BYTES = 29

# Messages that wait until they become numbers: enough to make NumPy's overhead vanish.
_BLOCK = 8192


class McapFile:
    """An open mcap file.

    Attributes
    ----------
    channels : topics, types and how many messages the statistics declare; counted where there
        are none.
    damage : what was found wrong, empty so far if nothing.
    counted : whether the counts are those of the statistics.

    """

    def __init__(self, path: Path) -> None:
        self.damage = ''
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, str] = {0: ''}
        self._chunks: list[int] = []
        with path.open('rb') as stream:
            # Mapped, not read: a bag may be larger than the memory.
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        if self._data[:len(_MAGIC)] != _MAGIC:
            raise ValueError('it does not begin as an mcap file does')
        counts = self._summary()
        self.counted = counts is not None
        if counts is None:
            counts = {}
            for channel_id, received, _ in self._batches(None):
                counts[channel_id] = counts.get(channel_id, 0) + len(received)
        self.channels = [channel._replace(messages=counts.get(key, 0))
                         for key, channel in self._channels.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics, in the order of the file within each of them."""
        for channel_id, received, messages in self._batches(topics):
            yield Batch(self._channels[channel_id], received, messages)

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def _summary(self) -> dict[int, int] | None:
        """Read what stands behind the data; return the messages of each channel, if it says."""
        end = len(self._data) - len(_MAGIC) - _FOOTER_BYTES
        if end < 0 or self._data[-len(_MAGIC):] != _MAGIC or self._data[end] != _FOOTER:
            self.damage = 'its end is missing'
            return None
        start = int.from_bytes(self._data[end + 9:end + 17], 'little')
        if not start:
            return None
        counts = None
        try:
            crc = _uint(self._data, end + 25, 4)
            _check(self._data[start:end + 25], crc)
            for opcode, body in _records(self._data, start, end):
                if opcode == _STATISTICS:
                    counts = dict(struct.iter_unpack('<HQ', body[46:46 + _uint(body, 42, 4)]))
                elif opcode == _CHUNK_INDEX:
                    self._chunks.append(_uint(body, 16, 8))
                else:
                    self._note(opcode, body)
        except Exception as error:  # noqa: BLE001
            # Whatever the first wrong length, offset or character of a damaged file hits: of 17
            # kinds seen, none tells more than that. What was understood so far is not trusted.
            self.damage = f'its index is damaged: {error or type(error).__name__}'
            self._channels, self._schemas, self._chunks = {}, {0: ''}, []
            return None
        if not crc and not self._confirmed():
            self.damage = 'its index is damaged: it differs from the data'
            self._channels, self._schemas, self._chunks = {}, {0: ''}, []
            return None
        return counts

    def _confirmed(self) -> bool:
        """Tell whether the channels of the first chunk are those of the index."""
        indexed, schemas = dict(self._channels), dict(self._schemas)
        first = next(((start, end) for opcode, start, end in self._walk() if opcode == _CHUNK),
                     None)
        if first is None:
            return True
        self._channels = {}
        chunk = self._chunk(self._data[first[0] + _HEAD.size:first[1]], first[0])
        self._gather(chunk + bytes(_MESSAGE_HEAD.size), 0, len(chunk), _Gathered(()))
        found, self._channels, self._schemas = self._channels, indexed, schemas
        return all(indexed.get(key) == channel for key, channel in found.items())

    def _note(self, opcode: int, body: bytes) -> None:
        """Keep what a record says of the channels."""
        if opcode == _SCHEMA and len(body) >= 2:
            self._schemas[_uint(body, 0, 2)] = _text(body, 2)[0]
        elif opcode == _CHANNEL and len(body) >= 4:
            topic, end = _text(body, 4)
            encoding, _ = _text(body, end)
            self._channels[_uint(body, 0, 2)] = Channel(
                topic, plain_type(self._schemas.get(_uint(body, 2, 2), '')), 0, encoding)

    def _batches(
        self, topics: Collection[str] | None,
    ) -> Iterator[tuple[int, list[int], list[bytes]]]:
        """Yield channel, times and messages; without the messages where no topics are given."""
        gathered = _Gathered(topics)
        for opcode, start, end in self._walk():
            if opcode == _CHUNK:
                chunk = self._chunk(self._data[start + _HEAD.size:end], start)
                # A message head may be read beyond the end.
                self._gather(chunk + bytes(_MESSAGE_HEAD.size), 0, len(chunk), gathered)
            elif opcode == _MESSAGE:
                self._gather(self._data, start, end, gathered)
            else:
                self._note(opcode, self._data[start + _HEAD.size:end])
                gathered.targets.clear()
            if gathered.count >= _BLOCK:
                yield from gathered.taken()
        yield from gathered.taken()

    def _walk(self) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, start and end of each record of the data, over what is damaged."""
        offset, last = len(_MAGIC), len(self._data)
        while offset + _HEAD.size <= last:
            opcode, size = _HEAD.unpack_from(self._data, offset)
            end = offset + _HEAD.size + size
            if opcode in (_DATA_END, _FOOTER):
                return
            whole = end <= last or opcode == _CHUNK
            if 0 < opcode < _DATA_END or opcode >= _PRIVATE:
                if whole:
                    yield opcode, offset, min(end, last)
                if end <= last:
                    offset = end
                    continue
            self._damaged(f'its record at byte {offset} is damaged or cut off')
            # The index, where it is whole, tells where the next chunk begins.
            offset = min((chunk for chunk in self._chunks if chunk > offset), default=last)
        self._damaged('its end is missing')

    def _chunk(self, record: bytes, offset: int) -> bytes:
        """Return the records inside a chunk; none where it is damaged, what is there if cut."""
        compression = ''
        try:
            size, crc = struct.unpack_from('<QI', record, 16)
            compression, start = _text(record, 28)
            stored = record[start + 8:start + 8 + _uint(record, start, 8)]
            data = unpack(stored, compression, size)
        except Exception as error:  # noqa: BLE001
            # As in _summary: a damaged chunk makes its decompressor raise anything.
            self._damaged(f'its chunk at byte {offset} is damaged ({error or "too short"})')
            return b''
        if len(data) != size or (crc and crc32(data) != crc):
            self._damaged(f'its chunk at byte {offset} is damaged (wrong size or checksum)')
            # Of a last chunk that is cut off, the beginning is whole.
            return data if len(data) < size and not compression else b''
        return data

    def _gather(
        self, data: bytes | mmap.mmap, offset: int, end: int, gathered: _Gathered,
    ) -> None:
        """Take the messages between two offsets; note channels on the way."""
        head, targets = _MESSAGE_HEAD.unpack_from, gathered.targets
        while offset + _MESSAGE_HEAD.size <= len(data) and offset < end:
            opcode, size, channel_id, _, time_ns, _ = head(data, offset)
            stop = offset + _HEAD.size + size
            if stop > end or not 0 < opcode < _DATA_END:
                self._damaged('records inside a chunk are damaged')
                return
            if opcode == _MESSAGE:
                if channel_id not in targets:
                    channel = self._channels.get(channel_id)
                    if channel is None:
                        self._damaged('messages of a channel that is not declared')
                    gathered.open(channel_id, channel)
                target = targets[channel_id]
                if target is not None:
                    received, messages = target
                    received.append(time_ns)
                    if messages is not None:
                        messages.append(data[offset + _MESSAGE_HEAD.size:stop])
                    gathered.count += 1
            elif opcode in (_SCHEMA, _CHANNEL):
                self._note(opcode, data[offset + _HEAD.size:stop])
                targets.clear()
            offset = stop

    def _damaged(self, what: str) -> None:
        self.damage = self.damage or what


class _Gathered:
    """Messages by channel until they are taken.

    Attributes
    ----------
    targets : where those of a channel go, None for channels that nobody wants.
    count : how many are waiting.

    """

    def __init__(self, topics: Collection[str] | None) -> None:
        self.targets: dict[int, tuple[list[int], list[bytes] | None] | None] = {}
        self.count = 0
        self._topics = topics
        self._lists: dict[int, tuple[list[int], list[bytes]]] = {}

    def open(self, channel_id: int, channel: Channel | None) -> None:
        """Decide where the messages of a channel go."""
        if channel is None or (self._topics is not None and channel.topic not in self._topics):
            self.targets[channel_id] = None
            return
        received, messages = self._lists.setdefault(channel_id, ([], []))
        self.targets[channel_id] = received, None if self._topics is None else messages

    def taken(self) -> Iterator[tuple[int, list[int], list[bytes]]]:
        """Yield channel, times and messages, and begin anew."""
        lists, self._lists, self.count = self._lists, {}, 0
        self.targets.clear()
        for channel_id, (received, messages) in lists.items():
            if received:
                yield channel_id, received, messages


def _records(data: mmap.mmap, offset: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of the records of the index."""
    while offset < end:
        opcode, size = _HEAD.unpack_from(data, offset)
        start = offset + _HEAD.size
        if start + size > end:
            raise ValueError('a record is cut off')
        yield opcode, data[start:start + size]
        offset = start + size


def _check(data: bytes, crc: int) -> None:
    if crc and crc32(data) != crc:
        raise ValueError('wrong checksum')


def _uint(data: bytes | mmap.mmap, offset: int, size: int) -> int:
    return int.from_bytes(data[offset:offset + size], 'little')


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """Return the string at an offset and where it ends."""
    end = offset + 4 + _uint(data, offset, 4)
    return data[offset + 4:end].decode(errors='replace'), end
