# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the columns of a table are: told by a heading, by the user, or by the numbers.

The numbers tell where a quaternion is (four of them have the length one) or a rotation matrix
(nine of them are one), but neither the order of a quaternion nor what is not in the file. What
stays ambiguous is an error that says how many columns there are and which option settles it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import re

import numpy as np

from trajectory_calibration.errors import ConfigError, counted, SourceError
from trajectory_calibration.geometry.se3 import FloatArray

QUATERNION_ORDERS = ('xyzw', 'wxyz')
# Unit of time -> digits after the point of a second.
TIME_UNITS = {'s': 0, 'ms': 3, 'us': 6, 'ns': 9}
FROM_NUMBERS = 'from the numbers'

_TOLERANCE = 1e-2
# Share of the rows that must fit; the others are what a SLAM writes while it is lost.
_MOST = 0.7
_TUM = 't,x,y,z,qx,qy,qz,qw'
_ROTATION = tuple(f'r{i}{j}' for i in '123' for j in '123')


@dataclass(frozen=True)
class Layout:
    """Which column holds what; None or empty where the file does not have it.

    Attributes
    ----------
    source : how this is known, for messages.
    time : the time; nanoseconds : what has to be added to it, where it counts whole seconds.
    unit : of the time, 's', 'ms', 'us' or 'ns'; None where its size must tell.
    number : of the frame, where that stands in place of a time.
    position : x, y, z.
    quaternion : qx, qy, qz, qw.
    rotation : nine columns, row by row.
    angles : roll, pitch, yaw; degrees : their unit.

    """

    source: str
    time: int | None = None
    nanoseconds: int | None = None
    unit: str | None = None
    number: int | None = None
    position: tuple[int, ...] = ()
    quaternion: tuple[int, ...] = ()
    rotation: tuple[int, ...] = ()
    angles: tuple[int, ...] = ()
    degrees: bool = False

    @property
    def pose_columns(self) -> list[int]:
        """All columns of the pose."""
        return [*self.position, *self.quaternion, *self.rotation, *self.angles]

    def describe(self) -> str:
        """Return 't,x,y,z,qx,qy,qz,qw (TUM)', and how another order is read where it matters."""
        text = f'{_names(self)} ({self.source})'
        if self.source in ('TUM', FROM_NUMBERS) and self.quaternion:
            order = 'wxyz' if self.quaternion[3] < self.quaternion[0] else 'xyzw'
            text += f'; assumed: {order}. Another order: --quaternion-order'
        return text

    def ordered(self, order: str | None) -> Layout:
        """Return the layout with the quaternion in another order than it says."""
        if order is None or not self.quaternion:
            return self
        first = min(self.quaternion)
        x, y, z, w = range(first, first + 4) if order == 'xyzw' else (
            first + 1, first + 2, first + 3, first)
        return replace(self, quaternion=(x, y, z, w))


TUM = Layout('TUM', time=0, position=(1, 2, 3), quaternion=(4, 5, 6, 7))
KITTI = Layout('KITTI', position=(3, 7, 11), rotation=(0, 1, 2, 4, 5, 6, 8, 9, 10))
_USUAL = {8: TUM, 12: KITTI}


def from_names(text: str, width: int) -> Layout:
    """Return the layout that the user gave: names separated by commas, ``-`` skips a column.

    Raises
    ------
    ConfigError
        A name is unknown, stands twice, or the pose is not complete.

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
                              'sec,nsec for t, r11 to r33, roll,pitch,yaw (roll_deg for degrees)')
        if role in roles:
            raise ConfigError(f'columns {text!r} names {name} twice')
        roles[role] = column
    layout = _layout(roles, '--columns', angles=True)
    if layout is None:
        raise ConfigError(f'columns {text!r} names no complete pose; needed x,y,z and qx,qy,qz,qw '
                          'or r11 to r33 or roll,pitch,yaw')
    return layout


def from_headings(headings: Sequence[str], width: int) -> Layout | None:
    """Return the layout that a heading names, None where none of them does.

    Raises
    ------
    SourceError
        A heading names two columns for one thing.

    """
    for heading in reversed(headings):
        text = re.sub(r'\s+(?=[\[(])', '', heading.lstrip('#%/ \t"'))
        names = re.split(r'[,;]' if re.search(r'[,;]', text) else r'\s+', text.strip())
        names = names[:-1] if len(names) == width + 1 and not names[-1].strip() else names
        found: dict[str, list[int]] = {}
        for column, name in enumerate(names):
            role = _role(name)
            if role is not None:
                found.setdefault(role, []).append(column)
        if len(names) > width or _layout(dict.fromkeys(found, 0), '') is None:
            continue
        roles = {}
        for role, named in found.items():
            # The time of a message is that of its header, not that of its reception.
            columns = [k for k in named if 'header' in names[k]] or named
            if len(columns) > 1:
                raise SourceError(
                    f'the heading names {len(columns)} columns for {role}: '
                    f'{", ".join(names[k].strip() for k in columns)}; say which one counts: '
                    f'--columns with the names of all {width} columns ({_TUM}, - skips one)')
            roles[role] = columns[0]
        return _layout(roles, 'from the heading')
    return None


def from_numbers(
    sample: FloatArray, *, by_commas: bool, timed: bool, order: str | None = None,
) -> Layout:
    """Return the only layout that fits the numbers.

    Parameters
    ----------
    sample : (N, C)
        Rows of the file; NaN for words.
    by_commas : bool
        Whether commas separate the columns.
    timed : bool
        Whether the times come from another file.
    order : str
        Of the quaternion, where the user says so.

    Raises
    ------
    SourceError
        None fits, several do, or the order of the quaternion is open.

    """
    width = sample.shape[1]
    seen = f'{counted(width, "column")} without a heading that names them'
    fitting = [layout for layout in _candidates(width, timed=timed) if _fits(layout, sample)]
    # Times from another file stand for those in this one, and the other way round.
    fitting = [layout for layout in fitting if (layout.time is None) == timed] or fitting
    if not fitting and not by_commas and width in _USUAL:
        # What is wrong with a row of it is a better message than that nothing fits.
        return _USUAL[width].ordered(order)
    if not fitting:
        raise SourceError(f'{seen}, and no known layout fits{_hint(sample)}; say what they are, '
                          f'for instance --columns {_TUM} (- skips a column)')
    if len(fitting) > 1:
        raise SourceError(f'{seen}, which may be {" or ".join(map(_names, fitting))}; say which '
                          'with --columns')
    layout = fitting[0]
    quaternion = layout.quaternion
    if not quaternion:
        return layout
    if order is not None:
        return layout.ordered(order)
    if by_commas and layout.time == 0 and layout.position == (1, 2, 3) and _nanoseconds(sample):
        # The layout of EuRoC, the only one with commas that its numbers tell.
        return replace(layout.ordered('wxyz'), source='EuRoC', unit='ns')
    if min(quaternion) < min(layout.position):
        raise SourceError(
            f'{seen}; the order of the quaternion (columns {quaternion[0] + 1} to '
            f'{quaternion[3] + 1}?) is open: --columns {_names(layout)} or --columns '
            f'{_names(layout.ordered("wxyz"))}')
    if by_commas:
        raise SourceError(
            f'{seen}, separated by commas: the order of the quaternion is open; say '
            '--quaternion-order xyzw or --quaternion-order wxyz')
    return layout


def _nanoseconds(sample: FloatArray) -> bool:
    """Tell whether the first column counts nanoseconds."""
    time = sample[:, 0]
    if not (time == np.rint(time)).all():
        return False
    step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    # Numbers of frames rise by less.
    return bool(time[0] >= 1e17 or step >= 1e5)


def _candidates(width: int, *, timed: bool) -> list[Layout]:
    """Return all layouts of so many columns."""
    found = []
    for numbered in (False, True):
        for time in ('none', 'time', 'seconds'):
            first = numbered + {'none': 0, 'time': 1, 'seconds': 2}[time]
            base = Layout(
                FROM_NUMBERS, time=None if time == 'none' else int(numbered),
                nanoseconds=numbered + 1 if time == 'seconds' else None,
                unit='s' if time == 'seconds' else None, number=0 if numbered else None)
            rest = width - first
            if rest >= 7 and (rest == 7 or time != 'none'):
                found.append(replace(base, position=tuple(range(first, first + 3)),
                                     quaternion=tuple(range(first + 3, first + 7))))
            if rest == 7:
                found.append(replace(base, position=tuple(range(first + 4, first + 7)),
                                     quaternion=tuple(range(first, first + 4))))
            if rest in (12, 16):
                found.append(replace(
                    base, position=tuple(first + k for k in (3, 7, 11)),
                    rotation=tuple(first + k for k in (0, 1, 2, 4, 5, 6, 8, 9, 10))))
    if timed:
        # With times from elsewhere, what looks like a time is the number of the frame.
        found += [replace(layout, time=None, number=layout.time) for layout in found
                  if layout.time is not None and layout.number is None
                  and layout.nanoseconds is None]
    return list(dict.fromkeys(found))


def _fits(layout: Layout, sample: FloatArray) -> bool:
    used = sample[:, layout.pose_columns]
    rows = sample[np.isfinite(used).all(axis=1) & (used != 0).any(axis=1)]
    if len(rows) < 1:
        return False
    if layout.number is not None and not _counts(rows[:, layout.number]):
        return False
    if layout.time is not None:
        time = rows[:, layout.time]
        backwards = int(np.count_nonzero(np.diff(time) < 0))
        if np.isnan(time).any() or backwards > (1 - _MOST) * len(time) or (
                len(time) > 1 and time.max() == time.min()):
            return False
    if layout.nanoseconds is not None:
        seconds, rest = rows[:, layout.time], rows[:, layout.nanoseconds]
        whole = (seconds == np.rint(seconds)) & (rest == np.rint(rest))
        if not (whole & (rest >= 0) & (rest < 1e9)).all() or rest.max() < 1e3:
            return False
    with np.errstate(over='ignore', invalid='ignore'):
        if layout.quaternion:
            norm = np.linalg.norm(rows[:, layout.quaternion], axis=1)
            good = np.abs(norm - 1.0) <= _TOLERANCE
        else:
            R = rows[:, layout.rotation].reshape(-1, 3, 3)
            off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
            good = off <= _TOLERANCE
            last = [max(layout.position) + k for k in range(1, 5)]
            if last[-1] < sample.shape[1]:
                good &= (rows[:, last] == [0, 0, 0, 1]).all(axis=1)
    return bool(good.mean() >= _MOST)


def _counts(values: FloatArray) -> bool:
    """Tell whether values are numbers of frames: whole, rising, never far from zero."""
    whole = np.isfinite(values).all() and (values == np.rint(values)).all()
    return bool(whole and (np.diff(values) > 0).all() and values[0] >= 0 and values[-1] < 1e8)


def _hint(sample: FloatArray) -> str:
    width = sample.shape[1]
    return {
        3: ': positions without an orientation cannot be calibrated',
        4: ': positions without an orientation cannot be calibrated',
        6: ': three angles? Then --columns x,y,z,roll,pitch,yaw',
        7: ': three angles in radians? Then --columns t,x,y,z,roll,pitch,yaw',
    }.get(width, '')


def _names(layout: Layout) -> str:
    """Return a layout as ``--columns`` takes it."""
    names = {layout.number: '-', layout.time: 't'}
    if layout.nanoseconds is not None:
        names.update({layout.time: 'sec', layout.nanoseconds: 'nsec'})
    names.update(zip(layout.position, 'xyz', strict=False))
    names.update(zip(layout.quaternion, ('qx', 'qy', 'qz', 'qw'), strict=False))
    names.update(zip(layout.rotation, _ROTATION, strict=False))
    names.pop(None, None)
    return ','.join(names.get(k, '-') for k in range(max(k for k in names if k is not None) + 1))


def _layout(roles: dict[str, int], source: str, *, angles: bool = False) -> Layout | None:
    """Return the layout of named columns; None where they make no pose."""
    def columns(*names: str) -> tuple[int, ...]:
        return tuple(roles[name] for name in names) if roles.keys() >= {*names} else ()

    position = columns('x', 'y', 'z') or columns('r14', 'r24', 'r34')
    degrees = 'roll_deg' in roles
    # The first of these that is complete.
    quaternion = columns('qx', 'qy', 'qz', 'qw')
    rotation = () if quaternion else columns(*_ROTATION)
    turned = () if quaternion or rotation or not angles else columns(
        *(f'{axis}{"_deg" * degrees}' for axis in ('roll', 'pitch', 'yaw')))
    if not position or not (quaternion or rotation or turned):
        return None
    unit = next((unit for unit in TIME_UNITS if f't_{unit}' in roles), None)
    time = roles.get('t', roles.get(f't_{unit}'))
    nanoseconds = None
    if 'sec' in roles and 'nsec' in roles:
        time, nanoseconds, unit = roles['sec'], roles['nsec'], 's'
    elif time is None:
        time = roles.get('sec', roles.get('nsec'))
        unit = 's' if 'sec' in roles else 'ns' if 'nsec' in roles else unit
    number = roles.get('number') if time is None else None
    return Layout(source, time, nanoseconds, unit, number, position, quaternion,
                  rotation, turned, degrees)


# Words in the name of a column that belong to something else than the pose and its time.
_FOREIGN = {'acc', 'accel', 'acceleration', 'angular', 'b', 'ba', 'bg', 'bias', 'cov',
            'covariance', 'gyro', 'linear', 'omega', 'sigma', 'std', 'twist', 'v', 'vel',
            'velocity'}
_OF_POSITION = {'', 'p', 'pos', 'position', 't', 'trans', 'translation', 'pose'}
_OF_QUATERNION = {'q', 'quat', 'quaternion', 'orientation', 'ori', 'rot', 'rotation', 'attitude'}
_TIMES = {'t', 'time', 'timestamp', 'timestamps', 'stamp', 'utime', 'times'}
_SECONDS = {'sec', 'secs', 'second', 'seconds'}
_NANOSECONDS = {'nsec', 'nsecs', 'nanosec', 'nanosecs', 'nanosecond', 'nanoseconds', 'nanos'}
_UNITS = {'s': 's', 'sec': 's', 'secs': 's', 'seconds': 's', 'ms': 'ms', 'msec': 'ms', 'us': 'us',
          'usec': 'us', 'ns': 'ns', 'nsec': 'ns', 'nanosec': 'ns'}
_JOINED = re.compile(r'(p|t|pos|position|trans|translation|q|quat|quaternion|orientation)([xyzw])')


def _role(name: str) -> str | None:
    """Return what the name of a column means: t, t_ns, sec, x, qw, r11, roll, number; or None."""
    text = name.strip().strip('"\'#%').lower()
    unit = (re.findall(r'[\[(]\s*(\w+)\s*[\])]', text) or [''])[-1]
    words = [word for word in re.split(r'[\s._/:-]+', re.sub(r'[\[(].*', '', text)) if word]
    if not words or _FOREIGN & set(words):
        return None
    last = words[-1]
    if last in _NANOSECONDS and words[0] not in _TIMES:
        return 'nsec'
    if last in _SECONDS and words[0] not in _TIMES:
        return 'sec'
    if _TIMES & set(words) and last not in 'xyzw':
        unit = _UNITS.get(unit, _UNITS.get(last, '') if len(words) > 1 else '')
        if len(words) > 1 and words[-2] == 'stamp' and last in _SECONDS | _NANOSECONDS:
            return 'sec' if last in _SECONDS else 'nsec'
        return f't_{unit}' if unit else 't'
    if last in ('roll', 'pitch', 'yaw') or (words[0] in ('roll', 'pitch', 'yaw')
                                            and last in ('deg', 'rad')):
        axis = last if last in ('roll', 'pitch', 'yaw') else words[0]
        return f'{axis}_deg' if 'deg' in (last, unit[:3]) else axis
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
    is_number = words[0] in ('frame', 'frameid', 'index', 'idx') and len(words) <= 2
    return 'number' if is_number else None
