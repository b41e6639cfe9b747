# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of a rig and of its sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, MISSING
from typing import Any

from trajectory_calibration.config.prior import parse_prior, Prior
from trajectory_calibration.config.settings import CalibrationConfig, Option
from trajectory_calibration.errors import ConfigError, unknown_name
from trajectory_calibration.solvers import solver_info, solvers_that_estimate

SCALES = ('metric', 'free')
PAIRS = ('auto', 'all', 'base')


@dataclass(frozen=True)
class SensorSettings:
    """Settings of one sensor.

    Attributes
    ----------
    scale : 'metric', or 'free' for a monocular camera, whose scale is estimated.
    frame : name of the sensor's frame in exports; empty: that of the trajectory.
    prior_translation, prior_translation_std, prior_rotation, prior_rotation_std : the pose in the
        base, as the settings of the same names of ``CalibrationConfig``; standard deviations of 0
        fix it.

    """

    scale: str = 'metric'
    frame: str = ''
    prior_translation: str = ''
    prior_translation_std: str = ''
    prior_rotation: str = ''
    prior_rotation_std: str = ''

    def __post_init__(self) -> None:
        _check(self)
        _ = self.prior

    @property
    def prior(self) -> Prior:
        """Return the prior of the pose in the base."""
        return parse_prior(self.prior_translation, self.prior_translation_std,
                           self.prior_rotation, self.prior_rotation_std)

    @property
    def given(self) -> dict[str, Any]:
        """Return the prior as settings of ``CalibrationConfig``."""
        return {name: value for name, value in asdict(self).items()
                if name.startswith('prior_') and value}

    @classmethod
    def from_dict(cls, values: Any, name: str) -> SensorSettings:
        """Build settings of the sensor ``name``; unknown keys raise ConfigError."""
        given = _lines(values, f'sensor {name}')
        require_known(given, [item.name for item in fields(cls)], f' of sensor {name}')
        try:
            return cls(**given)
        except ConfigError as error:
            raise ConfigError(f'sensor {name}: {error}') from error


@dataclass(frozen=True)
class RigConfig:
    """Settings of a rig.

    Attributes
    ----------
    base : name of the sensor whose frame is the rig's; empty: the first.
    sensors : by name; those that are not listed have the defaults.
    pairs : which pairs are calibrated: 'all'; 'base': those with the base; 'auto': all of up to
        four sensors, with more those with the base and with the two most certain others.
    leave_out_contradicting : whether a sensor that contradicts the others is left out of the
        result; otherwise it is in the result without influence on the others.
    processes : that calibrate pairs; 0: one per core if that saves time.
    calibration : settings of every pair.

    """

    base: str = ''
    sensors: Mapping[str, SensorSettings] = field(default_factory=dict)
    pairs: str = 'auto'
    leave_out_contradicting: bool = False
    processes: int = 0
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)

    def __post_init__(self) -> None:
        _check(self)
        if self.calibration.prior.given:
            raise ConfigError('a rig has a prior for each sensor, not one for all; write '
                              'prior_translation and the others below the sensor')

    def scale_of(self, child: str) -> dict[str, Any]:
        """Return the settings of ``calibration`` for the scale of a sensor as child.

        Raises ConfigError for a free scale with a solver that does not estimate it.
        """
        if self.of(child).scale != 'free':
            return {}
        if 'scale' not in solver_info(self.calibration.solver).estimates:
            raise ConfigError(
                f'sensor {child} has scale free, which solver {self.calibration.solver} cannot '
                f'find; use solver {" or ".join(solvers_that_estimate("scale"))}')
        return {'scale_mode': 'estimate', 'scale': 1.0}

    def of(self, name: str) -> SensorSettings:
        """Return the settings of one sensor."""
        return self.sensors.get(name, SensorSettings())

    def to_dict(self) -> dict[str, Any]:
        """Return names and values, ready for YAML or JSON."""
        return {**asdict(self), 'calibration': self.calibration.to_dict()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RigConfig:
        """Build a configuration from plain data; unknown keys raise ConfigError."""
        require_known(values, [item.name for item in fields(cls)], ' of the rig')
        given = dict(values)
        if 'sensors' in given:
            given['sensors'] = {str(name): SensorSettings.from_dict(value or {}, name)
                                for name, value in _lines(given['sensors'], 'sensors').items()}
        if 'calibration' in given:
            given['calibration'] = CalibrationConfig.from_dict(
                _lines(given['calibration'] or {}, 'calibration'))
        config = cls(**given)
        # Before any data is read.
        for name in config.sensors:
            config.scale_of(name)
        return config

    @classmethod
    def from_saved(cls, values: Mapping[str, Any]) -> RigConfig:
        """Rebuild the configuration of a saved rig; see ``CalibrationConfig.from_saved``."""
        return cls(**{
            **known_of(cls, values),
            'sensors': {
                str(name): SensorSettings(
                    **known_of(SensorSettings, _lines(given, f'sensor {name}')))
                for name, given in _lines(values['sensors'], 'sensors').items()},
            'calibration': CalibrationConfig.from_saved(
                _lines(values['calibration'], 'calibration'))})


def known_of(kind: type[SensorSettings | RigConfig], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are fields of a settings class."""
    return {item.name: values[item.name] for item in fields(kind) if item.name in values}


def require_known(values: Iterable[str], known: Sequence[str], where: str) -> None:
    """Raise ConfigError for an unknown key."""
    for key in values:
        if key not in known:
            raise ConfigError(unknown_name('key', key, known, where))


def _lines(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f'{name} is {value!r}, needed lines of names and values')
    return value


def _check(config: SensorSettings | RigConfig) -> None:
    """Raise ConfigError for a value of the wrong type; convert numbers of text fields to text."""
    for item in fields(config):
        if item.default is not MISSING:
            option = Option(item.name, item.default, '', minimum=0,
                            choices={'scale': SCALES, 'pairs': PAIRS}.get(item.name, ()))
            object.__setattr__(config, item.name, option.check(getattr(config, item.name)))
