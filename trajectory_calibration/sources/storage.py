"""The files of a bag, and serialized messages out of them, through ``rosbags``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
import re
import sqlite3
import struct
import sys
from typing import Any, NamedTuple, Protocol

import apsw
from rosbags import rosbag1, rosbag2
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from trajectory_calibration.errors import SourceError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# Topic, type, receive time in nanoseconds, serialized data.
Message = tuple[str, str, int, bytes]

# What rosbags and the libraries below it raise on a damaged file: its own errors, and whatever
# the first wrong length, offset or character happens to hit. Found by flipping and cutting.
DAMAGE: tuple[type[Exception], ...] = (
    rosbag1.ReaderError, rosbag2.ReaderError, apsw.Error, sqlite3.Error, zstd.ZstdError,
    YAMLError, struct.error, ArithmeticError, AssertionError, AttributeError, EOFError,
    LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError,
)

_STORAGE_SUFFIXES = ('.mcap', '.db3')
_SUFFIXES = (*_STORAGE_SUFFIXES, '.bag')


class Channel(NamedTuple):
    """A topic in a file: its name, its type, how many messages the file declares."""

    topic: str
    msgtype: str
    messages: int


class Storage(Protocol):
    """An open file of a bag."""

    channels: list[Channel]

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics; raises one of DAMAGE where the file is damaged."""
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
    files : what is to be opened: the storage files, or the folder where rosbags must unpack it.
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
    if not path.exists():
        raise SourceError(f'{path} does not exist; needed a rosbag2 folder or a '
                          f'{", ".join(_SUFFIXES)} file')
    if path.suffix not in _SUFFIXES:
        raise SourceError(f'{path} is not a bag; needed a rosbag2 folder or a '
                          f'{", ".join(_SUFFIXES)} file')
    return Bag(path, (path,), notes=_log_note(path))


def is_ros1(path: Path) -> bool:
    """Tell a ROS 1 bag, one file, from the files and folders of rosbag2."""
    return path.suffix == '.bag' and not path.is_dir()


class RosbagsStorage:
    """A file, or a compressed folder, that ``rosbags`` opens; raises one of DAMAGE if not.

    Attributes
    ----------
    channels : the topics in it.

    """

    def __init__(self, path: Path) -> None:
        self._reader: Any = (rosbag1 if is_ros1(path) else rosbag2).Reader(path)
        self._reader.open()
        counts: dict[tuple[str, str], int] = {}
        for connection in self._reader.connections:
            key = connection.topic, connection.msgtype
            if not all(isinstance(name, str) for name in key):
                self._reader.close()
                raise TypeError(f'the topic {key} has no name or no type')
            counts[key] = counts.get(key, 0) + connection.msgcount
        self.channels = [Channel(*key, count) for key, count in counts.items()]

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some topics in the order of their receive times."""
        connections = [item for item in self._reader.connections if item.topic in topics]
        if not connections:
            return
        for connection, stamp_ns, data in self._reader.messages(connections):
            yield connection.topic, connection.msgtype, stamp_ns, data

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def describe_damage(error: Exception) -> str:
    """Return the kind and the first line of an error of a library."""
    lines = str(error).splitlines() or ['']
    return f'{type(error).__name__}: {lines[0][:120]}'.removesuffix(': ')


def _find_folder(path: Path) -> Bag:
    present = sorted(
        (item for item in path.iterdir() if item.suffix in _STORAGE_SUFFIXES), key=_natural)
    notes = tuple(note for item in present for note in _log_note(item))
    try:
        text = (path / 'metadata.yaml').read_text(encoding='utf-8')
        metadata = YAML(typ='safe', pure=True).load(text)['rosbag2_bagfile_information']
        if str(metadata.get('compression_mode') or '').lower() not in ('', 'none'):
            return Bag(path, (path,))
        listed = [path / PurePath(name).name for name in metadata['relative_file_paths']]
        declared: dict[str, int] = {}
        for topic in metadata['topics_with_message_count']:
            name = str(topic['topic_metadata']['name'])
            declared[name] = declared.get(name, 0) + int(topic['message_count'])
    except DAMAGE as error:
        if not present:
            raise SourceError(
                f'{path} is not a bag: no metadata.yaml that can be read '
                f'({describe_damage(error)}), and no .mcap or .db3 file; give a folder that ros2 '
                'bag wrote, or a bag file') from error
        reason = ('is missing' if isinstance(error, FileNotFoundError)
                  else f'is damaged ({describe_damage(error)})')
        note = f'metadata.yaml {reason}: read {", ".join(item.name for item in present)}'
        return Bag(path, tuple(present), notes=(note, *notes))
    missing = [item.name for item in listed if not item.exists()]
    if missing:
        notes += (f'metadata.yaml lists {", ".join(missing)}, which do not exist',)
    files = tuple(item for item in listed if item.exists())
    if not files:
        raise SourceError(f'{path}: none of the files that metadata.yaml lists exists: '
                          f'{", ".join(missing)}')
    return Bag(path, files, declared, notes)


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
