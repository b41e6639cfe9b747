# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: their paths, metadata.yaml, and the reader of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing, ExitStack
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from pathlib import Path, PurePath
import re
from tempfile import TemporaryDirectory

from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.sources.channels import (
    Batch,
    Channel,
    errors_noted,
    Storage,
    Unreadable,
)
from trajectory_calibration.sources.packing import unpack, unpack_zstd_file, ZSTD_MAGIC
from trajectory_calibration.sources.text import refuse_pointer

_STORAGE_SUFFIXES = ('.mcap', '.db3')
_PACKED_SUFFIXES = ('.zstd', '.zst')
_SUFFIXES = (*_STORAGE_SUFFIXES, '.bag')


@dataclass(eq=False)
class Bag:
    """A bag on disk.

    Attributes
    ----------
    path : file or folder as given by the user.
    paths : the storage files.
    files : path -> open storage file, after ``open``.
    declared : message count of each topic in metadata.yaml, empty without the file.
    notes : damage of the folder.

    """

    path: Path
    paths: Sequence[Path]
    declared: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def open(self, stack: ExitStack) -> None:
        """Open the files; they close with the ``stack``."""
        self.files = {path: _storage(path, stack, count=not self.declared) for path in self.paths}

    def channels(self) -> list[Channel]:
        """Return the channels of the files, with the counts of metadata.yaml if there are any."""
        found = [channel for storage in self.files.values() for channel in storage.channels]
        declared = dict(self.declared)
        return [channel._replace(messages=declared.pop(channel.topic, 0))
                for channel in found] if declared else found

    def all_notes(self) -> list[str]:
        """Return the damage of the folder and the files found so far."""
        return [f'{self.path}: {note}' for note in self.notes] + [
            f'{path} is damaged: {storage.damage}'
            for path, storage in self.files.items() if storage.damage]

    def missing(self, topic: str, read: int) -> list[str]:
        """Return a note if fewer messages of a topic were ``read`` than expected, else []."""
        expected = max(
            self.declared.get(topic, 0),
            sum(channel.messages for channel in self.channels() if channel.topic == topic))
        if expected > read:
            return [(f'{self.path}: read {read} of {counted(expected, "message")}, '
                     f'{expected - read} missing')]
        known = topic in self.declared or all(item.counted for item in self.files.values())
        if any(item.damage for item in self.files.values()) and not known:
            return [f'{self.path}: read {counted(read, "message")} of an unknown number']
        return []


def find_bag(path: Path) -> Bag:
    """Return the bag at a path.

    Raise SourceError if the path does not exist, or is neither a bag nor a file of one.
    """
    if path.is_dir():
        return _find_folder(path)
    needed = f'needed a rosbag2 folder or a {", ".join(_SUFFIXES)} file'
    if not path.exists():
        raise SourceError(f'{path} does not exist; {needed}')
    if _storage_suffix(path) not in _SUFFIXES:
        raise SourceError(f'{path} is not a bag; {needed}')
    return Bag(path, (path,), notes=_log_note(path))


def _storage(path: Path, stack: ExitStack, *, count: bool) -> Storage:
    """Open a file of a bag; ``count`` requests message counts even if all rows must be counted.

    Raise SourceError for a Git LFS pointer, or if a package for decompression is missing.
    """
    unreadable = Unreadable()
    try:
        with errors_noted(unreadable.note_damage):
            content, damage = _unpacked_file(path, stack)
            storage = _opened(content, stack, count=count)
            storage.damage = damage or storage.damage
            return storage
    except SourceError as error:
        raise SourceError(f'{path}: {error}') from error
    return unreadable


def _unpacked_file(path: Path, stack: ExitStack) -> tuple[Path, str]:
    """Return the path of the decompressed file, and the damage found."""
    with path.open('rb') as stream:
        beginning = stream.read(64)
    refuse_pointer(path, beginning)
    if not beginning:
        raise ValueError('it is empty')
    if not beginning.startswith(ZSTD_MAGIC):
        return path, ''
    folder = stack.enter_context(TemporaryDirectory(prefix='trajectory_calibration_'))
    content = Path(folder) / f'bag{_storage_suffix(path)}'
    return content, unpack_zstd_file(path, content)


def _opened(path: Path, stack: ExitStack, *, count: bool) -> Storage:
    # Each reader is imported only for its files.
    if path.suffix == '.db3':
        from trajectory_calibration.sources.sqlite import connect, SqliteFile
        return SqliteFile(stack.enter_context(closing(connect(path))), count=count)
    with path.open('rb') as stream:
        # Memory-mapped: a bag may be larger than the memory.
        data = stack.enter_context(mmap(stream.fileno(), 0, access=ACCESS_READ))
    if path.suffix == '.mcap':
        from trajectory_calibration.sources.mcap import McapFile
        return McapFile(data)
    from trajectory_calibration.sources.rosbag1 import Ros1File
    return Ros1File(data)


def unpacked(batch: Batch) -> Batch:
    """Return the batch with its messages decompressed, if the recorder compressed each one."""
    # All or none are compressed; several are checked because the first may be damaged.
    if batch.channel.encoding != 'cdr' or not any(
            message.startswith(ZSTD_MAGIC) for message in batch.messages[:9]):
        return batch
    messages: list[bytes] = []
    for message in batch.messages:
        # An empty message is counted as unreadable later.
        with errors_noted(lambda _: messages.append(b'')):
            messages.append(
                unpack(message, 'zstd') if message.startswith(ZSTD_MAGIC) else message)
    return batch._replace(messages=messages)


def _storage_suffix(path: Path) -> str:
    """Return the suffix of a file without the suffix of its compression."""
    return Path(path.stem).suffix if path.suffix in _PACKED_SUFFIXES else path.suffix


def _find_folder(path: Path) -> Bag:
    present = sorted((item for item in path.iterdir()
                      if _storage_suffix(item) in _STORAGE_SUFFIXES), key=natural_key)
    notes = tuple(note for item in present for note in _log_note(item))
    reasons: list[str] = []
    listed: list[str] = []
    declared: dict[str, int] = {}
    with errors_noted(reasons.append):
        listed, declared = _metadata(path)
    if reasons and not present:
        held = (f'its metadata.yaml cannot be read ({reasons[0]}), and it holds no'
                if (path / 'metadata.yaml').exists() else 'it holds no metadata.yaml,')
        raise SourceError(f'{path} is not a bag: {held} .mcap or .db3 file; give a folder that '
                          'ros2 bag wrote, or a bag file')
    if reasons:
        reason = (f'is damaged ({reasons[0]})' if (path / 'metadata.yaml').exists()
                  else 'is missing')
        note = f'metadata.yaml {reason}: read {", ".join(item.name for item in present)}'
        return Bag(path, present, notes=(note, *notes))
    files, missing = [], []
    for name in listed:
        # metadata.yaml may list a compressed file without the suffix of its compression.
        found = [item for item in present if item.name == name or (
            item.suffix in _PACKED_SUFFIXES and item.stem == name)]
        files += found[:1]
        missing += [] if found else [name]
    if missing:
        notes += (f'metadata.yaml lists {", ".join(missing)}, which do not exist',)
    if not files:
        raise SourceError(f'{path}: none of the files that metadata.yaml lists exists: '
                          f'{", ".join(missing)}')
    return Bag(path, files, declared, notes)


def _metadata(path: Path) -> tuple[list[str], dict[str, int]]:
    """Return the file names, and the message count of each topic, from metadata.yaml."""
    from ruamel.yaml import YAML
    text = (path / 'metadata.yaml').read_text(encoding='utf-8')
    metadata = YAML(typ='safe', pure=True).load(text)['rosbag2_bagfile_information']
    listed = [PurePath(name).name for name in metadata['relative_file_paths']]
    declared: Counter[str] = Counter()
    for topic in metadata['topics_with_message_count']:
        declared[str(topic['topic_metadata']['name'])] += int(topic['message_count'])
    return listed, declared


def natural_key(path: Path | str) -> list[tuple[int, str]]:
    """Return a sort key that orders numbers by value: bag_2 before bag_10."""
    return [(int(part), '') if part.isdigit() else (-1, part)
            for part in re.split(r'(\d+)', str(path))]


def _log_note(path: Path) -> tuple[str, ...]:
    """Return a note if a killed recorder left messages in a write-ahead log of sqlite3."""
    log = path.with_name(f'{path.name}-wal')
    if not log.exists() or not log.stat().st_size:
        return ()
    return ((f'{log.name} holds messages that were not read; open {path.name} once with sqlite3 '
             'to merge them'),)
