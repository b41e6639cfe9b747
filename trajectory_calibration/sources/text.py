# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A text file as a table of fields, with its heading; or the reason why it is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
import re

import numpy as np

from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.numbers import Fields, NotANumberError, Numbers

BAG_SUFFIXES = ('.mcap', '.db3', '.bag', '.zstd', '.zst')
# How files of gzip, zip, bzip2, xz and zstd begin.
_PACKED = (b'\x1f\x8b', b'PK\x03\x04', b'BZh', b'\xfd7zXZ', b'\x28\xb5\x2f\xfd')
_LFS = b'version https://git-lfs.github.com/spec/'
_COMMENTS = (b'#', b'%', b'//')
# How XML and JSON begin.
_FOREIGN = re.compile(rb'\s*(<|\[?\s*\{)')
_UNTIL_TOO_LONG = 60
# Rows from the beginning and from the end by which a layout is known.
_SAMPLE = 200


@dataclass
class Table:
    """The rows of a text file that are neither blank nor comments.

    Attributes
    ----------
    path : the file.
    fields : where the numbers are.
    headings : what the comment lines and a first line of words say, without their marks.
    by_commas : whether commas or semicolons separate the fields.
    notes : what was repaired.

    """

    path: Path
    fields: Fields
    headings: list[str]
    by_commas: bool
    notes: list[str] = field(default_factory=list)
    _body: bytes = b''
    _first_line: int = 1
    _line_numbers: list[int] | None = None

    @classmethod
    def read(cls, path: Path) -> Table:
        """Read a file.

        Raises
        ------
        SourceError
            The file cannot be read, is no text, or its rows are of unequal length.

        """
        return cls.parse(path, read_bytes(path))

    @classmethod
    def parse(cls, path: Path, data: bytes, notes: list[str] | None = None) -> Table:
        """Make a table of the text of a file; see ``read``."""
        foreign = _FOREIGN.match(data)
        if foreign is not None:
            kind = 'XML' if foreign[1] == b'<' else 'JSON'
            raise SourceError(f'{path} is {kind}; needed a table of poses (docs/inputs.md)')
        headings, start, first_line = _headings(data)
        body = data[start:]
        numbers = None
        if b'#' in body or b'%' in body or b'\n\n' in body or b'\n\r\n' in body:
            rows = [(number, line) for number, line in enumerate(body.split(b'\n'), first_line)
                    if line.strip() and not line.lstrip().startswith(_COMMENTS)]
            end = b'\n' * body.endswith(b'\n')
            numbers, body = [row[0] for row in rows], b'\n'.join(row[1] for row in rows) + end
        if not body or body.isspace():
            raise SourceError(f'{path} holds no poses ({len(data)} bytes)')
        line = body[:body.find(b'\n')] if b'\n' in body else body
        if b';' in line:
            if b',' in line:
                raise SourceError(f'{path}, line {first_line}: commas and semicolons; write '
                                  'decimals with a point')
            body = body.replace(b';', b',')
        table = cls(path, Fields(np.zeros(0, np.uint8), *np.zeros((2, 0, 0), np.intp)), headings,
                    b',' in line or b';' in line, [] if notes is None else notes, body,
                    first_line, numbers)
        table._split()
        return table

    def read_numbers(
        self, columns: list[int], time_column: int | None = None, decimals: int = 0,
    ) -> Numbers:
        """Return columns of numbers as ``Fields.read`` does.

        Raises
        ------
        SourceError
            A field is no number; the message names its line.

        """
        try:
            return self.fields.read(columns, time_column, decimals)
        except NotANumberError as error:
            row, column, reason = error.args
            raise SourceError(
                f'{self.path}, line {self.line_number(row)}, column {column + 1}: '
                f'{shown(self.fields.word(row, column))} {reason}') from None

    @property
    def width(self) -> int:
        """How many columns there are."""
        return self.fields.width

    def sample(self) -> FloatArray:
        """Return (M, C) rows from the beginning and the end; NaN for words."""
        parts = [self.fields.part(slice(0, _SAMPLE))]
        if len(self.fields) > _SAMPLE:
            parts.append(self.fields.part(slice(max(_SAMPLE, len(self.fields) - _SAMPLE), None)))
        return np.concatenate([np.stack(
            [_floats(part, column) for column in range(self.width)], axis=1) for part in parts])

    def line_number(self, row: int) -> int:
        """Return the line of a row in the file, from 1."""
        if self._line_numbers is not None:
            return self._line_numbers[row]
        starts = self.fields.starts
        offset = int(starts[row, 0]) if starts.size else 0
        return self._first_line + self._body.count(b'\n', 0, offset)

    def drop_last(self) -> None:
        """Leave out the last row, which a recorder that was killed left incomplete."""
        self.notes.append(
            f'the last line, {self.line_number(len(self.fields) - 1)}, is cut off: dropped')
        self.fields = self.fields.part(slice(0, -1))

    @property
    def complete(self) -> bool:
        """Whether the last line has an end."""
        return self._body.endswith((b'\n', b'\r'))

    def _split(self) -> None:
        """Find the fields; rows of unequal length are an error, but for a last one cut off."""
        read = Fields.separated_by_commas if self.by_commas else Fields.separated_by_space
        found = read(self._body)
        if isinstance(found, Fields):
            self.fields = found
            return
        usual = int(np.bincount(found).argmax()) if len(found) > 2 else int(found[0])
        wrong = np.flatnonzero(found != usual)
        last = len(found) - 1
        if wrong.tolist() == [last] and found[last] < usual and not self.complete:
            end = self._body.rstrip().rfind(b'\n') + 1
            cut_off = self._first_line + self._body.count(b'\n', 0, end)
            if self._line_numbers is not None:
                cut_off = self._line_numbers[-1]
            self.notes.append(f'the last line, {cut_off}, is cut off: dropped')
            self._body = self._body[:end]
            self._split()
            return
        row = int(wrong[0])
        lines = self._body.split(b'\n')
        number = (self._first_line + row if self._line_numbers is None
                  else self._line_numbers[row])
        raise SourceError(
            f'{self.path}, line {number}: {counted(found[row], "column")}, the other lines '
            f'have {usual}; found {shown(lines[row].strip())}')


def is_bag(path: Path) -> bool:
    """Tell a bag from a text file: a folder, or one of the suffixes of bags."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def read_bytes(path: Path) -> bytes:
    """Return the content of a text file with plain line ends.

    Raises
    ------
    SourceError
        The file cannot be read, or is no text.

    """
    if is_bag(path):
        raise SourceError(f'{path} is a bag or a folder, needed a text file; name two of its '
                          'topics and give the bag with --bag')
    try:
        data = path.read_bytes()
    except OSError as error:
        topic = '; if it is a topic, give its bag with --bag' if _like_a_topic(path) else ''
        raise SourceError(f'{path} cannot be read: {error.strerror or error}{topic}') from error
    refuse_pointer(path, data)
    if data.startswith(_PACKED):
        raise SourceError(f'{path} is compressed; unpack it first')
    if b'\0' in data:
        raise SourceError(f'{path} is not text: it holds a zero byte at {data.index(0)}; needed '
                          'a table of poses (docs/inputs.md)')
    data = data.removeprefix(b'\xef\xbb\xbf')
    if b'\r' in data:
        data = data.replace(b'\r\n', b'\n').replace(b'\r', b'\n')
    return data


def refuse_pointer(path: Path, data: bytes) -> None:
    """Raise SourceError for what Git LFS leaves in place of a file."""
    if data.startswith(_LFS):
        raise SourceError(f'{path} is a pointer of Git LFS, not the data; fetch the data with: '
                          'git lfs pull')


def shown(text: str | bytes) -> str:
    """Return the beginning of a text in quotes."""
    words = text.decode('utf-8', errors='replace') if isinstance(text, bytes) else text
    return repr(words[:_UNTIL_TOO_LONG] + '...' if len(words) > _UNTIL_TOO_LONG else words)


def _headings(data: bytes) -> tuple[list[str], int, int]:
    """Return what stands before the numbers, where they begin, and in which line."""
    headings: list[str] = []
    start, number = 0, 1
    while start < len(data):
        end = data.find(b'\n', start)
        end = len(data) if end < 0 else end
        line = data[start:end].strip()
        comment = line.startswith(_COMMENTS)
        if line and not comment and (any(map(_is_number, re.split(rb'[,;\s]+', line)))
                                     or any(not item.startswith(('#', '%')) for item in headings)):
            break
        if line:
            headings.append(line.decode('utf-8', errors='replace'))
        start, number = end + 1, number + 1
    return headings, min(start, len(data)), number


def _is_number(field: bytes) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _floats(fields: Fields, column: int) -> FloatArray:
    """Return the (N,) numbers of a column; NaN for words."""
    try:
        return fields.read([column]).values[:, 0]
    except NotANumberError:
        words = [fields.word(row, column) for row in range(len(fields))]
        return np.array([float(word) if _is_number(word.encode()) else np.nan for word in words])


def _like_a_topic(path: Path) -> bool:
    """Tell /lidar/odometry from the name of a file: nothing is there, nor its folder."""
    at_root = path.is_absolute() and not path.suffix and not path.exists()
    return at_root and (len(path.parts) == 2 or not path.parent.exists())
