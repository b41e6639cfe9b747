# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parse a text file into a table of fields with its headings."""

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
# First bytes of gzip, zip, bzip2, xz and zstd files.
_PACKED = (b'\x1f\x8b', b'PK\x03\x04', b'BZh', b'\xfd7zXZ', b'\x28\xb5\x2f\xfd')
_LFS = b'version https://git-lfs.github.com/spec/'
_COMMENTS = ('#', '%', '//')
_WORDS = re.compile(r'[,;\s]+')
# First characters of XML, JSON and the output of ros2 topic echo.
_FOREIGN = re.compile(r'\s*(<|\[?\s*\{|header:\n)')
# A number with a decimal comma, as spreadsheets of many countries write it.
_DECIMAL_COMMA = re.compile(r'[-+]?\d+,\d+([eE][-+]?\d+)?')
# Number of first rows, and of last rows, from which the layout is detected.
_SAMPLE = 200
# Rows parsed per call of NumPy.
_BLOCK = 8192


@dataclass
class Table:
    """The rows of a text file that are neither blank nor comments.

    Attributes
    ----------
    path : the file.
    lines : the rows.
    line_numbers : their line numbers in the file, from 1.
    headings : lines before the first row, comments included.
    separator : of the fields: a comma, or None for white space.
    width : number of columns.
    complete : whether the last line ends with a line break.
    notes : repairs.

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
        """Parse the text of a file.

        Raise SourceError if it is no table.
        """
        foreign = _FOREIGN.match(text)
        if foreign is not None:
            kind = {'<': 'XML', '[': 'JSON', '{': 'JSON'}.get(
                foreign[1][0], 'YAML (as ros2 topic echo without --csv)')
            raise SourceError(f'{path} is {kind}; needed a table of poses (docs/inputs.md)')
        everything = text.replace('"', '').split('\n')
        headings, first = _headings(everything)
        # Most rows begin with a digit, and this comparison is fast.
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
        # If a heading has as many separators, fields may be empty and names contain spaces.
        mark = next((mark for mark in '\t;' if mark in lines[0]), ',')
        like_heading = any(heading.count(mark) == lines[0].count(mark) for heading in headings)
        if ',' not in lines[0] and (mark == ';' or like_heading):
            lines = [line.replace(mark, ',') for line in lines]
            headings = [heading.replace(mark, ',') for heading in headings]
        if not like_heading and all(line.rstrip().endswith(',') for line in lines):
            # A comma at the end of all rows is ignored; at the end of some, the field is empty.
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

        Raise SourceError with the line number if a field is no number, or a line has another
        number of fields.
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
                self._require_width(start, start + len(lines))
                raise SourceError(f'{self.path} cannot be read: {error}') from error
        return Numbers(*map(np.concatenate, zip(*blocks, strict=True)))

    def sample(self) -> FloatArray:
        """Return the (M, C) first and last rows; NaN for words."""
        last = max(len(self.lines) - _SAMPLE, _SAMPLE)
        self._require_width(0, _SAMPLE)
        self._require_width(last, len(self.lines))
        return np.array([[float(word) if is_number(word) else np.nan
                          for word in line.split(self.separator)]
                         for line in self.lines[:_SAMPLE] + self.lines[last:]])

    def drop_last(self) -> None:
        """Drop the last row, which is incomplete because the recorder was killed."""
        self.notes.append(f'the last line, {self.line_numbers[-1]}, is cut off: dropped')
        self.lines, self.line_numbers = self.lines[:-1], self.line_numbers[:-1]

    def _require_width(self, first: int, end: int) -> None:
        """Raise SourceError if a row in the range has another number of columns."""
        for line, number in zip(self.lines[first:end], self.line_numbers[first:end], strict=True):
            count = len(line.split(self.separator))
            if count != self.width:
                raise SourceError(
                    f'{self.path}, line {number}: {counted(count, "column")}, the '
                    f'other lines have {self.width}; found {_shown(line.strip())}')


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: a folder, or a file with the suffix of a bag."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def read_text(path: Path) -> str:
    r"""Return the content of a text file with '\n' as line break.

    Raise SourceError if the file cannot be read, or is no text.
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
    """Raise SourceError for a Git LFS pointer file."""
    if data.startswith(_LFS):
        raise SourceError(f'{path} is a pointer of Git LFS, not the data; fetch the data with: '
                          'git lfs pull')


def _shown(text: str) -> str:
    """Return the beginning of a text in quotes."""
    return repr(text[:60] + '...' if len(text) > 60 else text)


def _headings(lines: Sequence[str]) -> tuple[list[str], int]:
    """Return the non-empty lines before the first row, and the index of the first row."""
    # If the last row begins with a number, the lines above the table begin with a word.
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
    """Return whether a path is probably a topic: /lidar/odometry, without such a folder."""
    at_root = path.is_absolute() and not path.suffix and not path.exists()
    return at_root and (len(path.parts) == 2 or not path.parent.exists())
