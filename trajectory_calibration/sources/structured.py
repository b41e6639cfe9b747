# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses in files other than text tables: g2o, COLMAP, nerfstudio, NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import in_words, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.numbers import is_number, Numbers, with_times
from trajectory_calibration.sources.text import Table
from trajectory_calibration.sources.times import stamps_in_names

_COLMAP_COLUMNS = 10


@dataclass(eq=False)
class RawPoses:
    """All poses of a file, unfiltered.

    Attributes
    ----------
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw; or (N, 4, 4) matrices.
    stamps_ns : (N,), None if the file has no times.
    numbers : (N,) frame numbers, None if the file has none.
    findings : repairs.
    kind : of the file, in words.
    layout : of the columns, in words; '' if the format defines it.

    """

    poses: FloatArray
    stamps_ns: NDArray[np.int64] | None = None
    numbers: NDArray[np.int64] | None = None
    findings: list[Finding] = field(default_factory=list)
    kind: str = ''
    layout: str = ''


def is_array(path: Path) -> bool:
    """Return whether a file is a NumPy array, by its suffix or its first bytes."""
    try:
        with path.open('rb') as file:
            return path.suffix == '.npy' or file.read(6) == b'\x93NUMPY'
    except OSError:
        # The error is reported when the file is read.
        return False


@dataclass
class ArrayTable(Table):
    """A table of numbers, (N, C), from an array file."""

    array: FloatArray = field(kw_only=True)

    def read_numbers(
        self, columns: Sequence[int], time_column: int | None = None, decimals: int = 0,
    ) -> Numbers:
        """Return columns as ``Table.read_numbers`` does; times by their shortest decimals."""
        words = [] if time_column is None else self.array[:, time_column].tolist()
        return with_times(
            self.array[:, list(columns)], list(map(repr, words)), time_column, decimals)

    def sample(self) -> FloatArray:
        """Return all rows."""
        return self.array


def read_array(path: Path) -> ArrayTable:
    """Return the table of a file with an array (N, 4, 4), (N, 3, 4) or (N, C)."""
    try:
        array = np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except Exception as error:
        # A damaged header can raise any exception in NumPy.
        raise SourceError(f'{path} cannot be read as an array of numbers ({error})') from error
    if array.ndim == 3 and array.shape[1:] in ((3, 4), (4, 4)):
        array = array.reshape(len(array), -1)
    if array.ndim != 2 or not array.size:
        raise SourceError(f'{path} holds an array of shape {array.shape}; needed (N, 4, 4), '
                          '(N, 3, 4) or one row a pose')
    return ArrayTable(path, [], range(1, len(array) + 1), [], None, array.shape[1],
                      complete=True, array=array)


def structure_of(path: Path, text: str) -> str | None:
    """Return the key of ``STRUCTURED`` for a text, None for a table."""
    beginning = text[:2000].lstrip()
    if path.suffix == '.json' or beginning.startswith('{'):
        return 'nerfstudio'
    if path.suffix == '.g2o' or 'VERTEX_SE' in beginning or 'EDGE_SE' in beginning:
        return 'g2o'
    if 'IMAGE_ID' in beginning and 'CAMERA_ID' in beginning:
        return 'colmap'
    return None


def read_g2o(path: Path, text: str) -> RawPoses:
    """Return the vertices of a pose graph; their ids are the frame numbers."""
    lines = [line for line in text.split('\n') if line.startswith('VERTEX_SE3:QUAT')]
    if not lines:
        planar = ': planar poses cannot be used' if 'VERTEX_SE2' in text else ''
        raise SourceError(f'{path} holds no VERTEX_SE3:QUAT{planar}')
    table = Table.parse(path, '\n'.join(lines) + '\n')
    if table.width < 9:
        raise SourceError(f'{path}: a VERTEX_SE3:QUAT needs an id and 7 numbers')
    # Ids have up to 64 bits; the low 48 bits are the index of the pose in the track of a robot.
    ids = np.array([int(line.split(None, 2)[1]) for line in lines], dtype=np.uint64)
    order = np.argsort(ids, kind='stable')
    numbers = (ids[order] & np.uint64(2**48 - 1)).astype(np.int64)
    return RawPoses(
        table.read_numbers(list(range(2, 9))).values[order], None, numbers, kind='g2o')


def read_colmap(path: Path, text: str) -> RawPoses:
    """Return the camera poses of an images.txt, the inverse of its world-to-camera transforms."""
    rows, names = [], []
    for line in text.split('\n'):
        words = line.split(None, _COLMAP_COLUMNS - 1)
        if line.startswith('#') or len(words) < _COLMAP_COLUMNS or (
                is_number(words[-1].split()[0])):
            continue
        rows.append(' '.join(words[1:8]))
        names.append(words[-1].strip())
    if not rows:
        raise SourceError(f'{path} holds no images of COLMAP: IMAGE_ID, QW, QX, QY, QZ, TX, TY, '
                          'TZ, CAMERA_ID, NAME')
    values = Table.parse(path, '\n'.join(rows) + '\n').read_numbers(list(range(7))).values
    norm = np.linalg.norm(values[:, :4], axis=1, keepdims=True)
    if not (np.abs(norm - 1) < 1e-2).all():
        raise SourceError(f'{path}: a quaternion (QW, QX, QY, QZ) is not of norm 1')
    R = se3.quaternion_to_rotation((values[:, :4] / norm)[:, [1, 2, 3, 0]])
    poses = se3.inverse(se3.from_rotation_translation(R, values[:, 4:]))
    return _sorted_by_name(poses, names, path)


def read_nerfstudio(path: Path, text: str) -> RawPoses:
    """Return the ``transform_matrix`` of each frame of a transforms.json, unchanged.

    Camera axes as in OpenGL: it looks along -z, y is up.
    """
    import json
    try:
        frames = json.loads(text)['frames']
        poses = np.array([_completed(frame['transform_matrix']) for frame in frames], dtype=float)
        names = [str(frame.get('file_path', '')) for frame in frames]
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        what = 'is JSON, but no' if text.lstrip().startswith('{') else 'is no'
        raise SourceError(f'{path} {what} transforms.json with "frames" that have a '
                          f'"transform_matrix" each ({in_words(error)})') from error
    if poses.shape[1:] != (4, 4):
        raise SourceError(f'{path} holds no 4 x 4 matrices')
    return _sorted_by_name(poses, names, path)


def _sorted_by_name(poses: FloatArray, names: list[str], path: Path) -> RawPoses:
    stamps_ns, numbers = stamps_in_names(names, path)
    keys = numbers if stamps_ns is None else stamps_ns
    order = np.arange(len(poses)) if keys is None else np.argsort(keys)
    return RawPoses(poses[order], None if stamps_ns is None else stamps_ns[order],
                    None if numbers is None else numbers[order],
                    kind='names of images that are no times')


def _completed(matrix: Any) -> list[list[float]]:
    """Return a 3 x 4 matrix with the row 0 0 0 1 appended; others unchanged."""
    return [*matrix, [0.0, 0.0, 0.0, 1.0]] if len(matrix) == 3 else matrix


STRUCTURED = {'g2o': read_g2o, 'colmap': read_colmap, 'nerfstudio': read_nerfstudio}
