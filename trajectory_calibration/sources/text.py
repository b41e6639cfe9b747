# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A text file as a table of fields, with its heading; or the reason why it is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import re

import numpy as np

from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.numbers import (
    is_number,
    NotANumberError,
    Numbers,
    read_columns,
)

BAG_SUFFIXES = ('.mcap', '.db3', '.bag', '.zstd', '.zst')
# How files of gzip, zip, bzip2, xz and zstd begin.
_PACKED = (b'\x1f\x8b', b'PK\x03\x04', b'BZh', b'\xfd7zXZ', b'\x28\xb5\x2f\xfd')
_LFS = b'version https://git-lfs.github.com/spec/'
_COMMENTS = (b'#', b'%', b'//')
_WORDS = re.compile(r'[,;\s]+')
# How XML and JSON begin.
_FOREIGN = re.compile(rb'\s*(<|\[?\s*\{)')
# A number with a comma before its decimals, as spreadsheets of many countries write it.
_DECIMAL_COMMA = re.compile(rb'[-+]?\d+,\d+([eE][-+]?\d+)?')
# Rows from the beginning and from the end by which a layout is known.
_SAMPLE = 200
# Bytes that are read at once, which the caches of a processor hold.
_BLOCK = 1 << 18


@dataclass
class Table:
    """The rows of a text file that are neither blank nor comments.

    Attributes
    ----------
    path : the file.
    body : the rows, each with an end.
    line_numbers : where they stand in the file, from 1.
    headings : what the comment lines and a first line of words say, without their marks.
    separator : of the fields: a comma, or None for blanks.
    width : how many columns there are.
    complete : whether the last line had an end.
    notes : what was repaired.

    """

    path: Path
    body: bytes
    line_numbers: Sequence[int]
    headings: list[str]
    separator: str | None
    width: int
    complete: bool
    notes: list[str] = field(default_factory=list)

    @classmethod
    def parse(cls, path: Path, data: bytes) -> Table:
        """Make a table of the text of a file.

        Raise SourceError where it is no table, or its rows are of unequal length.
        """
        foreign = _FOREIGN.match(data)
        if foreign is not None:
            kind = 'XML' if foreign[1] == b'<' else 'JSON'
            raise SourceError(f'{path} is {kind}; needed a table of poses (docs/inputs.md)')
        headings, start, first_line = _headings(data)
        complete = data.endswith(b'\n')
        body = data[start:] if complete else data[start:] + b'\n'
        numbers: Sequence[int] = range(first_line, first_line + body.count(b'\n'))
        if any(mark in body for mark in (b'#', b'%', b'/', b'\n\n')):
            lines = body.splitlines(keepends=True)
            rows = [row for row, line in enumerate(lines)
                    if line.strip() and not line.lstrip().startswith(_COMMENTS)]
            body, numbers = b''.join(lines[row] for row in rows), [numbers[row] for row in rows]
        if not body or body.isspace():
            marked = headings and all(line.encode().startswith(_COMMENTS) for line in headings)
            raise SourceError(f'{path} holds no poses ({len(data)} bytes'
                              f'{", all of them comments: # % //" if marked else ""})')
        notes = []
        line = body[:body.index(b'\n')]
        fields = re.split(rb'[;\s]+', line.strip())
        if len(fields) > 1 and b',' in line and all(
                map(_DECIMAL_COMMA.fullmatch, (field for field in fields if b',' in field))):
            body, line = body.replace(b',', b'.'), line.replace(b',', b'.')
            notes.append('decimal commas: read as points')
        # Fields may be empty, and names hold blanks, where a heading has as many separators.
        mark = next((mark for mark in ('\t', ';') if mark.encode() in line), ',')
        like_heading = any(
            heading.count(mark) == line.count(mark.encode()) for heading in headings)
        if b',' not in line and (mark == ';' or like_heading):
            body, line = (item.replace(mark.encode(), b',') for item in (body, line))
            headings = [heading.replace(mark, ',') for heading in headings]
        if line.rstrip().endswith(b',') and not like_heading:
            # A comma behind the last field of all rows means nothing; of some, a field is empty.
            stripped, count = re.subn(rb',[ \t]*\n', b'\n', body)
            body = stripped if count == len(numbers) else body
        separator = ',' if b',' in line else None
        table = cls(path, body, numbers, headings, separator, 0, complete, notes)
        counts = [len(row.split(separator)) for row in table.ends()[0]]
        table.width = max(counts, key=counts.count) if len(counts) > 2 else counts[0]
        last = body[body.rfind(b'\n', 0, -1) + 1:].decode(errors='replace')
        if len(numbers) > 1 and not complete and len(last.split(separator)) < table.width:
            table.drop_last()
            table.complete = True
        return table

    def read_numbers(
        self, columns: Sequence[int], time_column: int | None = None, decimals: int = 0,
    ) -> Numbers:
        """Return columns of numbers as ``numbers.read_columns`` does.

        Raise SourceError, which names the line, where a field is no number, or a line has more
        fields or fewer.
        """
        blocks: list[Numbers] = []
        start = row = 0
        while start < len(self.body):
            end = self.body.index(b'\n', min(start + _BLOCK, len(self.body) - 1)) + 1
            lines = self.body[start:end].decode(errors='replace').split('\n')[:-1]
            try:
                blocks.append(read_columns(
                    lines, self.separator, self.width, columns, time_column, decimals))
            except NotANumberError as error:
                k, column, reason = error.args
                word = lines[k].split(self.separator)[column].strip()
                raise SourceError(
                    f'{self.path}, line {self.line_numbers[row + k]}, column {column + 1}: '
                    f'{shown(word)} {reason}') from None
            except ValueError as error:
                self._require_even(lines, row)
                raise SourceError(f'{self.path} cannot be read: {error}') from error
            start, row = end, row + len(lines)
        return Numbers(*map(np.concatenate, zip(*blocks, strict=True)))

    def sample(self) -> FloatArray:
        """Return (M, C) rows from the beginning and the end; NaN for words."""
        first, last = self.ends()
        self._require_even(first, 0)
        self._require_even(last, len(self.line_numbers) - len(last))
        return np.array([[float(word) if is_number(word) else np.nan
                          for word in line.split(self.separator)] for line in first + last])

    def ends(self) -> tuple[list[str], list[str]]:
        """Return some rows from the beginning, and some of the others from the end."""
        end = self.body.index(b'\n', min(_BLOCK, len(self.body) - 1)) + 1
        first = self.body[:end].decode(errors='replace').split('\n')[:-1][:_SAMPLE]
        start = self.body.rfind(b'\n', 0, max(0, len(self.body) - _BLOCK)) + 1
        last = self.body[start:].decode(errors='replace').split('\n')[:-1][-_SAMPLE:]
        return first, last[max(0, len(first) + len(last) - len(self.line_numbers)):]

    def drop_last(self) -> None:
        """Leave out the last row, which a recorder that was killed left incomplete."""
        self.notes.append(f'the last line, {self.line_numbers[-1]}, is cut off: dropped')
        self.body = self.body[:self.body.rfind(b'\n', 0, -1) + 1]
        self.line_numbers = self.line_numbers[:-1]

    def _require_even(self, lines: Iterable[str], first: int) -> None:
        """Raise SourceError where one of the rows from ``first`` on has another width."""
        for row, line in enumerate(lines, first):
            count = len(line.split(self.separator))
            if count != self.width:
                raise SourceError(
                    f'{self.path}, line {self.line_numbers[row]}: {counted(count, "column")}, the '
                    f'other lines have {self.width}; found {shown(line.strip())}')


def is_bag(path: Path) -> bool:
    """Tell a bag from a text file: a folder, or one of the suffixes of bags."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def read_bytes(path: Path) -> bytes:
    """Return the content of a text file with plain line ends.

    Raise SourceError where the file cannot be read, or is no text.
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
        raise SourceError(f'{path} is a workbook; save it as CSV' if path.suffix == '.xlsx' else
                          f'{path} is compressed; unpack it first')
    if data.startswith((b'\xff\xfe', b'\xfe\xff')):
        data = data.decode('utf-16', errors='replace').encode()
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
    return repr(words[:60] + '...' if len(words) > 60 else words)


def _headings(data: bytes) -> tuple[list[str], int, int]:
    """Return what stands before the numbers, where they begin, and in which line."""
    # Above a table whose rows begin with a number, exporters write lines that do not.
    last = _WORDS.split(data.rstrip()[-_BLOCK:].rpartition(b'\n')[2].decode(errors='replace'))
    by_first = is_number(last[0])
    headings: list[str] = []
    start, number = 0, 1
    while start < len(data):
        end = data.find(b'\n', start)
        end = len(data) if end < 0 else end
        comment = data[start:end].lstrip().startswith(_COMMENTS)
        line = data[start:end].decode(errors='replace').strip()
        words = _WORDS.split(line)
        if line and not comment and (
                is_number(words[0]) and len(words) >= min(2, len(last)) if by_first else
                any(map(is_number, words))
                or any(not item.startswith(('#', '%')) for item in headings)):
            break
        if line:
            headings.append(line)
        start, number = end + 1, number + 1
    return headings, min(start, len(data)), number


def _like_a_topic(path: Path) -> bool:
    """Tell /lidar/odometry from the name of a file: nothing is there, nor its folder."""
    at_root = path.is_absolute() and not path.suffix and not path.exists()
    return at_root and (len(path.parts) == 2 or not path.parent.exists())
