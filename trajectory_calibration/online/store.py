# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results on disk: one numbered file per result, never overwritten."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import itertools
import os
from pathlib import Path
import re
from typing import NamedTuple

from trajectory_calibration.config.yaml_file import write_yaml
from trajectory_calibration.errors import (
    ConfigError,
    MissingPackageError,
    require,
    ResultError,
)
from trajectory_calibration.outputs.exports import write_exports
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.result import CalibrationResult

# Largest file that is read, bytes. A result has a few thousand. With half of 1,000,000 motions
# rejected at random, which it lists, it has 3,000,000.
_LARGEST = 4_000_000


class Restored(NamedTuple):
    """A result of an earlier run, restored when the frames of the vehicle are known."""

    path: Path
    result: CalibrationResult

    @property
    def waiting(self) -> str:
        """Return the condition for restoring it, in words."""
        return (f'{self.path.name} is restored when poses of {self.result.frame_a} and '
                f'{self.result.frame_b} arrive, or frame_a and frame_b name them')

    def compare(self, frames: Sequence[str]) -> str | None:
        """Return '' if ``frames`` are those of the result, otherwise why it is refused.

        None if one of the frames is not known yet, ''.
        """
        wanted = self.result.frame_a, self.result.frame_b
        if any(frame not in ('', expected)
               for frame, expected in zip(frames, wanted, strict=True)):
            found = ' and '.join(frame or 'unknown' for frame in frames)
            return (f'not restored: {self.path} holds {wanted[0]} -> {wanted[1]}, the topics '
                    f'carry {found}; correct the topics, or calibrate again')
        return '' if all(frames) else None


class ResultStore:
    """The results of one node in a folder, which is created if it does not exist.

    A file name is the node name and a sequence number: independent of messages, and of a clock
    that the vehicle may set after the start. Slashes in the node name are replaced by dots, which
    ROS names cannot contain, so names are unique.

    Raises
    ------
    ConfigError
        The folder cannot be found, created or written to, or ruamel.yaml is not installed.

    """

    def __init__(self, folder: str, node_name: str) -> None:
        try:
            require('ruamel.yaml')
        except MissingPackageError as error:
            raise ConfigError(f'result_directory needs YAML: {error}') from error
        try:
            self._folder = Path(folder).expanduser().absolute()
        except RuntimeError as error:
            raise ConfigError(
                f'result_directory {folder} names the home of nobody known here; give its full '
                'path') from error
        self._prefix = node_name.strip('/').replace('/', '.')
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f'result_directory {self._folder} cannot be made: {error.strerror}') from error
        if not os.access(self._folder, os.W_OK | os.X_OK):
            raise ConfigError(
                f'result_directory {self._folder} cannot be written to; correct its owner or its '
                'permissions')

    def save(self, result: CalibrationResult) -> Path:
        """Write a result atomically and return its file; raise ResultError if that fails."""
        newest = max((number for number, _ in self._files()), default=0)
        for number in itertools.count(newest + 1):
            path = self._folder / f'{self._prefix}_{number:06d}.yaml'
            # Another node with this name may use the same number concurrently.
            with suppress(FileExistsError):
                write_yaml(path, result.to_dict(), overwrite=False)
                break
        return path

    def export(self, result: CalibrationResult, path: Path) -> Path:
        """Write all exports of a saved result to a folder named after its file; return it."""
        folder = path.with_suffix('')
        write_exports(Placement.of(result), folder)
        return folder

    def latest(self) -> Restored | None:
        """Return the newest readable result, None if there is no file.

        Raises
        ------
        ResultError
            None of the files can be read, or the folder was removed.

        """
        failure = None
        for _, path in sorted(self._files(), reverse=True):
            loaded = _load(path)
            if isinstance(loaded, CalibrationResult):
                return Restored(path, loaded)
            failure = failure or loaded
        if failure:
            raise failure
        return None

    def _files(self) -> list[tuple[int, Path]]:
        """Return number and path of each result; only regular files, since a FIFO would block."""
        pattern = re.compile(rf'{re.escape(self._prefix)}_(\d+)\.yaml')
        try:
            paths = list(self._folder.iterdir())
        except OSError as error:
            raise ResultError(
                f'{self._folder} cannot be read: {error.strerror}; put it back, or start the node '
                'with another result_directory') from error
        found = ((pattern.fullmatch(path.name), path) for path in paths)
        return [(int(match[1]), path) for match, path in found if match and _is_file(path)]


def _is_file(path: Path) -> bool:
    # The permissions of the folder may have changed.
    with suppress(OSError):
        return path.is_file()
    return False


def _load(path: Path) -> CalibrationResult | ResultError:
    try:
        size = path.stat().st_size
    except OSError as error:
        return ResultError(f'{path} cannot be read as a result: {error}')
    if size > _LARGEST:
        return ResultError(
            f'{path} holds {size} bytes, needed at most {_LARGEST}: it is no result of this node')
    try:
        result = CalibrationResult.load(path)
        # YAML can contain names that are not UTF-8; messages cannot.
        f'{result.frame_a}{result.frame_b}'.encode()
    except ResultError as error:
        return error
    except UnicodeEncodeError as error:
        return ResultError(
            f'{path}: the name of a frame is {error.object!a}, needed text; correct the file')
    return result
