# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: where they lie, what metadata.yaml says of them, and who reads them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
import re
from tempfile import TemporaryDirectory
from typing import Protocol

from trajectory_calibration.errors import SourceError
from trajectory_calibration.sources.channels import Batch, Channel
from trajectory_calibration.sources.packing import unpack_zstd, unpack_zstd_file, ZSTD_MAGIC
from trajectory_calibration.sources.text import refuse_pointer

_STORAGE_SUFFIXES = ('.mcap', '.db3')
_PACKED_SUFFIXES = ('.zstd', '.zst')
_SUFFIXES = (*_STORAGE_SUFFIXES, '.bag')
_SOME = 9


class Storage(Protocol):
    """An open file of a bag.

    Attributes
    ----------
    channels : topics, types and counts.
    damage : what was found wrong so far; empty where nothing was.
    counted : whether the counts come from an index, and reading can give fewer.

    """

    channels: list[Channel]
    damage: str
    counted: bool

    def messages(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages of some topics, those that are whole."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


@dataclass(frozen=True)
class Bag:
    """A bag as it lies on disk.

    Attributes
    ----------
    path : what the user named, a file or a folder.
    files : the storage files.
    declared : messages of each topic according to metadata.yaml; empty without it.
    notes : what is wrong with the folder.

    """

    path: Path
    files: tuple[Path, ...]
    declared: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def find_bag(path: Path) -> Bag:
    """Return the files of a bag.

    Raises
    ------
    SourceError
        No such file or folder, or neither a bag nor part of one.

    """
    if path.is_dir():
        return _find_folder(path)
    needed = f'needed a rosbag2 folder or a {", ".join(_SUFFIXES)} file'
    if not path.exists():
        raise SourceError(f'{path} does not exist; {needed}')
    if _storage_suffix(path) not in _SUFFIXES:
        raise SourceError(f'{path} is not a bag; {needed}')
    return Bag(path, (path,), notes=_log_note(path))


def open_storage(
    path: Path, *, count: bool,
) -> tuple[Storage, TemporaryDirectory[str] | None]:
    """Open a file of a bag, unpacked into a folder that is returned where it is compressed.

    ``count`` asks for numbers of messages also where that takes time.

    Raises
    ------
    SourceError
        A pointer of Git LFS, or a package is missing that unpacks the file.
    Exception
        Anything else, where the file is damaged.

    """
    with path.open('rb') as stream:
        beginning = stream.read(64)
    refuse_pointer(path, beginning)
    if not beginning:
        raise ValueError('it is empty')
    suffix, folder, damage = _storage_suffix(path), None, ''
    if beginning.startswith(ZSTD_MAGIC):
        folder = TemporaryDirectory(prefix='trajectory_calibration_')
        unpacked = Path(folder.name) / f'bag{suffix}'
        damage = unpack_zstd_file(path, unpacked)
        path = unpacked
    try:
        # Each of them loads where such a file is read.
        storage: Storage
        if suffix == '.mcap':
            from trajectory_calibration.sources.mcap import McapFile
            storage = McapFile(path)
        elif suffix == '.db3':
            from trajectory_calibration.sources.sqlite import SqliteFile
            storage = SqliteFile(path, count=count)
        else:
            from trajectory_calibration.sources.rosbag1 import Ros1File
            storage = Ros1File(path)
    except Exception:
        if folder is not None:
            folder.cleanup()
        raise
    storage.damage = damage or storage.damage
    return storage, folder


def unpacked(batch: Batch) -> Batch:
    """Return the messages as they were before the recorder compressed each of them."""
    # A recorder compresses all of them; a damaged one must not hide that.
    some = batch.messages[:_SOME]
    if batch.channel.encoding != 'cdr' or not any(
            message.startswith(ZSTD_MAGIC) for message in some):
        return batch
    return batch._replace(messages=list(map(_unpacked, batch.messages)))


def _unpacked(message: bytes) -> bytes:
    if not message.startswith(ZSTD_MAGIC):
        return message
    try:
        return unpack_zstd(message)
    except SourceError:
        raise
    except Exception:  # noqa: BLE001
        # What is no message is counted as one that cannot be read.
        return b''


def describe_damage(error: Exception) -> str:
    """Return the first line of an error, or its kind where it has none."""
    lines = str(error).splitlines()
    return lines[0][:120] if lines else type(error).__name__


def _storage_suffix(path: Path) -> str:
    """Return the suffix of a file, without that of its compression."""
    return Path(path.stem).suffix if path.suffix in _PACKED_SUFFIXES else path.suffix


def _find_folder(path: Path) -> Bag:
    present = sorted((item for item in path.iterdir()
                      if _storage_suffix(item) in _STORAGE_SUFFIXES), key=_natural)
    notes = tuple(note for item in present for note in _log_note(item))
    try:
        listed, declared = _metadata(path)
    except Exception as error:
        # YAML, and what it holds, may be damaged in any way.
        if not present:
            raise SourceError(
                f'{path} is not a bag: no metadata.yaml that can be read '
                f'({describe_damage(error)}), and no .mcap or .db3 file; give a folder that ros2 '
                'bag wrote, or a bag file') from error
        reason = ('is missing' if isinstance(error, FileNotFoundError)
                  else f'is damaged ({describe_damage(error)})')
        note = f'metadata.yaml {reason}: read {", ".join(item.name for item in present)}'
        return Bag(path, tuple(present), notes=(note, *notes))
    files, missing = [], []
    for name in listed:
        # The name of a compressed file may stand there without the suffix of its compression.
        found = [item for item in present if item.name == name or (
            item.suffix in _PACKED_SUFFIXES and item.stem == name)]
        files += found[:1]
        missing += [] if found else [name]
    if missing:
        notes += (f'metadata.yaml lists {", ".join(missing)}, which do not exist',)
    if not files:
        raise SourceError(f'{path}: none of the files that metadata.yaml lists exists: '
                          f'{", ".join(missing)}')
    return Bag(path, tuple(files), declared, notes)


def _metadata(path: Path) -> tuple[list[str], dict[str, int]]:
    """Return the files and the messages of each topic that metadata.yaml lists."""
    from ruamel.yaml import YAML
    text = (path / 'metadata.yaml').read_text(encoding='utf-8')
    metadata = YAML(typ='safe', pure=True).load(text)['rosbag2_bagfile_information']
    listed = [PurePath(name).name for name in metadata['relative_file_paths']]
    declared: dict[str, int] = {}
    for topic in metadata['topics_with_message_count']:
        name = str(topic['topic_metadata']['name'])
        declared[name] = declared.get(name, 0) + int(topic['message_count'])
    return listed, declared


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort bag_2 before bag_10."""
    return [(int(part), '') if part.isdigit() else (-1, part)
            for part in re.split(r'(\d+)', path.name)]


def _log_note(path: Path) -> tuple[str, ...]:
    """Name what a recorder that was killed left outside a sqlite3 file."""
    log = path.with_name(f'{path.name}-wal')
    if not log.exists() or not log.stat().st_size:
        return ()
    note = (f'{log.name} holds messages that were not read; open {path.name} once with sqlite3 to '
            'merge them')
    return (note,)
