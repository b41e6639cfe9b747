"""Trajectories in text files: TUM, KITTI and EuRoC.

============ ============================================================== =================
format       a row                                                          time
============ ============================================================== =================
``tum``      ``t x y z qx qy qz qw``, separated by spaces                   seconds
``kitti``    the first three rows of ``T_world_sensor``, 12 numbers         in a second file
``euroc``    ``t,x,y,z,qw,qx,qy,qz,...``, separated by commas               nanoseconds
============ ============================================================== =================

Blank lines and lines that begin with ``#`` are skipped. Rows that are not finite, or whose
quaternion is all zeros, are what a SLAM writes while it is lost: they are dropped with a
warning. A last line without an end of line and with too few numbers is what a recorder leaves
when it is killed: dropped with a warning too. Anything else that does not fit is a
``SourceError`` that names the file and the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
import os
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import ROTATION_TOLERANCE, Trajectory
from trajectory_calibration.errors import ConfigError, SourceError, TrajectoryError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

FORMATS = ('tum', 'kitti', 'euroc')
QUATERNION_ORDERS = ('xyzw', 'wxyz')
TIME_UNITS = ('s', 'ms', 'us', 'ns')

_COLUMNS = {'tum': 8, 'kitti': 12, 'euroc': 8}
# NumPy takes more characters for space than these.
_PRINTABLE = re.compile(rb'[\t\v\f -~]*')
BAG_SUFFIXES = ('.mcap', '.db3', '.bag')
_INT64_MAX = 2**63 - 1
# Units of times that are too large for seconds: since 1970 in the last three, since the start of
# the drive in the first.
_EPOCHS = ((1e11, 'nanoseconds', '1e9'), (1e14, 'milliseconds', '1000'),
           (1e17, 'microseconds', '1e6'), (np.inf, 'nanoseconds', '1e9'))
# How files of gzip, zip, bzip2, xz and zstd begin.
_PACKED = (b'\x1f\x8b', b'PK\x03\x04', b'BZh', b'\xfd7zXZ', b'\x28\xb5\x2f\xfd')


@dataclass(frozen=True)
class FileSource:
    """A trajectory in a text file.

    Attributes
    ----------
    path : the file.
    file_format : 'tum', 'kitti' or 'euroc'; told from the first row where None.
    times : for KITTI, a file with one time in seconds per pose.
    sensor_frame, world_frame : names, which no format carries.

    """

    path: str | os.PathLike[str]
    file_format: str | None = None
    times: str | os.PathLike[str] | None = None
    sensor_frame: str = 'sensor'
    world_frame: str = 'map'
    columns: str | None = None
    quaternion_order: str | None = None
    time_unit: str | None = None

    def load(self) -> Trajectory:
        """Read the file.

        Raises
        ------
        ConfigError
            An unknown format.
        SourceError
            The file cannot be read, is empty, is not text, or a line of it does not fit.

        """
        if any((self.columns, self.quaternion_order, self.time_unit)):
            raise ConfigError('columns, quaternion_order and time_unit are not available yet')
        if self.file_format not in (None, *FORMATS):
            raise ConfigError(
                f'format {self.file_format!r} is unknown; needed one of {", ".join(FORMATS)}')
        table = _Table.read(Path(self.path))
        file_format = self.file_format or _detect_format(table)
        if file_format == 'kitti' and self.times is None:
            raise SourceError(
                f'{self.path} holds KITTI poses, which carry no time; give the file of their '
                'times as well, one number of seconds a line (--times-a, --times-b; --times of '
                'inspect)')
        if file_format != 'kitti' and self.times is not None:
            raise SourceError(
                f'{self.path} is read as {file_format}, which carries its own times; leave '
                f'{self.times} out, or say that the format is kitti')
        try:
            if file_format == 'kitti' and self.times is not None:
                return self._kitti(table, _Table.read(Path(self.times)))
            return self._quaternions(table, file_format)
        except TrajectoryError as error:
            raise SourceError(f'{self.path}: {error}') from error

    def _quaternions(self, table: _Table, file_format: str) -> Trajectory:
        to_stamp = _seconds_to_ns if file_format == 'tum' else _integer_ns
        order = [4, 5, 6, 7] if file_format == 'tum' else _euroc_quaternion_columns(table)
        rows = table.parse(_COLUMNS[file_format], to_stamp, more=file_format == 'euroc')
        quaternions = rows.values[:, order]
        lost = ~np.isfinite(rows.values).all(axis=1) | (quaternions == 0).all(axis=1)
        with np.errstate(over='ignore', invalid='ignore'):
            norm = np.linalg.norm(quaternions, axis=1)
            wrong = ~lost & ~(np.abs(norm - 1) <= ROTATION_TOLERANCE)
        keep = ~lost
        if wrong[-1] and not table.complete:
            # A row can end within its last number too; the norm then tells.
            table.notes.append(_cut_off_note(rows.line_numbers[-1]))
            wrong[-1] = keep[-1] = False
        if wrong.any():
            k = int(np.argmax(wrong))
            raise SourceError(
                f'{self.path}, line {rows.line_numbers[k]}: the norm of the quaternion is '
                f'{norm[k]:.6g}, needed 1; is the file in the format {file_format}, with the '
                f'quaternion in the order {"x, y, z, w" if file_format == "tum" else "w, x, y, z"}'
                '?')
        notes = [*table.notes, *_lost_note(lost)]
        self._require_two(keep, notes)
        if file_format == 'tum' and np.array_equal(np.abs(quaternions[keep][0]), [1, 0, 0, 0]):
            notes.append(
                'the first quaternion is 1 0 0 0, half a turn about x; if the sensor began '
                'without a rotation, w comes first here: TUM files have x y z w')
        return Trajectory.from_quaternions(
            rows.stamps_ns[keep], rows.values[keep, 1:4], quaternions[keep],
            self.world_frame, self.sensor_frame, self._findings(notes))

    def _kitti(self, table: _Table, times: _Table) -> Trajectory:
        rows = table.parse(_COLUMNS['kitti'], None)
        stamps = times.parse(1, _seconds_to_ns)
        poses, count = len(rows.values), len(stamps.stamps_ns)
        used = min(poses, count)
        # A last line that was cut off has left one of the two files a row shorter.
        if max(poses, count) - used > bool(table.notes or times.notes):
            raise SourceError(
                f'{self.path} holds {poses} poses and {self.times} {count} times; needed one time '
                'for each pose')
        finite = np.isfinite(rows.values[:used]).all(axis=1)
        lost = ~(finite & np.isfinite(stamps.values[:used, 0]))
        notes = [*table.notes, *times.notes, *_lost_note(lost)]
        self._require_two(~lost, notes)
        T = np.zeros((used, 4, 4))
        T[:, :3] = rows.values[:used].reshape(-1, 3, 4)
        T[:, 3, 3] = 1.0
        return Trajectory(
            stamps.stamps_ns[:used][~lost], T[~lost], self.world_frame, self.sensor_frame,
            self._findings(notes))

    def _require_two(self, keep: NDArray[np.bool_], notes: list[str]) -> None:
        count = int(np.count_nonzero(keep))
        if count < 2:
            because = f' ({"; ".join(notes)})' if notes else ''
            raise SourceError(
                f'{self.path}: {count} of {len(keep)} rows give a pose, needed at least 2'
                f'{because}; record while the sensor moves and its SLAM tracks')

    def _findings(self, notes: list[str]) -> tuple[Finding, ...]:
        return tuple(Finding('input-repaired', f'{self.sensor_frame}: {self.path}: {note}')
                     for note in notes)


def is_bag(path: Path) -> bool:
    """Tell a bag from a text file: a folder, or one of the suffixes of bags."""
    return path.is_dir() or path.suffix in BAG_SUFFIXES


def read_transform(path: str | os.PathLike[str]) -> FloatArray:
    """Read one (4, 4) transform, the pose of b in a, from a file.

    One row ``[t] x y z qx qy qz qw``, metres; the stamp is ignored.

    Raises
    ------
    SourceError
        The file cannot be read, or holds something else.

    """
    table = _Table.read(Path(path))
    if len(table.lines) != 1:
        raise SourceError(
            f'{path} holds {len(table.lines)} rows, needed one transform: [t] x y z qx qy qz qw')
    width = len(table.lines[0].split())
    if width not in (7, 8):
        raise SourceError(
            f'{path}, line {table.line_numbers[0]}: {width} numbers, needed 7 or 8: '
            '[t] x y z qx qy qz qw')
    values = table.parse(width, None).values[0, width - 7:]
    norm = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or not abs(norm - 1) <= ROTATION_TOLERANCE:
        raise SourceError(
            f'{path}, line {table.line_numbers[0]}: {values.tolist()} is no transform, needed '
            'x y z qx qy qz qw with a quaternion of norm 1')
    return se3.from_rotation_translation(
        se3.quaternion_to_rotation(values[3:] / norm), values[:3])


@dataclass(frozen=True)
class _Rows:
    """Numbers of a table: (N, columns) values, (N,) stamps or zeros, (N,) line numbers."""

    values: FloatArray
    stamps_ns: NDArray[np.int64]
    line_numbers: list[int]


@dataclass
class _Table:
    """The rows of a text file that are neither blank nor comments.

    Attributes
    ----------
    path : the file.
    lines, line_numbers : the rows and their numbers in the file, from 1.
    comments : the comment lines.
    complete : whether the last line of the file has an end.
    notes : what was repaired.

    """

    path: Path
    lines: list[bytes]
    line_numbers: list[int]
    comments: list[bytes]
    complete: bool
    notes: list[str]

    @classmethod
    def read(cls, path: Path) -> _Table:
        if is_bag(path):
            raise SourceError(
                f'{path} is a bag or a folder, needed a text file (TUM, KITTI, EuRoC); for a bag '
                'name two of its topics and give the bag with --bag')
        try:
            data = path.read_bytes()
        except OSError as error:
            topic = '; if it is a topic, give its bag with --bag' if _like_a_topic(path) else ''
            raise SourceError(
                f'{path} cannot be read: {error.strerror or error}{topic}') from error
        if data.startswith(_PACKED):
            raise SourceError(f'{path} is compressed; unpack it first')
        if b'\0' in data:
            raise SourceError(
                f'{path} is not text: it holds a zero byte at {data.index(0)}; needed a TUM, '
                'KITTI or EuRoC file')
        data = data.removeprefix(b'\xef\xbb\xbf')
        table = cls(path, [], [], [], data.endswith((b'\n', b'\r')), [])
        for number, line in enumerate(map(bytes.strip, data.splitlines()), start=1):
            if line.startswith(b'#'):
                table.comments.append(line)
            elif line:
                table.lines.append(line)
                table.line_numbers.append(number)
        if not table.lines:
            raise SourceError(
                f'{path} holds no poses ({len(data)} bytes); needed a TUM, KITTI or EuRoC file')
        return table

    def parse(
        self, columns: int, to_stamp: Callable[[bytes], int] | None, *, more: bool = False,
    ) -> _Rows:
        """Turn the rows into numbers; ``more`` allows further columns, which are ignored."""
        self._drop_incomplete_end(columns)
        for k, line in enumerate(self.lines):
            if _PRINTABLE.fullmatch(line) is None:
                raise self._wrong(k, f'needed {columns} numbers')
        try:
            values = np.loadtxt(
                self.lines, delimiter=self._separator, comments=None, ndmin=2,
                usecols=range(columns) if more else None)
        except ValueError:
            values = np.empty((0, 0))
        if values.shape != (len(self.lines), columns):
            raise self._first_misfit(columns, more=more)
        stamps_ns = np.zeros(len(values), dtype=np.int64)
        if to_stamp is not None:
            for k in np.flatnonzero(np.isfinite(values[:, 0])).tolist():
                field = self._fields(k, limit=1)[0]
                try:
                    stamps_ns[k] = to_stamp(field)
                except (ValueError, InvalidOperation) as error:
                    raise self._wrong(k, f'the time {_shown(field)} {error}') from None
        return _Rows(values, stamps_ns, self.line_numbers)

    @property
    def _separator(self) -> str | None:
        return ',' if b',' in self.lines[0] else None

    def _fields(self, k: int, limit: int = -1) -> list[bytes]:
        return self.lines[k].split(b',' if self._separator else None, limit)

    def _drop_incomplete_end(self, columns: int) -> None:
        cut_off = (not self.complete and len(self.lines) > 1
                   and len(self._fields(-1)) < max(columns, len(self._fields(0))))
        if cut_off:
            self.notes.append(_cut_off_note(self.line_numbers[-1]))
            del self.lines[-1], self.line_numbers[-1]

    def _first_misfit(self, columns: int, *, more: bool) -> SourceError:
        """Return the error of the first row that is not so many numbers."""
        for k in range(len(self.lines)):
            fields = self._fields(k)
            if len(fields) != columns and not (more and len(fields) > columns):
                return self._wrong(
                    k, f'{len(fields)} columns, needed {"at least " * more}{columns}')
            if not all(map(_is_number, fields[:columns])):
                return self._wrong(k, f'needed {columns} numbers{_heading_hint(fields)}')
        return SourceError(f'{self.path} is no table of {columns} numbers a row')

    def _wrong(self, k: int, what: str) -> SourceError:
        return SourceError(
            f'{self.path}, line {self.line_numbers[k]}: {what}; found {_shown(self.lines[k])}')


def _detect_format(table: _Table) -> str:
    first = table.lines[0]
    fields = first.split(b',' if b',' in first else None)
    hint = _heading_hint(fields)
    if b',' in first:
        if len(fields) >= _COLUMNS['euroc'] and fields[0].strip().isdigit():
            return 'euroc'
        if len(fields) == _COLUMNS['tum'] and all(map(_is_number, fields)):
            hint = ('; of seconds, x, y, z, qx, qy, qz, qw with commas say that the format is '
                    'tum (--format-a, --format-b; --file-format of inspect)')
    elif len(fields) == _COLUMNS['tum']:
        return 'tum'
    elif len(fields) == _COLUMNS['kitti']:
        return 'kitti'
    raise SourceError(
        f'{table.path}, line {table.line_numbers[0]}: no known format; needed 8 numbers (TUM), 12 '
        f'numbers (KITTI), or integer nanoseconds and 7 numbers separated by commas (EuRoC){hint}'
        f'; found {_shown(first)}')


def _heading_hint(fields: list[bytes]) -> str:
    """Return what to do with a row of words."""
    return '' if any(map(_is_number, fields)) else '; put # before a heading'


def _like_a_topic(path: Path) -> bool:
    """Tell /lidar/odometry from the name of a file: nothing is there, nor its folder."""
    at_root = path.is_absolute() and not path.suffix and not path.exists()
    return at_root and (len(path.parts) == 2 or not path.parent.exists())


def _euroc_quaternion_columns(table: _Table) -> list[int]:
    """Return the columns of x, y, z, w: w comes first unless the header says that it is last."""
    for comment in table.comments:
        names = comment.lower().split(b',')
        if len(names) >= 8 and b'w' in names[7] and b'w' not in names[4]:
            table.notes.append('the header names qw last: read as x, y, z, w')
            return [4, 5, 6, 7]
    return [5, 6, 7, 4]


def _seconds_to_ns(field: bytes) -> int:
    """Return exact integer nanoseconds of seconds in decimal; a float would lose 100 ns."""
    stamp_ns = round(Decimal(field.decode('ascii')).scaleb(9))
    if abs(stamp_ns) > _INT64_MAX:
        size = abs(stamp_ns) // 10**9
        unit, divisor = next(item[1:] for item in _EPOCHS if size < item[0])
        raise ValueError(f'is out of range, needed seconds; are these {unit}? Then divide them by '
                         f'{divisor}')
    return stamp_ns


def _integer_ns(field: bytes) -> int:
    if not field.strip().isdigit():
        raise ValueError('is no integer, needed nanoseconds')
    stamp_ns = int(field)
    if stamp_ns > _INT64_MAX:
        raise ValueError('is out of range, needed nanoseconds')
    return stamp_ns


def _is_number(field: bytes) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return b'_' not in field


def _cut_off_note(line_number: int) -> str:
    return f'the last line, {line_number}, is cut off: dropped'


def _lost_note(lost: NDArray[np.bool_]) -> list[str]:
    count = int(np.count_nonzero(lost))
    return [f'{count} of {len(lost)} poses are not finite: dropped'] if count else []


def _shown(text: bytes) -> str:
    shown = text[:60].decode('utf-8', errors='replace')
    return repr(shown + '...' if len(text) > 60 else shown)
