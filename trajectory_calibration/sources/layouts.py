# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The columns of a table: from the option, from a heading, or from the numbers.

The numbers show which columns are a quaternion (norm 1) or a rotation matrix (orthonormal), but
not the order of a quaternion. An ambiguous table raises an error that gives the number of columns
and the option to set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import re

import numpy as np

from trajectory_calibration.errors import ConfigError, counted, SourceError
from trajectory_calibration.geometry.se3 import FloatArray

QUATERNION_ORDERS = ('xyzw', 'wxyz')
# Unit of time -> decimals of a second.
TIME_UNITS = {'s': 0, 'ms': 3, 'us': 6, 'ns': 9}
FROM_NUMBERS = 'from the numbers'

_TOLERANCE = 1e-2
# Fraction of the rows that must fit; a SLAM that is lost writes others.
_MIN_FRACTION = 0.7
# A column of whole seconds does not increase faster than this per row.
_LONGEST_STEP_S = 100.0
_TUM = 't,x,y,z,qx,qy,qz,qw'
POSITION, QUATERNION = ('x', 'y', 'z'), ('qx', 'qy', 'qz', 'qw')
_LAST_COLUMN = ('r14', 'r24', 'r34')
ROTATION = tuple(f'r{i}{j}' for i in '123' for j in '123')
_MATRIX = ('r11', 'r12', 'r13', 'x', 'r21', 'r22', 'r23', 'y', 'r31', 'r32', 'r33', 'z')
_ANGLES, ROTATION_VECTOR = ('roll', 'pitch', 'yaw'), ('rx', 'ry', 'rz')
_DEGREES, _RADIANS = (
    tuple(f'{name}_{unit}' for name in _ANGLES) for unit in ('deg', 'rad'))


@dataclass(frozen=True)
class Layout:
    """The meaning of the columns of a table.

    Attributes
    ----------
    source : where the layout comes from, for messages.
    columns : name -> column index. Time: ``t``, or ``sec`` and ``nsec``, or else the frame
        ``number``. Position: x, y, z. Orientation: qx, qy, qz, qw, or r11 to r33, or roll, pitch,
        yaw (or roll_deg, ... in degrees), or a rotation vector rx, ry, rz.
    unit : of the time, 's', 'ms', 'us' or 'ns'; None to detect it from the magnitude.

    """

    source: str
    columns: dict[str, int]
    unit: str | None = None

    @property
    def time(self) -> int | None:
        """Return the column of the time, or of the whole seconds, None without a time."""
        return self.columns.get('t', self.columns.get('sec'))

    @property
    def pose_columns(self) -> list[int]:
        """Return the columns of the position, then of the orientation."""
        return self.at(POSITION) + (
            self.at(QUATERNION) or self.at(ROTATION) or self.at(_ANGLES) or self.at(_DEGREES)
            or self.at(ROTATION_VECTOR))

    def at(self, names: Sequence[str]) -> list[int]:
        """Return the columns of the names, [] if one is missing."""
        return [self.columns[name] for name in names] if self.columns.keys() >= {*names} else []

    def names(self) -> str:
        """Return the layout in the syntax of ``--columns``."""
        names = {k: '-' if name == 'number' else name for name, k in self.columns.items()}
        return ','.join(names.get(k, '-') for k in range(max(names) + 1))

    def describe(self) -> str:
        """Return 't,x,y,z,qx,qy,qz,qw (TUM)', and the assumed quaternion order if it is one."""
        text = f'{self.names()} ({self.source})'
        if self.source in ('TUM', 'EuRoC', FROM_NUMBERS) and 'qw' in self.columns:
            order = 'wxyz' if self.columns['qw'] < self.columns['qx'] else 'xyzw'
            text += f'; assumed: {order}. Another order: --quaternion-order'
        return text

    def ordered(self, order: str | None) -> Layout:
        """Return the layout with the quaternion in the given order, unchanged for None."""
        if order is None or 'qw' not in self.columns:
            return self
        first = min(self.at(QUATERNION))
        return replace(self, columns=self.columns | {
            f'q{axis}': first + k for k, axis in enumerate(order)})


TUM = Layout('TUM', {name: k for k, name in enumerate(_TUM.split(','))})
EUROC = replace(TUM.ordered('wxyz'), source='EuRoC', unit='ns')
KITTI = Layout('KITTI', {name: k for k, name in enumerate(_MATRIX)})
_BY_WIDTH = {8: TUM, 12: KITTI}


def from_names(text: str, width: int) -> Layout:
    """Return the layout from the ``--columns`` option: comma-separated, ``-`` skips a column.

    Raise ConfigError if a name is unknown or repeated, or the pose is incomplete.
    """
    names = [name.strip() for name in text.split(',')]
    if len(names) > width:
        raise ConfigError(f'columns {text!r} names {len(names)} columns, the file has {width}')
    roles = {}
    for column, name in enumerate(names):
        if name in ('', '-', '_', '...', '…'):
            continue
        role = _role(name)
        if role is None:
            raise ConfigError(f'columns: {name!r} is unknown; needed names such as {_TUM}, or '
                              'sec,nsec for t, r11 to r33, roll,pitch,yaw (roll_deg for degrees), '
                              'rx,ry,rz')
        if role in roles:
            raise ConfigError(f'columns {text!r} names {name} twice')
        roles[role] = column
    layout = _layout(roles, '--columns')
    if layout is None:
        raise ConfigError(f'columns {text!r} names no complete pose; needed x,y,z and qx,qy,qz,qw '
                          'or r11 to r33 or roll,pitch,yaw or rx,ry,rz')
    return layout


def from_headings(headings: Sequence[str], width: int) -> Layout | None:
    """Return the layout from the last heading that names a pose, None if no heading does.

    Raise SourceError if a heading names two columns for the same quantity, or angles without a
    unit.
    """
    for heading in reversed(headings):
        text = re.sub(r'\s+(?=[\[(])', '', heading.lstrip('#%/ \t"'))
        names = re.split(next((mark for mark in ',;' if mark in text), r'\s+'), text.strip())
        names = names[:-1] if len(names) == width + 1 and not names[-1].strip() else names
        found: dict[str, list[int]] = {}
        for column, name in enumerate(names):
            role = _role(name)
            if role is not None:
                found.setdefault(role, []).append(column)
        if len(names) > width or _layout(dict.fromkeys(found, 0), '') is None:
            continue
        times = [role for role in found if role.startswith('t')]
        if {*times} == {'t_s', 't_ns'}:
            found |= {'sec': found.pop('t_s'), 'nsec': found.pop('t_ns')}
        else:
            for role in times[1:]:
                found[times[0]] += found.pop(role)
        roles, doubled = {}, []
        for role, named in found.items():
            # The header stamp is the measurement time, the receive time is not.
            columns = [k for k in named if 'header' in names[k]] or named
            doubled += [columns] if len(columns) > 1 else []
            roles[role] = columns[0]
        option = Layout('', roles).names()
        if doubled:
            raise SourceError(
                f'the heading names {len(doubled[0])} columns for {_role(names[doubled[0][0]])}: '
                f'{", ".join(names[k].strip() for k in doubled[0])}; say which one counts, for '
                f'instance --columns {option} (- skips a column)')
        layout = _layout(roles, 'from the heading')
        if layout is not None and 'roll' in layout.columns and 'roll' in roles:
            in_degrees = re.sub(r'(roll|pitch|yaw)', r'\1_deg', option)
            raise SourceError('the heading names roll, pitch and yaw without their unit; say '
                              f'--columns {option} (radians) or --columns {in_degrees}')
        if layout is not None and 'rx' in layout.columns:
            in_angles = option.replace('rx', 'roll').replace('ry', 'pitch').replace('rz', 'yaw')
            raise SourceError(f'the heading names rx, ry and rz: say --columns {option} (a '
                              f'rotation vector, radians) or --columns {in_angles}')
        return layout
    return None


def from_numbers(
    sample: FloatArray, *, by_commas: bool, timed: bool, order: str | None = None,
) -> Layout:
    """Return the only layout that fits the numbers.

    ``sample`` are (N, C) rows of the file, NaN for words; ``by_commas``: whether commas separate
    the columns; ``timed``: whether the times come from another file; ``order``: of the
    quaternion, if the user gives it.

    Raise SourceError if no layout fits, several do, or the quaternion order is ambiguous.
    """
    width = sample.shape[1]
    seen = f'{counted(width, "column")} and no heading that names a pose'
    # Columns of words, such as frame names, may separate the numeric columns.
    numeric = np.flatnonzero(np.isfinite(sample).any(axis=0))
    if not len(numeric) or numeric[0]:
        numeric = np.arange(width)
    fitting = [layout for layout in _candidates(numeric.tolist(), timed=timed)
               if _fits(layout, sample)]
    # Prefer layouts without a time if another file has the times, and with a time otherwise.
    fitting = [layout for layout in fitting if (layout.time is None) == timed] or fitting
    if not fitting and not by_commas and width in _BY_WIDTH:
        # The error about a row of this layout is clearer than "no layout fits".
        return _BY_WIDTH[width].ordered(order)
    if not fitting:
        hint = ': column 1 is no number (a date? Then it is t)' if np.isnan(
            sample[:, 0]).all() else _HINTS.get(width, '')
        if '--columns' not in hint:
            hint += f'; say what they are, for instance --columns {_TUM} (- skips a column)'
        raise SourceError(f'{seen}; no known layout fits{hint}')
    if len(fitting) > 1:
        raise SourceError(f'{seen}, which may be {" or ".join(map(Layout.names, fitting))}; say '
                          'which with --columns')
    layout = fitting[0]
    quaternion = layout.at(QUATERNION)
    if order is not None or not quaternion:
        return layout.ordered(order)
    if by_commas and layout.at(('t', 'x')) == [0, 1] and _is_nanoseconds(sample):
        # EuRoC is the only comma-separated layout that can be detected from its numbers.
        return EUROC
    if min(quaternion) < min(layout.at(POSITION)):
        raise SourceError(
            f'{seen}; the order of the quaternion (columns {quaternion[0] + 1} to '
            f'{quaternion[3] + 1}?) is open: --columns {layout.names()} or --columns '
            f'{layout.ordered("wxyz").names()}')
    if by_commas:
        raise SourceError(
            f'{seen}, separated by commas: the order of the quaternion is unclear; say '
            '--quaternion-order xyzw or --quaternion-order wxyz')
    return layout


# Number of columns -> hint for a table without a known layout.
_HINTS = {
    3: ': positions without an orientation cannot be calibrated',
    4: ': positions without an orientation cannot be calibrated',
    6: ': three angles? Then --columns x,y,z,roll,pitch,yaw (radians; roll_deg: degrees; '
       'rx,ry,rz: rotation vector)',
    7: ': three angles? Then --columns t,x,y,z,roll,pitch,yaw (radians; roll_deg: degrees; '
       'rx,ry,rz: rotation vector)',
}


def _is_nanoseconds(sample: FloatArray) -> bool:
    """Return whether the first column is a time in nanoseconds."""
    time = sample[:, 0]
    if not (time == np.rint(time)).all():
        return False
    step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    # Frame numbers increase by less.
    return bool(time[0] >= 1e17 or step >= 1e5)


def _candidates(columns: list[int], *, timed: bool) -> list[Layout]:
    """Return all layouts that are possible for the numeric columns."""
    found = []
    for start in ((), ('t',), ('sec', 'nsec'),
                  ('number',), ('number', 't'), ('number', 'sec', 'nsec')):
        count = len(columns) - len(start)
        # If another file has the times, the first column may be the frame number.
        has_time = start[-1:] in (('t',), ('nsec',)) or (timed and start == ('number',))
        has_quaternion = count == 7 or (count > 7 and has_time)
        for pose, fits in ((POSITION + QUATERNION, has_quaternion),
                           (QUATERNION + POSITION, has_quaternion),
                           (_MATRIX, count in (12, 16))):
            if fits:
                found.append(Layout(
                    FROM_NUMBERS, dict(zip(start + pose, columns, strict=False)),
                    's' if 'sec' in start else None))
    return found


def _fits(layout: Layout, sample: FloatArray) -> bool:
    used = sample[:, layout.pose_columns]
    rows = sample[np.isfinite(used).all(axis=1) & (used != 0).any(axis=1)]
    if len(rows) < 1:
        return False
    if 'number' in layout.columns and not _are_frame_numbers(rows[:, layout.columns['number']]):
        return False
    if layout.time is not None:
        time = rows[:, layout.time]
        backwards = int(np.count_nonzero(np.diff(time) < 0))
        if np.isnan(time).any() or backwards > (1 - _MIN_FRACTION) * len(time) or (
                len(time) > 1 and time.max() == time.min()):
            return False
    if 'nsec' in layout.columns:
        seconds, nsec = rows[:, layout.at(('sec', 'nsec'))].T
        whole = (seconds == np.rint(seconds)) & (nsec == np.rint(nsec))
        if not (whole & (nsec >= 0) & (nsec < 1e9)).all() or nsec.max() < 1e3 or (
                seconds[-1] - seconds[0] > _LONGEST_STEP_S * len(seconds)):
            return False
    with np.errstate(over='ignore', invalid='ignore'):
        if layout.at(QUATERNION):
            norm = np.linalg.norm(rows[:, layout.at(QUATERNION)], axis=1)
            fits_rows = np.abs(norm - 1.0) <= _TOLERANCE
        else:
            R = rows[:, layout.at(ROTATION)].reshape(-1, 3, 3)
            residual = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
            fits_rows = residual <= _TOLERANCE
            last = [max(layout.at(POSITION)) + k for k in range(1, 5)]
            if last[-1] < sample.shape[1]:
                fits_rows &= (rows[:, last] == [0, 0, 0, 1]).all(axis=1)
    return bool(fits_rows.mean() >= _MIN_FRACTION)


def _are_frame_numbers(values: FloatArray) -> bool:
    """Return whether values are frame numbers: whole, increasing, between 0 and 1e8."""
    whole = np.isfinite(values).all() and (values == np.rint(values)).all()
    return bool(whole and (np.diff(values) > 0).all() and values[0] >= 0 and values[-1] < 1e8)


def _layout(roles: dict[str, int], source: str) -> Layout | None:
    """Return the layout of named columns, None if they are no complete pose."""
    def first_complete(*choices: Sequence[str]) -> Sequence[str]:
        return next((names for names in choices if roles.keys() >= {*names}), ())

    position = first_complete(POSITION, _LAST_COLUMN)
    orientation = first_complete(
        QUATERNION, ROTATION, _DEGREES, _RADIANS, _ANGLES, ROTATION_VECTOR)
    if not position or not orientation:
        return None
    columns = {name: roles[role] for name, role in zip(POSITION, position, strict=True)}
    columns.update((name.removesuffix('_rad'), roles[name]) for name in orientation)
    if roles.keys() >= {'sec', 'nsec'}:
        return Layout(source, columns | {name: roles[name] for name in ('sec', 'nsec')}, 's')
    units = {'t': None, **{f't_{unit}': unit for unit in TIME_UNITS}, 'sec': 's', 'nsec': 'ns'}
    for name, unit in units.items():
        if name in roles:
            return Layout(source, columns | {'t': roles[name]}, unit)
    return Layout(source, columns | {'number': roles['number']} if 'number' in roles else columns)


# Words in a column name for a quantity other than the pose and its time.
_FOREIGN = {'acc', 'accel', 'acceleration', 'angular', 'b', 'ba', 'bg', 'bias', 'cov',
            'covariance', 'gyro', 'linear', 'omega', 'sigma', 'std', 'twist', 'v', 'vel',
            'velocity'}
_OF_POSITION = {'', 'p', 'pos', 'position', 't', 'trans', 'translation', 'pose'}
_OF_QUATERNION = {'q', 'quat', 'quaternion', 'orientation', 'ori', 'rot', 'rotation', 'attitude'}
_TIMES = {'t', 'time', 'timestamp', 'timestamps', 'stamp', 'utime', 'times'}
_UNITS = {spelling: unit for unit, spellings in (
    ('s', 's sec secs second seconds'), ('ms', 'ms msec'), ('us', 'us usec'),
    ('ns', 'ns nsec nsecs nanosec nanosecs nanosecond nanoseconds nanos'),
) for spelling in spellings.split()}
_JOINED = re.compile(r'(p|t|pos|position|trans|translation|q|quat|quaternion|orientation)([xyzw])')


def _role(name: str) -> str | None:
    """Return the quantity of a column name: t, t_ns, sec, x, qw, r11, roll, number; or None."""
    text = name.strip().strip('"\'#%').lower()
    unit = (re.findall(r'[\[(]\s*(\w+)\s*[\])]', text) or [''])[-1]
    words = [word for word in re.split(r'[\s._/:-]+', re.sub(r'[\[(].*', '', text)) if word]
    if words[1:] and words[-1] == 'm':
        del words[-1]
    if not words or _FOREIGN & set(words):
        return None
    first, last = words[0], words[-1]
    whole = {'s': 'sec', 'ns': 'nsec'}.get(_UNITS.get(last, '')) if len(last) > 2 else None
    if whole and (first not in _TIMES or words[-2] == 'stamp'):
        return whole
    if _TIMES & set(words) and last not in 'xyzw':
        unit = _UNITS.get(unit, _UNITS.get(last, '') if len(words) > 1 else '')
        return f't_{unit}' if unit else 't'
    axis = last if last in _ANGLES else first if last in ('deg', 'rad') else ''
    if axis in _ANGLES:
        return next(
            (f'{axis}_{one}' for one in ('deg', 'rad') if one in (last, unit[:3])), axis)
    if last in ROTATION_VECTOR:
        return last
    if matrix := re.fullmatch(r'[rm]_?([1-3])_?([1-4])', '_'.join(words)):
        return f'r{matrix[1]}{matrix[2]}'
    if joined := _JOINED.fullmatch(last):
        words[-1:] = joined.groups()
        last = words[-1]
    if last in ('x', 'y', 'z', 'w'):
        kind = set(words[:-1])
        if kind & _OF_QUATERNION or last == 'w':
            return f'q{last}'
        return last if not kind or kind & _OF_POSITION else None
    is_number = first in ('frame', 'frameid', 'index', 'idx') and len(words) <= 2
    return 'number' if is_number else None
