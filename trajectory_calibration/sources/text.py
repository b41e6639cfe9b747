# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A text file as a table of fields, with its heading; or the reason why it is none."""

from __future__ import annotations

from collections.abc import Sequence
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
_COMMENTS = ('#', '%', '//')
_WORDS = re.compile(r'[,;\s]+')
# How XML and JSON begin, and what ros2 topic echo prints.
_FOREIGN = re.compile(r'\s*(<|\[?\s*\{|header:\n)')
# A number with a comma before its decimals, as spreadsheets of many countries write it.
_DECIMAL_COMMA = re.compile(r'[-+]?\d+,\d+([eE][-+]?\d+)?')
# Rows from the beginning and from the end by which a layout is known.
_SAMPLE = 200
# Rows that are read at once.
_BLOCK = 8192


@dataclass
class Table:
    """The rows of a text file that are neither blank nor comments.

    Attributes
    ----------
    path : the file.
    lines : the rows.
    line_numbers : where they stand in the file, from 1.
    headings : what the comment lines and a first line of words say, without their marks.
    separator : of the fields: a comma, or None for blanks.
    width : how many columns there are.
    complete : whether the last line had an end.
    notes : what was repaired.

    """

    path: Path
    lines: list[str]
    line_numbers: Sequence[int]
    headings: list[str]
    separator: str | None
    width: int
    complete: bool
    notes: list[str] = field(default_factory=list)

    @classmethod
    def parse(cls, path: Path, text: str) -> Table:
        """Make a table of the text of a file.

        Raise SourceError where it is no table, or its rows are of unequal length.
        """
        foreign = _FOREIGN.match(text)
        if foreign is not None:
            kind = {'<': 'XML', '[': 'JSON', '{': 'JSON'}.get(
                foreign[1][0], 'YAML (as ros2 topic echo without --csv)')
            raise SourceError(f'{path} is {kind}; needed a table of poses (docs/inputs.md)')
        everything = text.replace('"', '').split('\n')
        headings, first = _headings(everything)
        # Most rows begin with a digit, which is quickly seen.
        numbers = [number for number, line in enumerate(everything[first:], first + 1)
                   if '0' <= line < ':' or (
                       line.strip() and not line.lstrip().startswith(_COMMENTS))]
        if not numbers:
            marked = headings and all(line.startswith(_COMMENTS) for line in headings)
            raise SourceError(f'{path} holds no poses ({len(text)} bytes'
                              f'{", all of them comments: # % //" if marked else ""})')
        lines, notes = [everything[number - 1] for number in numbers], []
        fields = re.split(r'[;\s]+', lines[0].strip())
        if len(fields) > 1 and ',' in lines[0] and all(
                map(_DECIMAL_COMMA.fullmatch, (field for field in fields if ',' in field))):
            lines = [line.replace(',', '.') for line in lines]
            notes.append('decimal commas: read as points')
        # Fields may be empty, and names hold blanks, where a heading has as many separators.
        mark = next((mark for mark in '\t;' if mark in lines[0]), ',')
        like_heading = any(heading.count(mark) == lines[0].count(mark) for heading in headings)
        if ',' not in lines[0] and (mark == ';' or like_heading):
            lines = [line.replace(mark, ',') for line in lines]
            headings = [heading.replace(mark, ',') for heading in headings]
        if not like_heading and all(line.rstrip().endswith(',') for line in lines):
            # A comma behind the last field of all rows means nothing; of some, a field is empty.
            lines = [line.rstrip()[:-1] for line in lines]
        separator = ',' if ',' in lines[0] else None
        counts = [len(line.split(separator)) for line in lines[:_SAMPLE]]
        width = max(counts, key=counts.count) if len(counts) > 2 else counts[0]
        table = cls(path, lines, numbers, headings, separator, width, text.endswith('\n'), notes)
        if len(lines) > 1 and not table.complete and len(lines[-1].split(separator)) < width:
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
        for start in range(0, len(self.lines), _BLOCK):
            lines = self.lines[start:start + _BLOCK]
            try:
                blocks.append(read_columns(
                    lines, self.separator, self.width, columns, time_column, decimals))
            except NotANumberError as error:
                k, column, reason = error.args
                word = lines[k].split(self.separator)[column].strip()
                raise SourceError(
                    f'{self.path}, line {self.line_numbers[start + k]}, column {column + 1}: '
                    f'{_shown(word)} {reason}') from None
            except ValueError as error:
                self._require_even(start, start + len(lines))
                raise SourceError(f'{self.path} cannot be read: {error}') from error
        return Numbers(*map(np.concatenate, zip(*blocks, strict=True)))

    def sample(self) -> FloatArray:
        """Return (M, C) rows from the beginning and the end; NaN for words."""
        last = max(len(self.lines) - _SAMPLE, _SAMPLE)
        self._require_even(0, _SAMPLE)
        self._require_even(last, len(self.lines))
        return np.array([[float(word) if is_number(word) else np.nan
                          for word in line.split(self.separator)]
                         for line in self.lines[:_SAMPLE] + self.lines[last:]])

    def drop_last(self) -> None:
        """Leave out the last row, which a recorder that was killed left incomplete."""
        self.notes.append(f'the last line, {self.line_numbers[-1]}, is cut off: dropped')
        self.lines, self.line_numbers = self.lines[:-1], self.line_numbers[:-1]

    def _require_even(self, first: int, end: int) -> None:
        """Raise SourceError where one of some rows has another width."""
        for line, number in zip(self.lines[first:end], self.line_numbers[first:end], strict=True):
            count = len(line.split(self.separator))
            if count != self.width:
                raise SourceError(
                    f'{self.path}, line {number}: {counted(count, "column")}, the '
                    f'other lines have {self.width}; found {_shown(line.strip())}')


def is_bag(path: Path) -> bool:
    """Tell a bag from a text file: a folder, or one of the suffixes of bags."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def read_text(path: Path) -> str:
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
    wide = data.startswith((b'\xff\xfe', b'\xfe\xff'))
    text = data.decode('utf-16' if wide else 'utf-8-sig', errors='replace')
    if '\0' in text:
        raise SourceError(f'{path} is not text: it holds a zero byte at {text.index(chr(0))}; '
                          'needed a table of poses (docs/inputs.md)')
    return text.replace('\r\n', '\n').replace('\r', '\n') if '\r' in text else text


def refuse_pointer(path: Path, data: bytes) -> None:
    """Raise SourceError for what Git LFS leaves in place of a file."""
    if data.startswith(_LFS):
        raise SourceError(f'{path} is a pointer of Git LFS, not the data; fetch the data with: '
                          'git lfs pull')


def _shown(text: str) -> str:
    """Return the beginning of a text in quotes."""
    return repr(text[:60] + '...' if len(text) > 60 else text)


def _headings(lines: Sequence[str]) -> tuple[list[str], int]:
    """Return what stands before the numbers, and in which line they begin, from 0."""
    # Above a table whose rows begin with a number, exporters write lines that do not.
    last = _WORDS.split(next(filter(str.strip, reversed(lines)), '').rstrip())
    by_first = is_number(last[0])
    headings: list[str] = []
    for k, line in enumerate(map(str.strip, lines)):
        words = _WORDS.split(line)
        if line and not line.startswith(_COMMENTS) and (
                is_number(words[0]) and len(words) >= min(2, len(last)) if by_first else
                any(map(is_number, words))
                or any(not item.startswith(('#', '%')) for item in headings)):
            return headings, k
        if line:
            headings.append(line)
    return headings, len(lines)


def _like_a_topic(path: Path) -> bool:
    """Tell /lidar/odometry from the name of a file: nothing is there, nor its folder."""
    at_root = path.is_absolute() and not path.suffix and not path.exists()
    return at_root and (len(path.parts) == 2 or not path.parent.exists())
