# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The result of a calibration: plain, versioned data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timezone
from functools import partial
from importlib import import_module
import os
from pathlib import Path
import re
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.assessment.metrics import (
    absolute_errors,
    AbsoluteErrors,
    RelativeErrors,
)
from trajectory_calibration.assessment.observability import Observability
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import load_yaml, write_yaml
from trajectory_calibration.data.findings import Finding, texts
from trajectory_calibration.data.pose_pairs import AssociationSummary
from trajectory_calibration.data.trajectory import ROTATION_TOLERANCE, Trajectory
from trajectory_calibration.errors import CalibrationError, in_words, ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.version import __version__

# Increased when a key of the saved form changes its meaning.
FORMAT_VERSION = 2

# Largest number of poses or motions; more means a corrupt file.
_LARGEST_COUNT = 10**9

_T = TypeVar('_T')


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """The extrinsic of sensor b in sensor a.

    Attributes
    ----------
    frame_a, frame_b : names of the parent and the child sensor frame.
    T_a_b : (4, 4), the pose of sensor b in sensor a, ``p_a = T_a_b @ p_b``, metres.
    covariance : (6, 6) or None, of translation x, y, z (m) and rotation x, y, z (rad) about the
        fixed axes of a: ``t = t_hat + dt``, ``R = exp(dtheta) R_hat``.
    metrics : mean relative errors e_rt (m) and e_rR (rad) over the motions.
    poses, motions : pairs of poses that were associated, and relative motions formed from them.
    inliers : (motions,) bool, motions that are not outliers; None if the solver rejects none.
    observability, association : observability of each direction, summary of the pose pairs.
    config : the settings.
    findings : on the data and the answer, worst first; codes as in docs/findings.md.
    scale : metres of a per metre of b, by which the positions of b were multiplied.
    time_offset_s, clock_drift, clock_drift_from_ns : stamps of b became
        ``t + clock_drift (t - clock_drift_from_ns) + time_offset_s``.
    diagnosis : noise of the two trajectories as plain data; None if the solver does not identify
        it.
    reference, reference_choice : reference of the motions, and why ``auto`` chose it; None if it
        was given.
    optimality_gap : upper bound of the relative decrease of the cost at any other extrinsic; None
        without a certificate.
    start_ns, duration_s : first stamp of the pairs in the clock of a, and their time span; None in
        older files.
    recording : checksum of all stamps and poses; None in older files.
    version : of the package that made the result.

    """

    frame_a: str
    frame_b: str
    T_a_b: FloatArray
    covariance: FloatArray | None
    metrics: RelativeErrors
    poses: int
    motions: int
    inliers: NDArray[np.bool_] | None
    observability: Observability
    association: AssociationSummary
    config: CalibrationConfig
    findings: tuple[Finding, ...] = ()
    scale: float = 1.0
    time_offset_s: float = 0.0
    clock_drift: float = 0.0
    clock_drift_from_ns: int = 0
    diagnosis: dict[str, Any] | None = None
    reference: str = ''
    reference_choice: str | None = None
    optimality_gap: float | None = None
    start_ns: int | None = None
    duration_s: float | None = None
    recording: str | None = None
    version: str = __version__

    def __post_init__(self) -> None:
        # Copies, so that the caller's arrays cannot change a frozen result.
        for name in ('T_a_b', 'covariance', 'inliers'):
            array = getattr(self, name)
            if array is not None:
                array = np.array(array)
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the texts of the findings."""
        return texts(self.findings)

    @property
    def std(self) -> FloatArray | None:
        """Return the (6,) standard deviations, m and rad, in the order of the covariance."""
        if self.covariance is None:
            return None
        std: FloatArray = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        return std

    @property
    def start_utc(self) -> str | None:
        """Return the start of the data, '2023-11-14T22:13:20Z'; None beyond the calendar."""
        if self.start_ns is None:
            return None
        try:
            start = datetime.fromtimestamp(self.start_ns // 10**9, tz=timezone.utc)
        except (OverflowError, ValueError, OSError):
            return None
        return start.strftime('%Y-%m-%dT%H:%M:%SZ')

    def absolute_errors(self, T_a_b_true: ArrayLike) -> AbsoluteErrors:
        """Return e_at (m) and e_aR (rad) against a known (4, 4) extrinsic."""
        return absolute_errors(self.T_a_b, np.asarray(T_a_b_true, dtype=np.float64))

    def __str__(self) -> str:
        return str(_shown_by('screen').format_result(self)).rstrip('\n')

    def _repr_html_(self) -> str:
        """Return the verdict box for notebooks."""
        return str(_shown_by('report').render_box(self))

    def plot(self, a: Trajectory | None = None, b: Trajectory | None = None) -> Any:
        """Return a Matplotlib figure: standard deviations, and both trajectories if given.

        Needs the extra ``plot``. Save it with ``figure.savefig``.
        """
        return _shown_by('plots').plot(self, a, b)

    def to_dict(self, T_a_b_true: ArrayLike | None = None) -> dict[str, Any]:
        """Return plain data for JSON or YAML; keys that do not apply are None.

        ``T_a_b_true`` (4, 4) fills ``e_at_m`` and ``e_aR_deg``.
        """
        truth = None if T_a_b_true is None else self.absolute_errors(T_a_b_true)
        std = self.std
        rpy_deg = np.rad2deg(se3.roll_pitch_yaw(self.T_a_b[:3, :3]))
        return {
            'format_version': FORMAT_VERSION,
            'package_version': self.version,
            'frame_a': self.frame_a,
            'frame_b': self.frame_b,
            'solver': self.config.solver,
            'reference': self.reference or self.config.reference,
            'reference_choice': self.reference_choice,
            'T_a_b': {
                'translation': self.T_a_b[:3, 3].tolist(),
                'rotation_xyzw': se3.rotation_to_quaternion(self.T_a_b[:3, :3]).tolist(),
                'translation_m': self.T_a_b[:3, 3].tolist(),
                'rotation_rpy_deg': rpy_deg.tolist(),
                # The numbers of an 'unobserved' direction are arbitrary.
                'status': dict(self.observability.status),
            },
            'std_m': None if std is None else std[:3].tolist(),
            'std_deg': None if std is None else np.rad2deg(std[3:]).tolist(),
            'covariance': None if self.covariance is None else self.covariance.tolist(),
            'poses': self.poses,
            'motions': self.motions,
            'inliers': None if self.inliers is None else int(np.count_nonzero(self.inliers)),
            'inlier_motions': None if self.inliers is None else _ranges(self.inliers),
            'e_rt_m': self.metrics.e_rt,
            'e_rR_deg': float(np.rad2deg(self.metrics.e_rR)),
            'e_at_m': None if truth is None else truth.e_at,
            'e_aR_deg': None if truth is None else float(np.rad2deg(truth.e_aR)),
            'scale': self.scale,
            'time_offset_s': self.time_offset_s,
            'clock_drift': self.clock_drift,
            'clock_drift_ppm': 1e6 * self.clock_drift,
            'clock_drift_from_ns': self.clock_drift_from_ns,
            'start_ns': self.start_ns,
            'start_utc': self.start_utc,
            'duration_s': self.duration_s,
            'recording': self.recording,
            'optimality_gap': self.optimality_gap,
            'observability': self.observability.to_dict(),
            'diagnosis': self.diagnosis,
            'association': asdict(self.association),
            'config': self.config.to_dict(),
            'findings': [found.to_dict() for found in self.findings],
            'warnings': list(self.warnings),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> CalibrationResult:
        """Rebuild a result from ``to_dict``.

        Raises ResultError for missing keys, wrong types, a newer format, and numbers that are no
        rotation or no covariance.
        """
        try:
            data = {**_OLDER, **data}
            if data['format_version'] not in range(1, FORMAT_VERSION + 1):
                raise ResultError(
                    f'result has the format {data["format_version"]}, this version reads '
                    f'{FORMAT_VERSION}; install the version that wrote it '
                    f'({data.get("package_version")})')
            ranges = data['inlier_motions']
            findings = _findings(data)
            return cls(
                T_a_b=pose_from(data['T_a_b']),
                metrics=RelativeErrors(
                    _number(data['e_rt_m']), float(np.deg2rad(_number(data['e_rR_deg'])))),
                inliers=None if ranges is None else _mask(ranges, _count(data['motions'])),
                observability=Observability.from_dict(
                    data['observability'],
                    [found for found in findings if found.code.startswith('direction-')]),
                findings=findings,
                version=str(data['package_version']),
                **{name: read(data[name]) for name, read in _READ.items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            if isinstance(error, CalibrationError):
                raise ResultError(f'not a calibration result: {error}') from error
            raise ResultError(
                f'not a calibration result: {in_words(error)}; needed the result.yaml of a '
                'calibration') from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML to ``path``, whole or not at all.

        Raises ResultError; an earlier file at ``path`` is then unchanged.
        """
        write_yaml(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> CalibrationResult:
        """Read what ``save`` wrote; raise ResultError for anything else."""
        return load_yaml(
            Path(path), cls.from_dict, ResultError, 'a result',
            'no calibration result; needed the result.yaml of a calibration')


def _shown_by(module: str) -> Any:
    """Return a module of ``outputs``, loaded on use, because it imports this one."""
    return import_module(f'trajectory_calibration.outputs.{module}')


def _of_kind(kind: type[_T], value: Any) -> _T:
    # A bool is an int in Python, but no count.
    if not isinstance(value, kind) or isinstance(value, bool):
        found = f'found {value!r}, needed a value of type {kind.__name__}'
        raise ValueError(found)  # noqa: TRY004
    return value


def _number(value: Any) -> float:
    number = float(_of_kind(float, float(value) if type(value) is int else value))
    if not np.isfinite(number):
        raise ValueError(f'found {number}, needed a finite number')
    return number


def _count(value: Any) -> int:
    count = _of_kind(int, value)
    if not 0 <= count <= _LARGEST_COUNT:
        raise ValueError(f'found {count}, needed a number from 0 to {_LARGEST_COUNT}')
    return count


def _findings(data: dict[str, Any]) -> tuple[Finding, ...]:
    if data['format_version'] == 1:
        return tuple(Finding('other', _of_kind(str, item))
                     for item in _of_kind(list, data['warnings']))
    return tuple(Finding.from_dict(_of_kind(dict, item))
                 for item in _of_kind(list, data['findings']))


def _association(data: Any) -> AssociationSummary:
    read: dict[str, Callable[[Any], Any]] = {'str': str, 'int': _count, 'float': _number}
    # Older files always used the stamps of b.
    given = {'stamps_of': 'b', **data}
    return AssociationSummary(**{
        item.name: read[str(item.type)](given[item.name]) for item in fields(AssociationSummary)})


def finite(values: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return numbers of a file as an array; raise ValueError for another shape, or NaN."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f'found {values!r}, needed {shape} finite numbers')
    return array


def pose_from(data: Mapping[str, Any]) -> FloatArray:
    """Return the (4, 4) pose of a file, with the rounding of its digits removed.

    Raises ResultError for a quaternion that is no rotation, else as ``finite``.
    """
    q = finite(data['rotation_xyzw'], (4,))
    with np.errstate(over='ignore'):
        norm = float(np.linalg.norm(q))
    if not abs(norm - 1) <= ROTATION_TOLERANCE:
        raise ResultError(
            f'rotation_xyzw is no rotation: its norm is {norm:.6g}, off 1 by more than '
            f'{ROTATION_TOLERANCE}; restore the file as it was saved')
    return se3.from_rotation_translation(
        se3.quaternion_to_rotation(q / norm), finite(data['translation'], (3,)))


def _covariance(values: Any) -> FloatArray:
    P = finite(values, (6, 6))
    # Rounding of a zero variance, or of a symmetric sum.
    rounding = 1e-9 * np.abs(P).max()
    if (np.diagonal(P) < -rounding).any():
        raise ResultError('covariance has a negative variance; restore the file as it was saved')
    if np.abs(P - P.T).max() > rounding:
        raise ResultError('covariance is not symmetric; restore the file as it was saved')
    return P


def _ranges(mask: NDArray[np.bool_]) -> str:
    """Write a mask as the ranges that are set, '0-34,37-99': one line for a million motions."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return ','.join(f'{start}-{end - 1}' for start, end in edges.reshape(-1, 2))


def _mask(ranges: str, length: int) -> NDArray[np.bool_]:
    mask = np.zeros(length, dtype=bool)
    for part in filter(None, ranges.split(',')):
        found = re.fullmatch(r'(\d+)-(\d+)', part)
        start, end = (int(found[1]), int(found[2])) if found else (1, 0)
        if not start <= end < length:
            raise ValueError(f'inlier_motions has {part!r}, needed ranges within 0-{length - 1}')
        mask[start:end + 1] = True
    return mask


def _or_none(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else read(value)


# The keys of a file that are fields by themselves.
_READ: dict[str, Callable[[Any], Any]] = {
    'frame_a': str, 'frame_b': str, 'covariance': _or_none(_covariance), 'poses': _count,
    'motions': _count, 'association': _association,
    'config': lambda value: CalibrationConfig.from_saved(_of_kind(dict, value)),
    'scale': _number, 'time_offset_s': _number, 'clock_drift': _number,
    'clock_drift_from_ns': int, 'diagnosis': _or_none(partial(_of_kind, dict)),
    'reference': str, 'reference_choice': _or_none(partial(_of_kind, str)),
    'optimality_gap': _or_none(_number), 'start_ns': _or_none(partial(_of_kind, int)),
    'duration_s': _or_none(_number), 'recording': _or_none(partial(_of_kind, str)),
}

# Keys that older files lack; before clocks were known to drift, a result had none.
_OLDER = {'clock_drift': 0.0, 'clock_drift_from_ns': 0, 'start_ns': None, 'duration_s': None,
          'recording': None}
