# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories in files: tables of any layout, g2o, COLMAP, nerfstudio, NumPy.

docs/inputs.md lists them. A SLAM that is lost writes rows that are not finite, zero quaternions,
or identity poses far from their neighbours. Such rows are dropped with a finding, and so is an
incomplete last line (the recorder was killed). Ambiguous or invalid files raise ``SourceError``,
whose message names the option to try.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import os
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import (
    ROTATION_TOLERANCE,
    SENSOR_FRAME,
    Trajectory,
    WORLD_FRAME,
)
from trajectory_calibration.errors import ConfigError, counted, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.layouts import (
    EUROC,
    from_headings,
    from_names,
    FROM_NUMBERS,
    from_numbers,
    KITTI,
    Layout,
    QUATERNION,
    QUATERNION_ORDERS,
    ROTATION,
    ROTATION_VECTOR,
    TIME_UNITS,
    TUM,
)
from trajectory_calibration.sources.structured import (
    is_array,
    RawPoses,
    read_array,
    structure_of,
    STRUCTURED,
)
from trajectory_calibration.sources.text import read_text, Table
from trajectory_calibration.sources.times import (
    check_seconds,
    read_times,
    time_unit_of,
)
from trajectory_calibration.sources.usable import UsablePoses

_TABLES = {'tum': TUM, 'euroc': EUROC, 'kitti': KITTI}
FORMATS = (*_TABLES, *STRUCTURED, 'npy')


@dataclass(frozen=True)
class FileSource:
    """A trajectory in a file.

    Attributes
    ----------
    path : the file.
    file_format : one of ``FORMATS``; None to detect it.
    times : a file with the time of each pose, one per line, if the first file has no times.
    sensor_frame, world_frame : frame names; the formats have none.
    columns : names of the columns of a table, ``t,x,y,z,qw,qx,qy,qz``; ``-`` skips one.
    quaternion_order : 'xyzw' or 'wxyz'.
    time_unit : 's', 'ms', 'us' or 'ns'.

    """

    path: str | os.PathLike[str]
    file_format: str | None = None
    times: str | os.PathLike[str] | None = None
    sensor_frame: str = SENSOR_FRAME
    world_frame: str = WORLD_FRAME
    columns: str | None = None
    quaternion_order: str | None = None
    time_unit: str | None = None

    def load(self) -> Trajectory:
        """Read the file.

        Raise ConfigError for an option that is unknown or does not fit; SourceError if the file
        cannot be read, is empty, or its layout is unknown or ambiguous.
        """
        return self.load_described()[0]

    def load_described(self) -> tuple[Trajectory, str]:
        """Return the trajectory as ``load`` does, and the columns or format that were used."""
        for name, choices in (('file_format', FORMATS), ('quaternion_order', QUATERNION_ORDERS),
                              ('time_unit', tuple(TIME_UNITS))):
            if getattr(self, name) not in (None, *choices):
                raise ConfigError(f'{name} {getattr(self, name)!r} is unknown; needed one of '
                                  f'{", ".join(choices)}')
        raw = self._with_times(self._read())
        if raw.stamps_ns is None:
            raise SourceError(
                f'{self.path} holds poses that carry no time ({raw.kind}); give the file of their '
                'times as well, one a line: --times-a, --times-b (--times of inspect)')
        usable = UsablePoses(
            str(self.path), counted(len(raw.poses), 'row'), raw.poses, raw.findings)
        usable.drop(_has_no_pose(raw.poses), ': not finite, or a quaternion of zeros')
        return (usable.to_trajectory(raw.stamps_ns, self.world_frame, self.sensor_frame),
                raw.layout or raw.kind)

    def _read(self) -> RawPoses:
        """Return the poses of the file before any row is dropped."""
        path = Path(self.path)
        kind = self.file_format
        if kind == 'npy' or (kind is None and is_array(path)):
            return self._table(read_array(path))
        text = read_text(path)
        if kind is None and self.columns is None:
            kind = structure_of(path, text)
        if kind in STRUCTURED:
            return STRUCTURED[kind](path, text)
        return self._table(Table.parse(path, text))

    def _table(self, table: Table) -> RawPoses:
        """Return the poses of all rows of a table."""
        layout = self._layout(table)
        if table.width <= max(layout.pose_columns):
            raise SourceError(
                f'{self.path}: {counted(table.width, "column")}, {layout.source} needs at least '
                f'{max(layout.pose_columns) + 1}')
        unit = self.time_unit or layout.unit or (
            's' if layout.time is None else time_unit_of(table.sample()[:, layout.time]))
        integers = [layout.columns[name] for name in ('nsec', 'number') if name in layout.columns]
        numbers = table.read_numbers(layout.pose_columns + integers, layout.time, TIME_UNITS[unit])
        values, extra = np.split(numbers.values, [len(layout.pose_columns)], axis=1)
        kind, names = counted(table.width, 'column'), layout.names()
        if layout.time is None and '-' in names.split(','):
            named = re.sub('(^|,)-', r'\1t', names, count=1)
            kind += f'; or does one of them hold it? --columns {named}'
        raw = RawPoses(_poses(values, layout), kind=kind, layout=layout.describe())
        if layout.time is not None:
            raw.poses[~numbers.finite] = np.nan
            raw.stamps_ns = numbers.stamps_ns
            if unit == 'ns' and (~numbers.exact & (np.abs(raw.stamps_ns) < 2**53)).any():
                raise SourceError(f'{self.path}: nanoseconds have no fraction; in which unit are '
                                  'the times? Say --time-unit')
            if 'nsec' in layout.columns:
                if not ((extra[:, 0] >= 0) & (extra[:, 0] < 1e9)).all():
                    raise SourceError(f'{self.path}: column {integers[0] + 1} holds no '
                                      'nanoseconds below one second')
                raw.stamps_ns = raw.stamps_ns + np.rint(extra[:, 0]).astype(np.int64)
            elif unit == 's' and not self.time_unit:
                raw.stamps_ns, raw.findings = check_seconds(raw.stamps_ns, numbers.places)
            if unit not in ('s', layout.unit, self.time_unit):
                raw.findings.append(Finding(
                    'input-read-as', f'its times are read as {unit}, judged by their size',
                    {'unit': unit}))
        if 'number' in layout.columns:
            raw.numbers = np.rint(extra[:, -1]).astype(np.int64)
        if layout.at(QUATERNION):
            self._require_unit_norm(raw, table, layout)
        raw.findings += [Finding('input-repaired', note) for note in table.notes]
        return raw

    def _layout(self, table: Table) -> Layout:
        """Return the layout from the option, else from the heading, else from the numbers."""
        if self.columns is not None:
            return from_names(self.columns, table.width).ordered(self.quaternion_order)
        try:
            layout = from_headings(table.headings, table.width)
            if self.file_format is not None:
                columns = {} if layout is None else layout.columns
                layout = _TABLES[self.file_format]
                if 'qw' in columns and 'qw' in layout.columns:
                    layout = replace(layout, columns=layout.columns | {
                        name: columns[name] for name in QUATERNION})
            elif layout is None:
                layout = from_numbers(
                    table.sample(), by_commas=table.separator == ',', timed=self.times is not None,
                    order=self.quaternion_order)
            return layout.ordered(self.quaternion_order)
        except SourceError as error:
            if str(error).startswith(str(self.path)):
                raise
            raise SourceError(f'{self.path}: {error}') from error

    def _require_unit_norm(self, raw: RawPoses, table: Table, layout: Layout) -> None:
        """Raise SourceError for quaternions not of unit norm; drop a truncated last row."""
        lost = _has_no_pose(raw.poses)
        with np.errstate(over='ignore', invalid='ignore'):
            norm = np.linalg.norm(raw.poses[:, 3:], axis=1)
            wrong = ~lost & ~(np.abs(norm - 1) <= ROTATION_TOLERANCE)
        if wrong[-1] and not table.complete:
            # A row can be truncated within its last number; then only the norm shows it.
            table.drop_last()
            raw.poses[-1] = np.nan
            wrong[-1] = False
        if wrong.any():
            k = int(np.argmax(wrong))
            columns = layout.at(QUATERNION)
            raise SourceError(
                f'{self.path}, line {table.line_numbers[k]}: the norm of the quaternion is '
                f'{norm[k]:.6g}, needed 1; it is numbers {min(columns) + 1} to {max(columns) + 1} '
                f'of {table.width} columns ({layout.source}). If it is not: --columns')
        first = np.abs(raw.poses[~lost][:1, 3:])
        if layout.source in ('TUM', FROM_NUMBERS) and self.quaternion_order is None and (
                np.array_equal(first, [[1, 0, 0, 0]])):
            raw.findings.append(Finding(
                'quaternion-order',
                'the first quaternion is 1 0 0 0, half a turn about x. If the sensor began '
                'without a rotation, w comes first: add --quaternion-order wxyz'))

    def _with_times(self, raw: RawPoses) -> RawPoses:
        """Return the poses with the times from the file ``times``, if given."""
        if self.times is None:
            return raw
        if raw.stamps_ns is not None and raw.numbers is None:
            raise SourceError(f'{self.path} carries its own times; leave {self.times} out')
        stamps_ns, missing = read_times(Path(self.times), self.time_unit)
        poses, count, numbers = len(raw.poses), len(stamps_ns), raw.numbers
        if numbers is not None and poses != count and numbers[0] >= 0 and numbers[-1] < count:
            raw.poses[missing[numbers]] = np.nan
            return replace(raw, stamps_ns=stamps_ns[numbers])
        # A truncated last line makes one of the two files a row shorter.
        if abs(poses - count) > bool(raw.findings):
            raise SourceError(
                f'{self.path} holds {counted(poses, "pose")} and {self.times} '
                f'{counted(count, "time")}; needed one time for each pose')
        used = min(poses, count)
        raw.poses[:used][missing[:used]] = np.nan
        return replace(raw, poses=raw.poses[:used], stamps_ns=stamps_ns[:used])


def _poses(values: FloatArray, layout: Layout) -> FloatArray:
    """Return (N, 7) poses or (N, 4, 4) matrices from the pose columns, (N, K)."""
    if layout.at(QUATERNION):
        return values
    T = np.zeros((len(values), 4, 4))
    T[:, :3, 3], T[:, 3, 3] = values[:, :3], 1.0
    if layout.at(ROTATION):
        T[:, :3, :3] = values[:, 3:].reshape(-1, 3, 3)
        return T
    if layout.at(ROTATION_VECTOR):
        T[:, :3, :3] = se3.exp_so3(values[:, 3:])
        return T
    unit = np.pi / 180 if 'roll_deg' in layout.columns else 1.0
    T[:, :3, :3] = se3.rotation_from_roll_pitch_yaw(unit * values[:, 3:])
    return T


def _has_no_pose(poses: FloatArray) -> NDArray[np.bool_]:
    """Return (N,), which rows have no pose: not finite, or with a zero rotation."""
    rotation = poses[:, 3:] if poses.ndim == 2 else poses[:, :3, :3].reshape(-1, 9)
    lost: NDArray[np.bool_] = np.logical_or(
        ~np.isfinite(poses.reshape(len(poses), -1)).all(axis=1), (rotation == 0).all(axis=1))
    return lost
