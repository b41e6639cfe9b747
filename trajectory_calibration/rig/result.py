# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The result of the calibration of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
import os
from pathlib import Path
from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import (
    DEGREES_OF_FREEDOM,
    deviations_of,
    status_of,
    UNOBSERVED,
)
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import load_yaml, write_yaml
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import CalibrationError, ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import exceedance
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import finite, pose_from
from trajectory_calibration.rig.noise import SensorNoise
from trajectory_calibration.rig.settings import RigConfig
from trajectory_calibration.rig.shared_noise import twist_to_step
from trajectory_calibration.rig.windows import Clock
from trajectory_calibration.version import __version__

# Incremented when a key of the saved file changes its meaning.
RIG_FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class SensorAnswer:
    """One sensor of the rig.

    Attributes
    ----------
    name, frame : of the sensor, and of its frame.
    base : name of the root of its tree; the pose is in its frame.
    T_base_sensor : (4, 4), metres.
    covariance : (6, 6), order and side as in ``CalibrationResult``; zero for a root.
    status : 'observed', 'weak', 'unobserved', or 'prior' if only the prior determines it, by x, y,
        z, rotation x, y, z.
    scale, scale_std : metres of the base per metre of the sensor.
    clock : of the sensor.
    noise : of the sensor, or None if unknown.
    poses : number of poses of its trajectory; 0 for a rig from saved results.

    """

    name: str
    frame: str
    base: str
    T_base_sensor: FloatArray
    covariance: FloatArray
    status: Mapping[str, str]
    scale: float = 1.0
    scale_std: float = 0.0
    clock: Clock = field(default_factory=Clock)
    noise: SensorNoise | None = None
    poses: int = 0

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Return the unobservable components."""
        return tuple(name for name in DEGREES_OF_FREEDOM if self.status.get(name) == UNOBSERVED)


@dataclass(frozen=True, eq=False)
class PairReport:
    """One pair compared with the rig.

    Attributes
    ----------
    parent, child : names.
    failure : why there is no answer, or empty.
    residual : (6,), step from the rig to its answer, in covariance order; NaN without an answer.
    std : (6,), standard deviations of the pair.
    chi_squared, degrees : of the residual along observed directions; NaN if no other pair checks
        it.
    poses : number of pose pairs.
    used : whether it influences the rig.

    """

    parent: str
    child: str
    failure: str = ''
    residual: FloatArray = field(default_factory=lambda: np.full(6, np.nan))
    std: FloatArray = field(default_factory=lambda: np.full(6, np.nan))
    chi_squared: float = float('nan')
    degrees: int = 0
    poses: int = 0
    used: bool = True

    @property
    def p_value(self) -> float:
        """Return the p-value of the chi-squared; 1 if no other pair checks it."""
        return exceedance(self.chi_squared, self.degrees)

    @property
    def words(self) -> str:
        """Return the failure or the chi-squared as text."""
        return self.failure or (
            f'chi-squared {self.chi_squared:.1f} of {self.degrees}' if self.degrees else
            'no other pair checks it')


@dataclass(frozen=True)
class Contradiction:
    """A sensor that does not fit the others.

    Attributes
    ----------
    sensor : its name.
    kind : 'moved', 'clock', 'loops', 'vehicle', 'prior' or 'time'.
    text : description and advice.
    chi_squared, degrees, p_value : of the test, if there is one.
    left_out : whether the sensor is not in the result.

    """

    sensor: str
    kind: str
    text: str
    chi_squared: float | None = None
    degrees: int | None = None
    p_value: float | None = None
    left_out: bool = False


@dataclass(frozen=True, eq=False)
class RigResult:
    """One consistent rig.

    Attributes
    ----------
    base : name of the base.
    sensors : by name, the base first; without sensors that have no answer.
    covariance : (6 M, 6 M), of ``free`` in its order, each sensor as in ``CalibrationResult``.
    free : (M,) names of the sensors that are not the root of a tree.
    pairs : all pairs that were calibrated, with failures.
    contradictions : sensors that do not fit the others, worst first.
    chi_squared, degrees : of all loops.
    findings : about the rig, worst first.
    config : the settings.
    recordings : ``recording_of`` each trajectory; rigs with a common one have common errors. Empty
        in files without it.
    version : of the package.

    """

    base: str
    sensors: Mapping[str, SensorAnswer]
    covariance: FloatArray
    free: tuple[str, ...]
    pairs: tuple[PairReport, ...]
    contradictions: tuple[Contradiction, ...]
    chi_squared: float
    degrees: int
    findings: tuple[Finding, ...]
    config: RigConfig
    recordings: tuple[str, ...] = ()
    version: str = __version__

    @property
    def p_value(self) -> float:
        """Return the p-value of the chi-squared of the loops."""
        return exceedance(self.chi_squared, self.degrees)

    @property
    def trees(self) -> dict[str, tuple[str, ...]]:
        """Return the names of the sensors of each tree, by its base."""
        found: dict[str, tuple[str, ...]] = {}
        for name, sensor in self.sensors.items():
            found[sensor.base] = (*found.get(sensor.base, ()), name)
        return found

    @property
    def unobserved(self) -> dict[str, tuple[str, ...]]:
        """Return the unobservable components by sensor, without sensors that have none."""
        return {name: sensor.unobserved for name, sensor in self.sensors.items()
                if sensor.unobserved}

    @property
    def unplaced(self) -> tuple[str, ...]:
        """Return the sensors of all pairs that have no pose in the base."""
        names = dict.fromkeys(
            name for pair in self.pairs for name in (pair.parent, pair.child))
        return tuple(name for name in names if name not in self.trees.get(self.base, ()))

    def transform(self, parent: str, child: str) -> FloatArray:
        """Return the (4, 4) pose of child in parent; the product over a loop is the identity.

        Raises ResultError for a sensor that is not in the rig, or sensors of two trees.
        """
        a, b = self._both(parent, child)
        return se3.inverse(a.T_base_sensor) @ b.T_base_sensor

    def covariance_of(self, parent: str, child: str) -> FloatArray:
        """Return the (6, 6) covariance of ``transform``, about the fixed axes of the parent."""
        a, b = self._both(parent, child)
        rows = twist_to_step(a.T_base_sensor, b.T_base_sensor) @ (
            twist_rows(self, child) - twist_rows(self, parent))
        covariance: FloatArray = rows @ self.covariance @ rows.T
        return covariance

    def _both(self, parent: str, child: str) -> tuple[SensorAnswer, SensorAnswer]:
        for name in (parent, child):
            if name not in self.sensors:
                raise ResultError(f'sensor {name} is not part of the rig; it has '
                                  f'{", ".join(self.sensors)}')
        a, b = self.sensors[parent], self.sensors[child]
        if a.base != b.base:
            raise ResultError(f'{parent} and {child} have no common motion: the first is in the '
                              f'tree of {a.base}, the second in that of {b.base}')
        return a, b

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON or YAML."""
        return {
            'rig_format_version': RIG_FORMAT_VERSION,
            'package_version': self.version,
            'base': self.base,
            'sensors': {name: _sensor_to_dict(sensor) for name, sensor in self.sensors.items()},
            'covariance_of': list(self.free),
            'covariance': self.covariance.tolist(),
            'chi_squared': self.chi_squared,
            'degrees_of_freedom': self.degrees,
            'p_value': self.p_value,
            'pairs': [_pair_to_dict(pair) for pair in self.pairs],
            'contradictions': [asdict(item) for item in self.contradictions],
            'findings': [found.to_dict() for found in self.findings],
            'recordings': list(self.recordings),
            'config': self.config.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> RigResult:
        """Build a rig from the output of ``to_dict``; raises ResultError."""
        try:
            if data['rig_format_version'] != RIG_FORMAT_VERSION:
                raise ResultError(
                    f'rig_format_version is {data["rig_format_version"]}, needed '
                    f'{RIG_FORMAT_VERSION}; install the version that wrote it')
            sensors = {str(name): _sensor_from_dict(str(name), item)
                       for name, item in data['sensors'].items()}
            free = tuple(map(str, data['covariance_of']))
            # Without free sensors the covariance is an empty list.
            shape = 6 * len(free), 6 * len(free)
            return cls(
                base=str(data['base']), sensors=sensors, free=free,
                covariance=finite(np.reshape(data['covariance'], shape), shape),
                pairs=tuple(_pair_from_dict(item) for item in data['pairs']),
                contradictions=tuple(Contradiction(**item) for item in data['contradictions']),
                chi_squared=float(data['chi_squared']), degrees=int(data['degrees_of_freedom']),
                findings=tuple(map(Finding.from_dict, data['findings'])),
                config=RigConfig.from_saved(data['config']),
                recordings=tuple(map(str, data.get('recordings', ()))),
                version=str(data['package_version']))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            reason = str(error) if isinstance(error, CalibrationError) else (
                f'{type(error).__name__}: {error}; needed what this package saved')
            raise ResultError(f'not a rig: {reason}') from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write YAML, whole or not at all; raises ResultError."""
        write_yaml(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RigResult:
        """Read a file of ``save``; raises ResultError."""
        return load_yaml(Path(path), cls.from_dict, ResultError, 'a rig',
                         'no rig; needed what save() wrote')


def is_rig(path: Path) -> bool:
    """Return whether a file is a saved rig; False if it cannot be read."""
    try:
        return 'rig_format_version' in path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError):
        return False


def statuses(covariance: FloatArray, config: CalibrationConfig) -> dict[str, str]:
    """Return the status of each component of a (6, 6) covariance by the limits of the settings."""
    return {name: status_of(config, std, rotation=k >= 3) for k, (name, std) in enumerate(
        zip(DEGREES_OF_FREEDOM, deviations_of(covariance).tolist(), strict=True))}


def twist_rows(rig: RigResult, name: str) -> FloatArray:
    """Return the (6, 6 M) Jacobian of a twist of a sensor about its base by steps of the rig."""
    rows = np.zeros((6, len(rig.covariance)))
    if name in rig.free:
        k = 6 * rig.free.index(name)
        rows[:, k:k + 6] = np.linalg.inv(
            twist_to_step(np.eye(4), rig.sensors[name].T_base_sensor))
    return rows


def _sensor_to_dict(sensor: SensorAnswer) -> dict[str, Any]:
    T = sensor.T_base_sensor
    values = {
        **asdict(sensor),
        'T_base_sensor': {'translation': T[:3, 3].tolist(),
                          'rotation_xyzw': se3.rotation_to_quaternion(T[:3, :3]).tolist()},
        'covariance': sensor.covariance.tolist()}
    del values['name']
    return values


def _sensor_from_dict(name: str, data: Mapping[str, Any]) -> SensorAnswer:
    return SensorAnswer(
        name=name, frame=str(data['frame']), base=str(data['base']),
        T_base_sensor=pose_from(data['T_base_sensor']),
        covariance=finite(data['covariance'], (6, 6)),
        status={str(key): str(value) for key, value in data['status'].items()},
        scale=float(data['scale']), scale_std=float(data['scale_std']),
        clock=Clock(**data['clock']),
        noise=None if data['noise'] is None else SensorNoise(**data['noise']),
        poses=int(data['poses']))


def _pair_to_dict(pair: PairReport) -> dict[str, Any]:
    values = {**vars(pair), 'residual': pair.residual.tolist(), 'std': pair.std.tolist()}
    return {name: None if isinstance(value, (float, list)) and not np.isfinite(value).all()
            else value for name, value in values.items()}


def _pair_from_dict(data: Mapping[str, Any]) -> PairReport:
    # None is NaN to NumPy.
    values = {name: np.array(data[name], dtype=np.float64) for name in (
        'residual', 'std', 'chi_squared')}
    return PairReport(**{
        **data, **{name: np.broadcast_to(values[name], 6) for name in ('residual', 'std')},
        'chi_squared': float(values['chi_squared'])})
